"""The search problem, what a path sees, and how good a path is."""

from wisar_planner.search.area import SearchArea
from wisar_planner.search.bound import reachable_bound, upper_bound
from wisar_planner.search.find import distance_to_find
from wisar_planner.search.path import SearchPath
from wisar_planner.search.problem import SearchProblem
from wisar_planner.search.reward import scaled_reward, shaped_reward
from wisar_planner.search.seen_area import SeenArea

__all__ = [
    "SearchArea",
    "SearchPath",
    "SearchProblem",
    "SeenArea",
    "distance_to_find",
    "reachable_bound",
    "scaled_reward",
    "shaped_reward",
    "upper_bound",
]
