"""The teeth of a generated lower jaw: their sizes, their cusps and fissures, and where one gives way to the next."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Kind:
    """One kind of tooth; mm. Sizes are rounded means of human lower teeth (Wheeler's Dental Anatomy).

    Attributes:
        width: along the arch. half_depth: across the arch at the belly. half_table: of the edge or chewing surface.
        height: of the crown above the gum. roundness: exponent of the outline along the arch, larger is squarer.
        cusps: (along, across, height, radius) each. grooves: places along the tooth of fissures across its table.
    """

    width: float
    half_depth: float
    half_table: float
    height: float
    roundness: float
    cusps: tuple[tuple[float, float, float, float], ...] = ()
    grooves: tuple[float, ...] = ()


INCISOR_1 = Kind(5.3, 2.9, 0.8, 8.4, 6.0, ((-1.6, 0, 0.12, 0.6), (0, 0, 0.12, 0.6), (1.6, 0, 0.12, 0.6)))
INCISOR_2 = Kind(5.7, 3.1, 0.85, 8.4, 6.0, ((-1.7, 0, 0.12, 0.7), (0, 0, 0.12, 0.7), (1.7, 0, 0.12, 0.7)))
CANINE = Kind(6.8, 3.7, 1.0, 8.4, 3.5, ((0, 0, 1.3, 1.2),))
PREMOLAR_1 = Kind(7.0, 3.9, 2.4, 7.4, 4.0, ((0, 1.7, 1.6, 1.3), (0, -1.9, 0.7, 1.0)), (0.0,))
PREMOLAR_2 = Kind(7.1, 4.1, 2.7, 6.9, 4.0, ((0, 1.9, 1.4, 1.3), (-1.3, -2.0, 1.0, 1.0), (1.4, -2.0, 0.9, 1.0)), (0.1,))
MOLAR_1 = Kind(
    11.2, 5.2, 3.6, 6.2, 5.0,
    ((-2.9, 2.5, 1.4, 1.25), (0.3, 2.6, 1.4, 1.25), (3.1, 2.0, 1.1, 1.1),
     (-2.2, -2.6, 1.5, 1.4), (2.0, -2.6, 1.5, 1.4)),
    (-1.3, 1.8),
)  # fmt: skip
MOLAR_2 = Kind(
    10.5, 5.1, 3.5, 6.0, 5.0,
    ((-2.2, 2.5, 1.4, 1.4), (2.2, 2.5, 1.3, 1.4), (-2.2, -2.5, 1.4, 1.4), (2.2, -2.5, 1.4, 1.4)),
    (0.0,),
)  # fmt: skip
SIDE = (INCISOR_1, INCISOR_2, CANINE, PREMOLAR_1, PREMOLAR_2, MOLAR_1, MOLAR_2)  # from the middle backwards
RETROMOLAR_MM = 3.0  # gum behind the last tooth
FIELDS = ("half_depth", "half_table", "crown_top", "margin", "basin", "offset")


@dataclass(frozen=True)
class Row:
    """The 14 teeth in order from the right to the left; all (14,) in mm except `kinds`.

    Attributes:
        start, end: of each tooth along the arch, 0 in the middle. at_middle: (14, 6) value of each of FIELDS in the
        middle of a tooth. at_gap: (15, 6) the same between teeth and behind the last. mirror: -1 on the right.
    """

    kinds: tuple[Kind, ...]
    start: np.ndarray
    end: np.ndarray
    at_middle: np.ndarray
    at_gap: np.ndarray
    mirror: np.ndarray

    def fields(self, along_mm: np.ndarray) -> np.ndarray:
        """(n, 6) of FIELDS at places (n,) along the arch."""
        edges = np.append(self.start, self.end[-1])
        tooth = np.clip(np.searchsorted(edges, along_mm, side="right") - 1, 0, len(self.kinds) - 1)
        part = np.clip((along_mm - self.start[tooth]) / (self.end - self.start)[tooth], 0.0, 1.0)
        power = np.array([kind.roundness for kind in self.kinds])[tooth]
        bulge = np.repeat((1.0 - np.abs(2.0 * part - 1.0) ** power)[:, None], len(FIELDS), axis=1)
        bulge[:, FIELDS.index("margin")] = np.sin(np.pi * part) ** 1.5  # the papilla is rounder than the gap
        gap = (1.0 - part)[:, None] * self.at_gap[tooth] + part[:, None] * self.at_gap[tooth + 1]
        return gap + (self.at_middle[tooth] - gap) * bulge


def grow_teeth(random: np.random.Generator) -> Row:
    """The teeth of one jaw, each a little off the mean in size, height and place."""
    kinds = SIDE[::-1] + SIDE
    count = len(kinds)
    mirror = np.repeat([-1.0, 1.0], count // 2)
    widths = np.array([kind.width for kind in kinds]) * (1.0 + 0.02 * random.standard_normal(count))
    edges = np.concatenate(([0.0], np.cumsum(widths))) - widths[: count // 2].sum()
    middle = np.array(
        [[k.half_depth, k.half_table, k.height, 0.0, 0.4 if k.half_table > 2.0 else 0.0, 0.0] for k in kinds]
    )
    middle[:, :2] *= 1.0 + 0.03 * random.standard_normal((count, 1))
    middle[:, 2] += 0.15 * random.standard_normal(count)
    middle[:, 5] = 0.25 * random.standard_normal(count)
    inner = 0.5 * (middle[1:] + middle[:-1])
    inner[:, 0] *= 0.72
    inner[:, 1] *= 0.66
    inner[:, 2] = np.minimum(middle[1:, 2], middle[:-1, 2]) * 0.74
    inner[:, 3] = 1.6  # the papilla
    end = np.array([[3.6, 2.2, 1.4, 0.4, 0.0, 0.0]])
    return Row(kinds, edges[:-1], edges[1:], middle, np.concatenate((end, inner, end)), mirror)


def chewing_relief(kind: Kind, mirror: float, along_mm: np.ndarray, across_mm: np.ndarray) -> np.ndarray:
    """Height of cusps less depth of fissures over the chewing surface, mm.

    Args:
        kind: the tooth. mirror: -1 on the right side. along_mm, across_mm: from the middle of the tooth, same shape;
            along is positive to the left of the jaw, across is positive to the cheek.
    """
    backwards = along_mm * mirror
    relief = np.zeros(np.broadcast_shapes(along_mm.shape, across_mm.shape))
    for along, across, height, radius in kind.cusps:
        square = (backwards - along) ** 2 + (across_mm - across) ** 2
        relief += height * np.exp(square / (-2.0 * radius * radius))
    if not kind.grooves:
        return relief
    half = 0.5 * kind.width
    within = np.exp(-((backwards / (0.75 * half)) ** 6))
    winding = 0.25 * np.sin(2.2 * backwards / half * np.pi)
    relief -= within * _groove(across_mm - winding, 0.55)
    for place in kind.grooves:
        relief -= within * _groove(backwards - place - 0.12 * across_mm, 0.4)
    return relief


def _groove(distance_mm: np.ndarray, depth_mm: float) -> np.ndarray:
    """A wide valley with a narrow fissure in its floor."""
    square = distance_mm**2
    return depth_mm * (0.55 * np.exp(square / (-2.0 * 0.55**2)) + 0.45 * np.exp(square / (-2.0 * 0.18**2)))
