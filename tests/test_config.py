"""LodConfig: rules, files, the shipped configurations of the paper, the runtime's form."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from hapticlod.config import Level, LodConfig, load_config, save_config
from hapticlod.errors import InputError
from hapticlod.layout import MAX_LEVELS
from hapticlod.station import load_station
from hapticlod.toml import parse_toml
from hapticlod.tool import ball

CONFIGS = Path(__file__).parents[1] / "configs"
SHIPPED = sorted((CONFIGS / "levels").glob("*.toml"))
THREE = """speeds_mm_s = [30.0, 120.0]
[[levels]]
triangles = 900
cell_mm = 1.0
[[levels]]
triangles = 300
cell_mm = 2.0
[[levels]]
triangles = 100
cell_mm = 4.0
"""


@dataclass
class Rung:
    triangles: int
    mean_edge_mm: float


class SmallLadder:
    """Rungs from 40 triangles up, as a small scan has them."""

    def at(self, triangles: int, /) -> Rung:
        kept = max(triangles, 40)
        return Rung(kept, 10.0 / kept**0.5)


def fault(text: str) -> str:
    with pytest.raises(InputError) as caught:
        parse_toml(text, LodConfig, "c.toml")
    return f"{caught.value.where}: {caught.value.what}"


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_shipped_configuration_loads_and_survives_saving(path: Path, tmp_path: Path) -> None:
    config = load_config(path)
    save_config(tmp_path / "again.toml", config, "comment")
    assert load_config(tmp_path / "again.toml") == config


def test_the_papers_numbers() -> None:
    sphere, dentition = (load_config(CONFIGS / "levels" / f"paper_{name}.toml") for name in ("sphere", "dentition"))
    assert [level.triangles for level in sphere.levels] == [101870, 10028, 1018]
    assert sphere.speeds_mm_s == (20.0, 150.0)
    assert [level.triangles for level in dentition.levels] == [66224, 26556, 14830]
    assert dentition.speeds_mm_s == (30.0, 120.0)
    for config in (sphere, dentition):
        assert (config.mapping, config.l_in_mm, config.l_out_mm) == ("paper", 0.0, 5.0)
        assert config.filter_hz == config.hysteresis == config.dwell_ms == config.blend_ms == 0.0
    planes = [load_config(CONFIGS / "levels" / f"paper_plane_{n}.toml") for n in (80000, 5000, 800)]
    assert [plane.levels[0].triangles for plane in planes] == [80000, 5000, 800]
    assert {len(plane.levels) for plane in planes} == {1}


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (("triangles = 300", "triangles = 901"), "c.toml:2:1: levels: level 1 has more triangles than level 0"),
        (("triangles = 300", "triangles = 900"), "c.toml:2:1: levels: levels 0 and 1 are alike: drop one"),
        (
            ("triangles = 100", "triangels = 100"),
            "c.toml:9:1: levels.2.triangels: unknown key; did you mean triangles?",
        ),
        (("[30.0, 120.0]", "[30.0]"), "c.toml:1:1: speeds_mm_s: 3 levels need 2 speeds, not 1"),
        (("[30.0, 120.0]", "[120.0, 30.0]"), "c.toml:1:1: speeds_mm_s: must increase"),
        (("[30.0, 120.0]", "[30.0, 0]"), "c.toml:1:22: speeds_mm_s.1: input should be greater than 0 (got 0)"),
        (
            ("120.0]", "120.0]\nmapping = 'two_sided'"),
            "c.toml:2:1: mapping: 'two_sided' is none of paper, two-sided; did you mean two-sided?",
        ),
        (("120.0]", "120.0]\nhysteresis = 1.0"), "c.toml:2:1: hysteresis: input should be less than 1 (got 1.0)"),
        (("120.0]", "120.0]\nl_out_mm = 0.0"), "c.toml:2:1: l_out_mm: l_in_mm and l_out_mm are both 0"),
    ],
)
def test_faults_point_at_the_entry(change: tuple[str, str], expected: str) -> None:
    found = fault(THREE.replace(*change))
    assert found.startswith(expected) and " | " not in found


def test_levels_may_share_a_mesh_and_differ_in_balls() -> None:
    config = parse_toml(THREE.replace("triangles = 300", "triangles = 900\nballs = 10"), LodConfig)
    assert [level.balls for level in config.levels] == [4096, 10, 4096]


def test_number_of_levels_is_bounded() -> None:
    levels = tuple(Level(triangles=1000 - i, cell_mm=1.0) for i in range(MAX_LEVELS + 1))
    config = LodConfig(levels=levels[:-1], speeds_mm_s=tuple(map(float, range(1, MAX_LEVELS))))
    assert len(config.levels) == MAX_LEVELS
    with pytest.raises(InputError, match="at most 8"):
        config.changed(levels=levels, speeds_mm_s=tuple(range(1, MAX_LEVELS + 1)))


def test_scaling_keeps_proportions_and_drops_levels_that_come_out_alike() -> None:
    config = parse_toml(THREE, LodConfig)
    scaled = config.scaled_to(SmallLadder(), 9000)
    assert [level.triangles for level in scaled.levels] == [9000, 3000, 1000]
    assert scaled.levels[1].cell_mm == pytest.approx(4 * 10 / 3000**0.5)
    assert scaled.speeds_mm_s == (30.0, 120.0)
    small = config.scaled_to(SmallLadder(), 180)  # 180, 60, 20 -> 40
    assert [level.triangles for level in small.levels] == [180, 60, 40]
    tiny = config.scaled_to(SmallLadder(), 90)  # 90, 30 -> 40, 10 -> 40
    assert [level.triangles for level in tiny.levels] == [90, 40]
    assert tiny.speeds_mm_s == (30.0,)


def test_runtime_form_holds_every_parameter_in_the_runtimes_units() -> None:
    text = THREE.replace("cell_mm = 4.0", "cell_mm = 4.0\nballs = 7").replace(
        "120.0]",
        "120.0]\nhysteresis = 0.1\ndwell_ms = 20.0\nfilter_hz = 30.0\nl_in_mm = 0.5\nl_out_mm = 0.7\nblend_ms = 15.0\n"
        "shading = true\npolicy = 'distance'\ncrack_mm = 0.01",
    )
    station = load_station(CONFIGS / "stations" / "desktop_4khz.toml").adjusted(
        damping_n_s_mm=0.001, friction_static=0.3, friction_dynamic=0.2, max_slew_n_s=900.0, engage_ms=40.0
    )
    data = parse_toml(text, LodConfig).to_runtime(station, ball(1.0), [1.0, 2.0, 3.0])
    expected = {
        "version": 1, "level_count": 3, "mapping": 1, "policy": 1, "shading": 1, "flags": 0,
        "origin_mm": [1.0, 2.0, 3.0], "loop_hz": 4000.0, "budget_us": 150.0, "stiffness_n_mm": 1.0,
        "damping_n_s_mm": 0.001, "friction_static": 0.3, "friction_dynamic": 0.2, "filter_hz": 30.0,
        "hysteresis": 0.1, "dwell_s": 0.02, "l_in_mm": 0.5, "l_out_mm": 0.7, "closest_bound_mm": 0.7,
        "blend_s": 0.015, "max_force_n": 12.0, "max_slew_n_s": 900.0, "engage_s": 0.04, "crack_mm": 0.01,
        "work_limit": 50.0 * 150.0, "reserved": [0.0] * 7, "speeds_mm_s": [30.0, 120.0, 0, 0, 0, 0, 0, 0],
        "cell_mm": [1.0, 2.0, 4.0, 0, 0, 0, 0, 0], "triangles": [900, 300, 100, 0, 0, 0, 0, 0],
        "balls": [1, 1, 1, 0, 0, 0, 0, 0],
    }  # fmt: skip
    assert set(data.dtype.names) == set(expected)
    for field, value in expected.items():
        np.testing.assert_allclose(data[field], value, err_msg=field)
