"""Search planners: one file each, behind one protocol and one registry."""

from wisar_planner.planners.base import Option, Planner, PlanProgress
from wisar_planner.planners.registry import make_planner, planner_names, planner_options

__all__ = [
    "Option",
    "PlanProgress",
    "Planner",
    "make_planner",
    "planner_names",
    "planner_options",
]
