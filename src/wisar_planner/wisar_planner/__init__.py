"""Search-and-rescue path planning for drones over a probability map.

The names below are the library's front door; each is loaded when it is first used, so that
importing the package costs nothing.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from wisar_planner.errors import InvalidInput
    from wisar_planner.pdm import GaussianMixture, Grid, ProbabilityMap, RasterMap
    from wisar_planner.planners.registry import make_planner, planner_names
    from wisar_planner.search import SearchArea, SearchPath, SearchProblem, SeenArea

__all__ = [
    "GaussianMixture",
    "Grid",
    "InvalidInput",
    "ProbabilityMap",
    "RasterMap",
    "SearchArea",
    "SearchPath",
    "SearchProblem",
    "SeenArea",
    "make_planner",
    "planner_names",
]

_HOMES = {
    "GaussianMixture": "pdm",
    "Grid": "pdm",
    "ProbabilityMap": "pdm",
    "RasterMap": "pdm",
    "InvalidInput": "errors",
    "SearchArea": "search",
    "SearchPath": "search",
    "SearchProblem": "search",
    "SeenArea": "search",
    "make_planner": "planners.registry",
    "planner_names": "planners.registry",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
