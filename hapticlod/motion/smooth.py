"""Low-pass without delay."""

import numpy as np
from numpy.typing import NDArray


def low_passed(values: NDArray[np.float64], cutoff_hz: float, rate_hz: float) -> NDArray[np.float64]:
    """`values` (T, ...) through a Butterworth of order 2, forward and backward; unchanged where nothing is above."""
    if cutoff_hz >= 0.45 * rate_hz or len(values) < 10:
        return values
    from scipy.signal import butter, sosfiltfilt  # takes a second to import: not for those who only read motions

    sections = butter(2, cutoff_hz, fs=rate_hz, output="sos")
    # one period of padding at each end; more than the values themselves is not allowed
    pad = min(len(values) - 1, max(9, round(rate_hz / cutoff_hz)))
    return np.asarray(sosfiltfilt(sections, values, axis=0, padlen=pad))
