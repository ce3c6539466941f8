"""What uses the model: optimisation, verification, comparison, deployment, the command line.

`tuning.pareto` is imported when it is first used, so that `import tuning` costs nothing.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tuning.front import pareto

__all__ = ["pareto"]


def __getattr__(name: str) -> Any:
    if name == "pareto":
        from tuning.front import pareto

        return pareto
    raise AttributeError(f"module 'tuning' has no attribute {name!r}")
