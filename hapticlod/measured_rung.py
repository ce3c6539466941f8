"""What is said alike of a rung of one scan and of a rung of a whole scene."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hapticlod.deviation import Deviation


class MeasuredRung(ABC):
    """Size against what was asked for, and distance to what was scanned."""

    asked: int

    @property
    @abstractmethod
    def triangles(self) -> int:
        """Number of faces."""

    @property
    @abstractmethod
    def deviation(self) -> Deviation:
        """Distance to what was scanned."""

    @property
    def is_larger_than_asked(self) -> bool:
        """Whether simplification stopped early."""
        return self.triangles > self.asked

    @property
    def rms_mm(self) -> float:
        """Root mean square distance to what was scanned, both directions."""
        return self.deviation.rms_mm

    @property
    def hausdorff_mm(self) -> float:
        """Greatest distance found to what was scanned, either direction."""
        return self.deviation.hausdorff_mm
