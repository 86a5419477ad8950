"""The planner node in this process: which requests it takes for a problem."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
import rclpy
from rclpy.parameter import Parameter

from wisar_msgs.action import PlanSearch
from wisar_planner.nodes import conversions
from wisar_planner.nodes.conversions import LocatedMap
from wisar_planner.nodes.planner import GoalError, PlannerNode, _AutomaticPlan
from wisar_planner.pdm import GaussianMixture
from wisar_planner.pdm.geodesy import GeoOrigin
from wisar_planner.search import SearchArea

LOCATED = LocatedMap(
    "m",
    GaussianMixture([1.0], [[10.0, 20.0]], [500.0 * np.eye(2)]),
    SearchArea.rectangle(-100.0, -100.0, 100.0, 100.0),
    GeoOrigin(56.8, -5.0),
    1,
    "map",
    "test",
)


@pytest.fixture
def planner() -> Iterator[PlannerNode]:
    rclpy.init(args=[])
    node = PlannerNode()
    node.set_parameters(
        [
            Parameter("planner", value="greedy"),
            Parameter("step_length", value=25.0),
            Parameter("plan_on_map", value=False),
        ]
    )
    node._maps.take(conversions.map_to_msg(LOCATED))
    yield node
    node.close()
    node.destroy_node()
    rclpy.try_shutdown()


def test_a_goal_that_cannot_fly_one_step_is_refused(planner) -> None:
    with pytest.raises(GoalError, match="not one step can be flown; give a shorter") as refused:
        planner._read_goal(PlanSearch.Goal(budget=24.9))
    assert refused.value.code == PlanSearch.Result.INVALID_REQUEST
    assert "step_length: 25 m is longer than the budget of 24.9 m" in str(refused.value)
    assert planner._read_goal(PlanSearch.Goal(budget=25.0)).problem.steps == 1


@pytest.mark.parametrize("budget", [1e9, 1e308])
def test_a_goal_of_far_too_many_steps_is_refused(planner, budget) -> None:
    with pytest.raises(GoalError, match="give a longer step_length or a smaller budget") as refused:
        planner._read_goal(PlanSearch.Goal(budget=budget))
    assert refused.value.code == PlanSearch.Result.INVALID_REQUEST
    planner.set_parameters([Parameter("max_distance", value=1e9)])
    with pytest.raises(GoalError, match=r"1e\+09 m in steps of 25 m are 4e\+07 steps, .* max_dist"):
        planner._read_goal(PlanSearch.Goal())


def test_a_goals_time_is_kept_whatever_number_of_iterations_is_set(planner) -> None:
    planner.set_parameters([Parameter("lookahead.max_iterations", value=5000)])
    goal = PlanSearch.Goal(planner="lookahead")
    assert planner._read_goal(goal).options["max_iterations"] == 5000
    goal.time_budget = 3.0
    options = planner._read_goal(goal).options
    assert (options["time_budget_s"], options["max_iterations"]) == (3.0, 0)


def test_parameters_that_cannot_fly_one_step_leave_the_last_good_plan(planner, monkeypatch) -> None:
    published, said = [], []
    monkeypatch.setattr(planner, "_publish", published.append)
    logger = planner.get_logger()
    monkeypatch.setattr(logger, "error", said.append)
    monkeypatch.setattr(planner, "get_logger", lambda: logger)

    def plan() -> None:
        planner._automatic = _AutomaticPlan(planner._maps.current)
        planner._plan_on_map(planner._automatic)

    planner.set_parameters([Parameter("max_distance", value=24.0)])
    plan()
    assert published == []
    (line,) = said
    assert (
        "no plan, the last good plan stays: step_length: 25 m is longer than the max_dist" in line
    )
    planner.set_parameters([Parameter("max_distance", value=60.0)])
    plan()
    assert [len(each.path.waypoints) for each in published] == [3]
