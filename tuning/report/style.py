"""How figures look: readable in print, in grey, and by people who do not see all colours."""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from functools import wraps
from pathlib import Path
from textwrap import wrap
from typing import Any, TypeVar, cast

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from hapticlod.files import write_atomic

# Okabe and Ito 2008: told apart with every kind of colour vision. Lines differ in their dashes too.
BLUE, VERMILION, GREEN, PURPLE, SKY, ORANGE = "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00"
COLOURS = (BLUE, VERMILION, GREEN, PURPLE, SKY, ORANGE, "#000000", "#7F7F7F")
DASHES = ("-", (0, (5, 1.5)), (0, (1.5, 1.2)), (0, (6, 1.5, 1.5, 1.5)), (0, (9, 1.5)), (0, (3, 3)), (0, (1, 3)), "-")
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "*")
# Levels: light for the finest to dark for the coarsest, in order also in grey.
LEVEL_SHADES = ("#FFFFFF", "#DCE9F2", "#B5D0E4", "#8DB7D6", "#669EC8", "#4185BA", "#2D6A99", "#1F4C6F")

# Small enough to stand beside each other on a wide page, and alone on a narrow one without shrinking its text.
WIDTH_IN = 5.0
_STYLE: Any = {
    "font.size": 9.0, "font.family": "sans-serif", "axes.titlesize": 10.0, "axes.titleweight": "bold",
    "axes.titlelocation": "left", "axes.spines.top": False, "axes.spines.right": False, "axes.grid": True,
    "grid.color": "#D9D9D9", "grid.linewidth": 0.5, "axes.axisbelow": True, "lines.linewidth": 1.1,
    "legend.frameon": False, "legend.fontsize": 8.0, "figure.constrained_layout.use": True,
    "savefig.facecolor": "white",
    "svg.fonttype": "none", "svg.hashsalt": "hapticlod", "path.simplify": True, "path.simplify_threshold": 0.3,
}  # fmt: skip
MOST_POINTS = 1600
TITLE_PER_IN = 11.4  # characters of a title that fit


Plot = TypeVar("Plot", bound=Callable[..., Figure])


def styled(plot: Plot) -> Plot:
    """Makes a plot function draw in this style, whatever the caller's settings are."""

    @wraps(plot)
    def drawn(*args: Any, **named: Any) -> Figure:
        with rc_context(_STYLE):
            return plot(*args, **named)

    return cast(Plot, drawn)


def panels(title: str, heights: Sequence[float], *, width_in: float = WIDTH_IN) -> tuple[Figure, list[Axes]]:
    """A figure with axes one above the other that share x; `heights` in inches."""
    figure = Figure(figsize=(width_in, sum(heights) + 0.75))
    axes = figure.subplots(len(heights), 1, sharex=True, squeeze=False, height_ratios=list(heights))[:, 0]
    title = "\n".join(wrap(title, round(TITLE_PER_IN * width_in)))
    figure.suptitle(title, x=0.01, ha="left", fontsize=10.5, fontweight="bold")
    return figure, list(axes)


def svg_of(figure: Figure) -> str:
    """The figure as SVG text; the same figure gives the same bytes."""
    held = io.StringIO()
    with rc_context(_STYLE):
        figure.savefig(held, format="svg", metadata={"Date": None, "Creator": None})
    return held.getvalue()


def save_svg(path: Path, figure: Figure) -> None:
    """Writes the figure as SVG. Raises InputError where it cannot be written."""
    write_atomic(path, svg_of(figure))


def thinned(x: NDArray[Any], y: NDArray[Any], most: int = MOST_POINTS) -> tuple[NDArray[Any], NDArray[Any]]:
    """A curve (T,) with at most about `most` points that looks the same: the least and the greatest of each stretch."""
    if len(x) <= most:
        return x, y
    size = -(-2 * len(x) // most)
    starts = np.arange(0, len(x), size)
    low = [start + int(np.argmin(y[start : start + size])) for start in starts]
    high = [start + int(np.argmax(y[start : start + size])) for start in starts]
    kept = np.unique(np.array([*low, *high, 0, len(x) - 1]))
    return x[kept], y[kept]
