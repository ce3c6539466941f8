"""A replay held against the float64 solver of contact_oracle.py, tick by tick."""

from dataclasses import dataclass

import numpy as np
from contact_oracle import Oracle

AGREE_MM = 1e-3


@dataclass
class Comparison:
    """Ticks that differ by more than AGREE_MM; how many of those are no local minimum; the deepest penetration."""

    touching: int
    differ: int
    wrong: int
    deepest_mm: float


def compare_with(oracle: Oracle, rows: np.ndarray, hip_mm: np.ndarray, judge_depth: bool = True) -> Comparison:
    """The oracle carries its own state along the path; where the two part it goes on from the runtime's."""
    x = hip_mm[0].copy()
    differ = wrong = 0
    deepest = np.inf
    for scp, hip in zip(rows["scp_mm"], hip_mm, strict=True):
        answer = oracle.solve(x, hip)
        x = answer.reference_mm
        if judge_depth:
            deepest = min(deepest, oracle.clearance(scp, 0.1))
        if np.linalg.norm(answer.scp_mm - scp) > AGREE_MM:
            differ += 1
            wrong += oracle.unheld(scp, hip) > 0.02
            x = oracle.start_from(scp.copy(), hip)
    return Comparison(int(rows["contact"].sum()), differ, wrong, deepest)
