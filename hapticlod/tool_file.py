"""Tool files: TOML with a `kind` of shape. Every shape ends as a union of balls.

name = "ball-1mm"
kind = "ball"          # point | ball | balls | profile
radius_mm = 1.0
"""

from itertools import pairwise
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, RootModel, model_validator

from hapticlod.layout import MAX_BALLS
from hapticlod.toml import TomlModel, fault_at, load_toml
from hapticlod.tool import Tool, ball, point, union
from hapticlod.tool_profile import Blades, axis_length_mm, fill_profile

Place = tuple[float, float, float]
BallRow = tuple[float, float, float, Annotated[float, Field(ge=0)]]
ProfileRow = tuple[float, Annotated[float, Field(ge=0)]]


class PointFile(TomlModel):
    """The paper's point probe."""

    kind: Literal["point"] = "point"
    name: str = "point"

    def tool(self) -> Tool:
        return point(self.name)


class BallFile(TomlModel):
    """One ball."""

    kind: Literal["ball"] = "ball"
    name: str
    radius_mm: float = Field(ge=0)

    def tool(self) -> Tool:
        return ball(self.radius_mm, self.name)


class BallsFile(TomlModel):
    """Balls listed one by one: rows x, y, z, radius in mm. The first row is the reference ball."""

    kind: Literal["balls"] = "balls"
    name: str
    balls_mm: tuple[BallRow, ...] = Field(min_length=1, max_length=MAX_BALLS)

    def tool(self) -> Tool:
        return union([row[:3] for row in self.balls_mm], [row[3] for row in self.balls_mm], self.name)


class ProfileFile(TomlModel):
    """A profile curve turned about an axis, which may itself be curved: burrs, probes, hooks.

    `profile_mm` rows are (distance along the axis from the tip, radius there), joined by straight lines.
    `axis_mm` are points of the axis, tip first, joined by a smooth curve; without it the axis is straight.
    """

    kind: Literal["profile"] = "profile"
    name: str
    balls: int = Field(ge=1, le=MAX_BALLS, description="how many balls fill the shape, at most")
    profile_mm: tuple[ProfileRow, ...] = Field(min_length=2)
    axis_mm: tuple[Place, ...] = ()
    blades: Blades | None = None

    @model_validator(mode="after")
    def _usable(self) -> "ProfileFile":
        along = [row[0] for row in self.profile_mm]
        if along[0] != 0.0:
            raise fault_at("profile_mm", "must start at the tip, at distance 0")
        if any(after <= before for before, after in pairwise(along)):
            raise fault_at("profile_mm", "distances along the axis must increase")
        if max(row[1] for row in self.profile_mm) == 0.0:
            raise fault_at("profile_mm", "needs a radius above 0 somewhere")
        if self.axis_mm and (len(self.axis_mm) < 2 or len(set(self.axis_mm)) < len(self.axis_mm)):
            raise fault_at("axis_mm", "needs at least two points, all different")
        if self.axis_mm and along[-1] > (length := axis_length_mm(self.axis_mm)):
            raise fault_at("profile_mm", f"reaches {along[-1]:g} mm, beyond the axis, which is {length:.4g} mm long")
        return self

    def tool(self) -> Tool:
        centres, radii = fill_profile(self.profile_mm, self.balls, axis_mm=self.axis_mm, blades=self.blades)
        return union(centres, radii, self.name)


class ToolFile(RootModel[Annotated[PointFile | BallFile | BallsFile | ProfileFile, Field(discriminator="kind")]]):
    """A tool file of any kind."""


def read_tool(path: str | Path) -> Tool:
    """See `hapticlod.tool.load_tool`."""
    return load_toml(path, ToolFile).root.tool()
