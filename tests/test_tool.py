"""Tools: constructors, nested order, the honesty of the stated gap, files, shipped tools."""

from pathlib import Path

import numpy as np
import pytest

from hapticlod.ball_order import sphere_directions
from hapticlod.errors import InputError
from hapticlod.tool import Tool, ball, load_tool, point, union
from hapticlod.tool_profile import fill_profile

CONFIGS = Path(__file__).parents[1] / "configs"
SHIPPED = sorted((CONFIGS / "tools").glob("*.toml"))


def outside_mm(points: np.ndarray, tool: Tool) -> np.ndarray:
    """Signed distance of points to a union of balls, by brute force."""
    apart = np.linalg.norm(points[:, None] - tool.centres_mm[None], axis=2) - tool.radii_mm
    return apart.min(axis=1)


def rod(count: int, seed: int) -> Tool:
    rng = np.random.default_rng(seed)
    along = np.concatenate([[0.0], rng.uniform(0.0, 10.0, count - 1)])
    radii = np.concatenate([[0.3], rng.uniform(0.1, 0.5, count - 1)])
    return union(np.column_stack([0 * along, 0 * along, along]), radii, "rod")


def test_point_and_ball() -> None:
    assert point().balls == 1 and point().reference_radius_mm == 0.0 and point().gap_mm(1) == 0.0
    np.testing.assert_array_equal(ball(1.5).rows, [[0, 0, 0, 1.5]])
    assert ball(1.0).digest == ball(1.0, "another name").digest != ball(1.1).digest


def test_first_given_ball_becomes_the_origin_and_stays_first() -> None:
    tool = union([[5.0, 5.0, 5.0], [5.0, 5.0, 9.0], [5.0, 5.0, 7.0]], [0.1, 2.0, 1.0], "three")
    np.testing.assert_array_equal(tool.rows[0], [0, 0, 0, 0.1])
    assert sorted(map(tuple, tool.rows)) == [(0, 0, 0, 0.1), (0, 0, 2, 1.0), (0, 0, 4, 2.0)]


def test_gap_in_closed_form() -> None:
    # The far pole of ball 2 is 10 + 2 mm from ball 1's centre: 11 mm from its surface.
    tool = union([[0, 0, 0], [0, 0, 10]], [1.0, 2.0], "two")
    assert tool.gap_mm(1) == pytest.approx(11.0, abs=0.02)
    assert tool.gap_mm(2) == 0.0 and tool.gap_mm(4096) == 0.0
    with pytest.raises(ValueError, match="at least one"):
        tool.gap_mm(0)
    spread = union([[0, 0, 0], [3, 0, 0], [0, 4, 0]], [0.0, 0.0, 0.0], "points")
    np.testing.assert_allclose(spread.gaps_mm, [4.0, 3.0, 0.0], atol=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_stated_gap_agrees_with_an_independent_sampling(seed: int) -> None:
    tool = rod(60, seed)
    points = (tool.centres_mm[:, None] + tool.radii_mm[:, None, None] * sphere_directions(700)).reshape(-1, 3)
    points = points[outside_mm(points, tool) > -1e-9]
    for balls in (1, 3, 10, 30, 59):
        independent = max(outside_mm(points, tool.first(balls)).max(), 0.0)
        assert tool.gap_mm(balls) == pytest.approx(independent, abs=0.01)
    assert np.all(np.diff(tool.gaps_mm) <= 1e-12) and tool.gaps_mm[-1] <= 1e-9


def test_order_describes_better_than_chance_and_within_twice_the_best() -> None:
    tool = rod(80, 5)
    rng = np.random.default_rng(0)
    for balls in (4, 10, 25):
        chance = []
        for _ in range(40):
            pick = np.concatenate([[0], 1 + rng.permutation(79)[: balls - 1]])
            subset = Tool("chance", tool.centres_mm[pick], tool.radii_mm[pick])
            chance.append(outside_mm(tool.centres_mm, subset).max())
        mine = outside_mm(tool.centres_mm, tool.first(balls)).max()
        assert mine <= np.median(chance)
        assert mine <= 2.0 * min(chance) + 0.2


def test_turned_profile_is_filled_to_its_surface() -> None:
    # A cone frustum with a flat tip: the surface is known in closed form, the flat's rim needs rings of balls.
    profile = [(0.0, 0.5), (4.0, 1.0)]
    centres, radii = fill_profile(profile, 4096)
    tool = Tool("cone", centres, radii)
    rng = np.random.default_rng(1)
    along, angle = rng.uniform(0.3, 3.5, 3000), rng.uniform(0, 2 * np.pi, 3000)
    radius = 0.5 + 0.125 * along
    surface = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), along])
    assert np.abs(outside_mm(surface, tool)).max() < 0.02
    flat = rng.uniform(0.0, 0.35, 500)
    disc = np.column_stack([flat * np.cos(angle[:500]), flat * np.sin(angle[:500]), 0 * flat])
    assert np.abs(outside_mm(disc, tool)).max() < 0.02
    lowest = (centres[:, 2] - radii).min()
    assert lowest > -0.005


def test_number_of_balls_is_selectable_up_to_4096(tmp_path: Path) -> None:
    text = (CONFIGS / "tools" / "burr_flame.toml").read_text()
    for balls in (12, 100, 4096):
        (tmp_path / "t.toml").write_text(text.replace("balls = 384", f"balls = {balls}"))
        tool = load_tool(tmp_path / "t.toml")
        assert 0.7 * balls <= tool.balls <= balls


def test_shipped_tools_are_there() -> None:
    names = {path.stem for path in SHIPPED}
    assert names >= {"point", "ball_0.5mm", "ball_1mm", "ball_3mm", "burr_flame", "explorer"}


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_shipped_tool_loads(path: Path) -> None:
    tool = load_tool(path)
    assert 1 <= tool.balls <= 4096 and np.isfinite(tool.rows).all()
    np.testing.assert_array_equal(tool.centres_mm[0], 0.0)
    assert (tool.centres_mm[:, 2] - tool.radii_mm).min() >= -tool.reference_radius_mm - 0.01  # the tip is lowest
    assert load_tool(path).digest == tool.digest


def test_shaped_tools_need_their_balls() -> None:
    burr = load_tool(CONFIGS / "tools" / "burr_flame.toml")
    assert burr.balls >= 300
    assert burr.gap_mm(10) > burr.gap_mm(50) > 0.05 > burr.gap_mm(burr.balls)
    hook = load_tool(CONFIGS / "tools" / "explorer.toml")
    assert np.ptp(hook.centres_mm[:, 0]) > 8.0  # it is curved
    assert 0.05 < hook.reference_radius_mm < 0.12


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (
            'kind = "bal"\nname = "x"',
            "t.toml:1:1: kind: 'bal' is none of point, ball, balls, profile; did you mean ball?",
        ),
        ('name = "x"', "t.toml:1:1: kind: missing"),
        ('kind = "ball"\nname = "x"\nradius = 1', "t.toml:3:1: radius: unknown key; did you mean radius_mm?"),
        (
            'kind = "ball"\nname = "x"\nradius_mm = -1',
            "t.toml:3:1: radius_mm: input should be greater than or equal to 0 (got -1)",
        ),
        ('kind = "balls"\nname = "x"\nballs_mm = [[0, 0, 0, 1], [0, 0, 1, -1]]', "t.toml:3:37: balls_mm.1.3: "),
        ('kind = "profile"\nname = "x"\nballs = 5000\nprofile_mm = [[0, 1], [1, 1]]', "t.toml:3:1: balls: "),
        (
            'kind = "profile"\nname = "x"\nballs = 5\nprofile_mm = [[0, 1], [0, 2]]',
            "t.toml:4:1: profile_mm: distances along",
        ),
        (
            'kind = "profile"\nname = "x"\nballs = 5\nprofile_mm = [[0, 1], [9, 2]]\naxis_mm = [[0, 0, 0], [0, 0, 8]]',
            "t.toml:4:1: profile_mm: reaches 9 mm, beyond the axis, which is 8 mm long",
        ),
    ],
)
def test_faults_of_tool_files(text: str, expected: str, tmp_path: Path) -> None:
    (tmp_path / "t.toml").write_text(text)
    with pytest.raises(InputError) as caught:
        load_tool(tmp_path / "t.toml")
    message = f"{caught.value.where}: {caught.value.what}"
    assert message.removeprefix(f"{tmp_path}/").startswith(expected) and "|" not in message


@pytest.mark.parametrize(
    ("centres", "radii", "match"),
    [
        ([[0, 0, 0]], [-1], "ball 0"),
        ([[0, 0, 0], [0, np.nan, 0]], [1, 1], "ball 1"),
        (np.zeros((4097, 3)), np.ones(4097), "4097 balls"),
        ([], [], "disagree"),
        ([[0, 0, 0]], [1, 2], "disagree"),
    ],
)
def test_bad_unions_are_refused(centres, radii, match: str) -> None:
    with pytest.raises(InputError, match=match):
        union(centres, radii, "bad")
