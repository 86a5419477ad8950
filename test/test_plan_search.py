"""The plan_search action: feedback, cancel, numbered errors with text."""

from __future__ import annotations

import copy
import signal
import time

from action_msgs.msg import GoalStatus
from rclpy.action import ActionClient

from wisar_msgs.action import PlanSearch
from wisar_msgs.msg import ProbabilityMap, SearchPlan
from wisar_planner.nodes.qos import LATCHED
from wisar_planner.planners import planner_names


def client_of(suite) -> ActionClient:
    client = ActionClient(suite.operator.node, PlanSearch, "plan_search")
    suite.wait(client.server_is_ready, "the planner's action")
    return client


class Asker:
    """One goal of plan_search and what came of it."""

    def __init__(self, suite) -> None:
        self._suite = suite
        self._client = client_of(suite)
        self.feedback: list[PlanSearch.Feedback] = []
        self.handle = None
        self._result = None

    def send(self, **goal: object) -> None:
        self.handle = self._begun(
            lambda: self._client.send_goal_async(
                PlanSearch.Goal(**goal), lambda m: self.feedback.append(m.feedback)
            ),
            "the goal's acceptance",
        ).result()
        self._result = self._begun(lambda: self.handle.get_result_async())

    def _begun(self, request, answer: str = ""):
        """Make a request on the operator's thread; return its future, done if `answer` is named."""
        task = self._suite.operator.run(request)
        self._suite.wait(task.done, "the request")
        if answer:
            self._suite.wait(task.result().done, answer)
        return task.result()

    def ask(self, **goal: object):
        """Send a goal and return its result."""
        self.send(**goal)
        return self.result()

    def done(self) -> bool:
        return self._result.done()

    def result(self):
        self._suite.wait(self._result.done, "the goal's result")
        answer = self._result.result()
        self.status = answer.status
        return answer.result


def test_a_goal_is_planned_published_and_returned(suite, mixture_file) -> None:
    suite.start_map(mixture_file)
    suite.start_planner(plan_on_map=False)
    suite.wait(lambda: suite.operator.map, "the map")
    asker = Asker(suite)
    suite.wait(lambda: "map '" in suite.log("planner"), "the planner's map")
    assert suite.operator.plan is None  # plan_on_map is off
    result = asker.ask(planner="lawnmower", budget=700.0, use_start=True, start=[-250.0, -200.0])
    assert asker.status == GoalStatus.STATUS_SUCCEEDED
    assert (result.error_code, result.error_text) == (result.NONE, "")
    assert (result.plan.planner, result.plan.budget) == ("lawnmower", 700.0)
    assert list(result.plan.start) == [-250.0, -200.0]
    suite.wait_for_plan()
    assert suite.operator.plan == result.plan


def test_errors_are_numbered_and_say_what_to_do(suite, mixture_file) -> None:
    suite.start_planner()
    asker = Asker(suite)
    result = asker.ask()
    assert result.error_code == result.NO_MAP
    assert "pdm_server" in result.error_text
    assert asker.status == GoalStatus.STATUS_ABORTED
    suite.start_map(mixture_file)
    suite.wait_for_plan()
    good = suite.operator.plan
    for goal, code, words in (
        ({"planner": "gredy"}, result.UNKNOWN_PLANNER, "greedy"),
        ({"budget": -5.0}, result.INVALID_REQUEST, "max_distance"),
        ({"budget": float("nan")}, result.INVALID_REQUEST, "max_distance"),
        ({"budget": 24.0}, result.INVALID_REQUEST, "step_length: 25 m is longer than the budget"),
        ({"use_start": True, "start": [1e6, 0.0]}, result.INVALID_REQUEST, "outside"),
        ({"use_start": True, "start": [float("inf"), 0.0]}, result.INVALID_REQUEST, "finite"),
        ({"planner": "greedy", "time_budget": 1.0}, result.INVALID_REQUEST, "time budget"),
        ({"planner": "lookahead", "time_budget": -1.0}, result.INVALID_REQUEST, "time_budget"),
    ):
        answer = asker.ask(**goal)
        assert answer.error_code == code, (goal, answer.error_text)
        assert words in answer.error_text, (goal, answer.error_text)
    time.sleep(0.2)
    assert suite.operator.plan == good


def test_a_budget_below_one_step_leaves_the_last_good_plan(suite, mixture_file) -> None:
    suite.start_map(mixture_file)
    suite.start_planner()
    suite.wait_for_plan()
    good = suite.operator.plan
    assert suite.set_parameter("max_distance", 24.0).successful
    refusal = "the last good plan stays: step_length: 25 m is longer than the max_distance of 24 m"
    suite.wait(lambda: refusal in suite.log("planner"), "the planner's refusal")
    time.sleep(0.2)
    assert suite.operator.plan == good


def test_feedback_then_cancel_returns_the_best_so_far(suite, mixture_file) -> None:
    suite.start_map(mixture_file)
    suite.start_planner("greedy")
    suite.wait_for_plan()
    good = suite.operator.plan
    asker = Asker(suite)
    asker.send(planner="lookahead", time_budget=60.0)
    suite.wait(lambda: len(asker.feedback) >= 3, "feedback")
    assert [f.elapsed for f in asker.feedback] == sorted(f.elapsed for f in asker.feedback)
    best = asker.feedback[-1].probability_efficiency
    began = time.monotonic()
    asker.handle.cancel_goal_async()
    result = asker.result()
    assert time.monotonic() - began < 5.0  # of a minute
    assert asker.status == GoalStatus.STATUS_CANCELED
    assert result.error_code == result.CANCELED
    assert result.plan.probability_efficiency >= best - 0.02
    assert suite.operator.plan == good  # a cancelled plan is not published


def test_a_new_map_ends_planning_on_the_old_one(suite, mixture_file) -> None:
    suite.start_map(mixture_file)
    suite.start_planner("greedy")
    suite.wait_for_plan()
    asker = Asker(suite)
    asker.send(planner="lookahead", time_budget=60.0)
    suite.wait(lambda: asker.feedback, "feedback")
    publish_newer_map(suite)
    result = asker.result()
    assert result.error_code == result.MAP_CHANGED
    suite.wait(lambda: suite.operator.plan.map_id == "newer", "the plan of the new map")


def publish_newer_map(suite) -> None:
    publisher = suite.operator.node.create_publisher(ProbabilityMap, "pdm", LATCHED)
    suite.wait(lambda: publisher.get_subscription_count() >= 2, "the planner's subscription")
    newer = copy.deepcopy(suite.operator.map)
    newer.id, newer.header.stamp.sec = "newer", newer.header.stamp.sec + 1
    publisher.publish(newer)


def test_waiting_goals_leave_the_node_free_to_answer(suite, mixture_file) -> None:
    suite.start_map(mixture_file)
    suite.start_planner("greedy")
    suite.wait_for_plan()
    goals = [Asker(suite) for _ in range(6)]
    for goal in goals:
        goal.send(planner="lookahead", time_budget=60.0)
    suite.wait(lambda: goals[0].feedback, "feedback of the first goal")
    began = time.monotonic()
    assert suite.set_parameter("swath_radius", 11.0).successful
    goals[-1].handle.cancel_goal_async()
    result = goals[-1].result()
    assert (result.error_code, result.error_text) == (result.CANCELED, "cancelled before planning")
    assert not goals[1].feedback  # they wait for their turn
    publish_newer_map(suite)
    for goal in goals[:-1]:
        result = goal.result()
        assert result.error_code == result.MAP_CHANGED
    assert time.monotonic() - began < 20.0  # of minutes
    suite.wait(lambda: suite.operator.plan.map_id == "newer", "the plan of the new map")


def test_goals_are_planned_in_the_order_in_which_they_came(suite, mixture_file) -> None:
    suite.start_map(mixture_file)
    suite.start_planner("greedy")
    suite.wait_for_plan()
    plans = follow_plans(suite)
    goals = [Asker(suite) for _ in range(5)]
    for number, goal in enumerate(goals):
        goal.send(planner="lookahead", time_budget=0.5, budget=500.0 + number)
    assert [goal.result().error_code for goal in goals] == [0] * 5
    suite.wait(lambda: plans and plans[-1].budget == 504.0, "the last plan")
    assert [p.budget for p in plans if p.budget < 1000.0] == [500.0, 501.0, 502.0, 503.0, 504.0]


PATIENCE_S = 6.0
"""How long the automatic plan takes, so that it can be disturbed."""


def follow_plans(suite) -> list[SearchPlan]:
    plans: list[SearchPlan] = []
    suite.operator.node.create_subscription(SearchPlan, "plan", plans.append, LATCHED)
    return plans


def start_patient_planner(suite, mixture_file) -> list[SearchPlan]:
    """Return the plans that follow once the automatic one is under way."""
    plans = follow_plans(suite)
    suite.start_map(mixture_file)
    suite.wait(lambda: suite.operator.map, "the map")
    suite.start_planner("lookahead", **{"lookahead.time_budget_s": PATIENCE_S})
    suite.wait(lambda: "map '" in suite.log("planner"), "the planner's map")
    return plans


def test_a_refused_goal_leaves_the_plan_under_way_alone(suite, mixture_file) -> None:
    plans = start_patient_planner(suite, mixture_file)
    asker = Asker(suite)
    result = asker.ask(planner="gredy")
    assert result.error_code == result.UNKNOWN_PLANNER
    assert not plans, "the goal came too late to disturb anything"
    suite.wait(lambda: plans, "the automatic plan")
    assert plans[0].planning_time > 0.9 * PATIENCE_S


def test_a_goal_that_ends_without_a_plan_gives_the_automatic_one_back(suite, mixture_file) -> None:
    plans = start_patient_planner(suite, mixture_file)
    asker = Asker(suite)
    asker.send(planner="lookahead", time_budget=60.0)
    suite.wait(lambda: asker.feedback, "feedback")
    asker.handle.cancel_goal_async()
    result = asker.result()
    assert result.error_code == result.CANCELED
    assert not plans  # neither what was cut off by the goal, nor the goal's
    suite.wait(lambda: plans, "the automatic plan")
    time.sleep(0.5)
    assert [p.planning_time > 0.9 * PATIENCE_S for p in plans] == [True]


def test_a_changed_parameter_publishes_no_half_plan_of_the_old_values(suite, mixture_file) -> None:
    plans = start_patient_planner(suite, mixture_file)
    assert suite.set_parameter("max_distance", 600.0).successful
    assert not plans
    suite.wait(lambda: plans, "the plan of the new budget")
    assert plans[0].budget == 600.0


def test_a_goal_learns_that_the_planner_is_told_to_end(suite, mixture_file) -> None:
    suite.start_map(mixture_file)
    process = suite.start_planner("greedy")
    suite.wait_for_plan()
    good = suite.operator.plan
    goals = [Asker(suite) for _ in range(2)]
    for goal in goals:
        goal.send(planner="lookahead", time_budget=60.0)
    suite.wait(lambda: goals[0].feedback, "feedback")
    process.send_signal(signal.SIGINT)
    assert process.wait(30.0) == 0
    time.sleep(0.5)
    for goal in goals:
        assert goal.done()
        result = goal.result()
        assert result.error_code == result.PLANNING_FAILED
        assert "told to end" in result.error_text
    assert "Traceback" not in suite.log("planner")
    assert suite.operator.plan == good


def test_every_planner_can_be_asked_for_by_name(suite, mixture_file) -> None:
    suite.start_map(mixture_file)
    suite.start_planner("greedy")
    suite.wait_for_plan()
    asker = Asker(suite)
    for name in planner_names():
        result = asker.ask(planner=name)
        assert (result.error_code, result.plan.planner) == (result.NONE, name), result.error_text
        assert 0.0 < result.plan.probability_efficiency <= result.plan.upper_bound
        assert result.plan.length <= result.plan.budget + 1e-6


def test_a_parameter_change_replans(suite, mixture_file) -> None:
    suite.start_map(mixture_file)
    suite.start_planner("greedy")
    suite.wait_for_plan()
    for name, value in (("max_distance", 600.0), ("planner", "sac")):
        assert suite.set_parameter(name, value).successful
    suite.wait(
        lambda: (suite.operator.plan.planner, suite.operator.plan.budget) == ("sac", 600.0),
        "the plan of the new planner and budget",
    )
