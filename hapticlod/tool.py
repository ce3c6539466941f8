"""The tool: a rigid union of 1 to 4096 balls in the tool's frame, in an order whose first P balls describe it best.

Frame: the origin is the centre of the REFERENCE BALL, which is ball 0 and sits at the tip; +z runs from the tip along
the shaft. A HIP is the place of this origin: a point probe's HIP is its tip, a ball's HIP its centre.
"""

import hashlib
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hapticlod.ball_order import nested_order, worst_gaps_mm
from hapticlod.errors import InputError
from hapticlod.layout import MAX_BALLS


@dataclass(frozen=True, eq=False)
class Tool:
    """A union of balls. Make one with `point`, `ball`, `union` or `load_tool`.

    Attributes:
        name: what reports call it.
        centres_mm: (P, 3) ball centres in the tool's frame, nested order; row 0 is the origin.
        radii_mm: (P,) ball radii, 0 allowed.
    """

    name: str
    centres_mm: NDArray[np.float64]
    radii_mm: NDArray[np.float64]

    @property
    def balls(self) -> int:
        """Number of balls, P."""
        return len(self.radii_mm)

    @property
    def reference_radius_mm(self) -> float:
        """Radius of the ball at the tip."""
        return float(self.radii_mm[0])

    @property
    def rows(self) -> NDArray[np.float64]:
        """(P, 4) rows x, y, z, radius, as the runtime takes them."""
        return np.column_stack([self.centres_mm, self.radii_mm])

    @cached_property
    def gaps_mm(self) -> NDArray[np.float64]:
        """(P,) worst distance from the full union's surface to its first 1, 2, ... P balls.

        Sampled on the surface of the full union (some 10^4 points); a subset never sticks out of the whole, so this
        is the Hausdorff distance between them up to the sampling.
        """
        return worst_gaps_mm(self.centres_mm, self.radii_mm)

    def gap_mm(self, balls: int) -> float:
        """Worst gap of the first `balls` balls to the full tool, mm; 0 when that is all of them.

        Raises:
            ValueError: `balls` is below 1.
        """
        if balls < 1:
            raise ValueError(f"a tool has at least one ball, not {balls}")
        return float(self.gaps_mm[min(balls, self.balls) - 1])

    def first(self, balls: int) -> "Tool":
        """The tool made of the first `balls` balls."""
        return Tool(self.name, self.centres_mm[:balls], self.radii_mm[:balls])

    @property
    def digest(self) -> str:
        """Content hash, hex: equal for equal balls in equal order, whatever the name."""
        return hashlib.blake2b(np.ascontiguousarray(self.rows).tobytes(), digest_size=16).hexdigest()


def point(name: str = "point") -> Tool:
    """The paper's probe: one ball of radius 0."""
    return ball(0.0, name)


def ball(radius_mm: float, name: str | None = None) -> Tool:
    """One ball. Raises InputError where the radius is negative or not finite."""
    return union([[0.0, 0.0, 0.0]], [radius_mm], name or f"ball-{radius_mm:g}mm")


def union(centres_mm: ArrayLike, radii_mm: ArrayLike, name: str, *, where: str = "tool") -> Tool:
    """A tool from balls in any order; the first given ball is the reference ball.

    Args:
        centres_mm: (P, 3), any frame with +z along the shaft: the first centre becomes the origin.
        radii_mm: (P,), at least 0.
        name: what reports call it.
        where: origin of the balls, for messages.

    Raises:
        InputError: no ball, more than 4096, a shape mismatch, a negative radius, a number that is not finite.
    """
    centres = np.array(centres_mm, dtype=np.float64)
    radii = np.array(radii_mm, dtype=np.float64)
    if radii.ndim != 1 or centres.shape != (len(radii), 3):
        raise InputError(where, f"centres {centres.shape} and radii {radii.shape} disagree", "give (P, 3) and (P,)")
    if not 1 <= len(radii) <= MAX_BALLS:
        raise InputError(where, f"{len(radii)} balls", f"a tool has 1 to {MAX_BALLS}")
    bad = ~np.isfinite(centres).all(axis=1) | ~np.isfinite(radii) | (radii < 0)
    if bad.any():
        row = int(np.argmax(bad))
        raise InputError(
            f"{where}: ball {row}", f"centre {centres[row]}, radius {radii[row]}", "use finite numbers, radius >= 0"
        )
    centres -= centres[0]
    order = nested_order(centres, radii) if len(radii) > 1 else np.zeros(1, dtype=np.intp)
    centres, radii = centres[order], radii[order]
    centres.setflags(write=False)
    radii.setflags(write=False)
    return Tool(name, centres, radii)


def load_tool(path: str | Path) -> Tool:
    """Reads a tool file (configs/tools/). Raises InputError naming file, line, column and field of every fault."""
    from hapticlod.tool_file import read_tool  # it needs the constructors above

    return read_tool(path)
