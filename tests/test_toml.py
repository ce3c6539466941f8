"""Faults of TOML files: each is named with file, line, column and field, and none is missed."""

from typing import Annotated, Literal

import pytest
from pydantic import Field, model_validator

from hapticlod.errors import InputError
from hapticlod.toml import TomlModel, fault_at, load_toml, parse_toml, save_toml
from hapticlod.toml_places import key_places


class Wheel(TomlModel):
    kind: Literal["wheel"] = "wheel"
    radius_mm: float = Field(gt=0)


class Leg(TomlModel):
    kind: Literal["leg"] = "leg"
    length_mm: float


class Engine(TomlModel):
    power_w: float = 1.0
    valves_mm: tuple[float, ...] = ()


class Car(TomlModel):
    name: str
    colour: Literal["red", "green"] = "red"
    engine: Engine = Engine()
    limbs: tuple[Annotated[Wheel | Leg, Field(discriminator="kind")], ...] = ()
    low: int = 0
    high: int = 1

    @model_validator(mode="after")
    def _ordered(self) -> "Car":
        if self.low > self.high:
            raise fault_at("high", "must not be below low")
        return self


def faults(text: str) -> list[str]:
    with pytest.raises(InputError) as caught:
        parse_toml(text, Car, "car.toml")
    return f"{caught.value.where}: {caught.value.what}".split(" | ")


def test_places_of_every_construct() -> None:
    text = """# comment with [brackets] and key = 1
"quoted key" = "a # no comment, ] no end"
a.b = { c = [1, 2], d.e = '''x''' }
s = \"\"\"
[not.a.table]
k = 1 \\\"\"\" still inside
\"\"\"
[t]
x = [
  1.5, # one
  [2, 3],
  { y = 4 },
]
[[r.s]]
k = 1
[[r.s.deep]]
j = 1979-05-27 07:32:00
[[r.s]]
[[r.s.deep]]
j = 2
[r.s.only]
z = true
"""
    places = key_places(text)
    assert places[("quoted key",)] == (2, 1)
    assert places[("a", "b", "c", 1)] == (3, 17)
    assert places[("a", "b", "d", "e")] == (3, 21)
    assert ("not",) not in places and ("k",) not in places
    assert places[("t", "x", 0)] == (10, 3)
    assert places[("t", "x", 1, 1)] == (11, 7)
    assert places[("t", "x", 2, "y")] == (12, 5)
    assert places[("r", "s", 0, "k")] == (15, 1)
    assert places[("r", "s", 0, "deep", 0, "j")] == (17, 1)
    assert places[("r", "s", 1, "deep", 0, "j")] == (20, 1)
    assert places[("r", "s", 1, "only", "z")] == (22, 1)


def test_every_fault_is_reported_at_its_place() -> None:
    found = faults(
        "colour = 'grene'\n"
        "[engine]\n"
        "power_w = '3'\n"
        "  valves_mm = [1.0, nan]\n"
        "[[limbs]]\n"
        "kind = 'wheel'\n"
        "radius_mm = -1\n"
        "[[limbs]]\n"
        "kind = 'leg'\n"
        "lenght_mm = 2\n"
    )
    assert found == [
        "car.toml:1:1: name: missing",
        "car.toml:1:1: colour: 'grene' is none of red, green; did you mean green?",
        "car.toml:3:1: engine.power_w: input should be a valid number (got '3')",
        "car.toml:4:21: engine.valves_mm.1: input should be a finite number (got nan)",
        "car.toml:7:1: limbs.0.radius_mm: input should be greater than 0 (got -1)",
        "car.toml:10:1: limbs.1.lenght_mm: unknown key; did you mean length_mm?",
    ]


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("nmae = 'x'", "car.toml:1:1: nmae: unknown key; did you mean name?"),
        ("name = 'x'\n[engine]\n\npwoer_w = 1", "car.toml:4:1: engine.pwoer_w: unknown key; did you mean power_w?"),
        ("name = 'x'\nqqqq = 1", "car.toml:2:1: qqqq: unknown key"),
        (
            "name = 'x'\n[[limbs]]\nkind = 'whel'",
            "car.toml:3:1: limbs.0.kind: 'whel' is none of wheel, leg; did you mean wheel?",
        ),
        ("name = 'x'\n[[limbs]]\nradius_mm = 1", "car.toml:2:1: limbs.0.kind: missing"),
        ("name = 'x'\r\nlow = 3\r\nhigh = 2\r\n", "car.toml:3:1: high: must not be below low"),
        ("name = 'x'\nlow = 1.5", "car.toml:2:1: low: input should be a valid integer (got 1.5)"),
        ("name = true", "car.toml:1:1: name: input should be a valid string (got True)"),
        ("name = \nlow = 1", "car.toml:1:8: not TOML: invalid value"),
        ("name = 'x'\nname = 'y'", "car.toml:2:11: not TOML: cannot overwrite a value"),
        ("name = [1,", "car.toml:1:11: not TOML: invalid value"),
    ],
)
def test_single_faults(text: str, fault: str) -> None:
    assert faults(text) == [fault]


def test_unreadable_files(tmp_path) -> None:
    with pytest.raises(InputError, match=r"missing\.toml: No such file"):
        load_toml(tmp_path / "missing.toml", Car)
    with pytest.raises(InputError, match="is a folder"):
        load_toml(tmp_path, Car)
    (tmp_path / "latin.toml").write_bytes(b"name = '\xe9'")
    with pytest.raises(InputError, match=r"not UTF-8 text \(byte 8\)"):
        load_toml(tmp_path / "latin.toml", Car)


def test_saved_models_come_back_equal(tmp_path) -> None:
    limbs = (Wheel(radius_mm=0.1), Leg(length_mm=1e-12))
    car = Car(name='tab\t "q" \\ é', engine=Engine(power_w=2, valves_mm=(1.0, 2.5e30)), limbs=limbs, high=7)
    save_toml(tmp_path / "car.toml", car, "two\nlines")
    assert (tmp_path / "car.toml").read_text().startswith("# two\n# lines\n")
    assert load_toml(tmp_path / "car.toml", Car) == car
