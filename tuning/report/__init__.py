"""Figures and pages: every plot is a function that returns a matplotlib figure (`tuning.report.plots`).

Needs the extra [report].
"""


def needed() -> None:
    """Raises InputError where the extra is not installed."""
    from importlib.util import find_spec

    from hapticlod.errors import InputError

    if find_spec("matplotlib") is None:
        raise InputError("figures", "matplotlib is not installed", "install hapticlod[report]")
