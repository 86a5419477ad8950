"""Each wrong input is refused with a line that says what is wrong; the last good state stays."""

from __future__ import annotations

import copy
import math
import time
from array import array
from collections.abc import Callable

import pytest
from rcl_interfaces.msg import ParameterType
from rcl_interfaces.srv import DescribeParameters, ListParameters

from wisar_msgs.msg import MissionStatus, ProbabilityMap, Ring, SearchPlan
from wisar_planner.nodes.qos import LATCHED


def nan_mean(m: ProbabilityMap) -> None:
    m.means[0] = math.nan


def weights_that_do_not_sum(m: ProbabilityMap) -> None:
    m.weights[0] = 0.9


def negative_weight(m: ProbabilityMap) -> None:
    m.weights[0], m.weights[1] = -0.5, 1.5


def no_components(m: ProbabilityMap) -> None:
    m.weights, m.means, m.covariances = [], [], []


def indefinite_covariance(m: ProbabilityMap) -> None:
    m.covariances[1] = m.covariances[2] = 1e5


def asymmetric_covariance(m: ProbabilityMap) -> None:
    m.covariances[1] = 0.0


def needle(m: ProbabilityMap) -> None:
    m.covariances[:4] = array("d", [1e-12, 0.0, 0.0, 1e-12])


def component_beyond_the_earth(m: ProbabilityMap) -> None:
    m.means[0] = 1e12


def arrays_of_different_length(m: ProbabilityMap) -> None:
    m.means = m.means[:-2]


def empty_area(m: ProbabilityMap) -> None:
    m.area.parts = []


def area_without_extent(m: ProbabilityMap) -> None:
    m.area.parts[0].exterior = Ring(x=[0.0, 1.0, 2.0], y=[0.0, 0.0, 0.0])


def area_far_from_the_map(m: ProbabilityMap) -> None:
    ring = m.area.parts[0].exterior
    ring.x = [x + 1e6 for x in ring.x]


def infinite_area(m: ProbabilityMap) -> None:
    m.area.parts[0].exterior.x[0] = math.inf


def latitude_off_the_earth(m: ProbabilityMap) -> None:
    m.origin.latitude = 95.0


def no_id(m: ProbabilityMap) -> None:
    m.id = ""


def older_than_the_current_map(m: ProbabilityMap) -> None:
    m.id = "stale"
    m.header.stamp.sec -= 3600


WRONG_MAPS: dict[Callable[[ProbabilityMap], None], str] = {
    nan_mean: "means",
    weights_that_do_not_sum: "weights",
    negative_weight: "weights",
    no_components: "weights",
    indefinite_covariance: "positive definite",
    asymmetric_covariance: "symmetric",
    needle: "standard deviation of 1e-06 m",
    component_beyond_the_earth: "means must be metres from the origin",
    arrays_of_different_length: "means has 2 values",
    empty_area: "area is empty",
    area_without_extent: "area",
    area_far_from_the_map: "area holds no probability",
    infinite_area: "finite",
    latitude_off_the_earth: "latitude",
    no_id: "id is empty",
    older_than_the_current_map: "older than the current map",
}


def test_a_wrong_map_is_refused_and_the_plan_stays(suite, mixture_file) -> None:
    suite.start_map(mixture_file)
    suite.start_planner()
    suite.wait_for_plan()
    good_map, good_plan = suite.operator.map, suite.operator.plan
    publisher = suite.operator.node.create_publisher(ProbabilityMap, "pdm", LATCHED)
    suite.wait(lambda: publisher.get_subscription_count() >= 2, "the planner's subscription")
    for number, (spoil, reason) in enumerate(WRONG_MAPS.items(), start=1):
        wrong = copy.deepcopy(good_map)
        spoil(wrong)
        publisher.publish(wrong)
        suite.wait(lambda n=number: suite.log("planner").count("map refused") >= n, spoil.__name__)
        refusal = [line for line in suite.log("planner").splitlines() if "map refused" in line][-1]
        assert reason in refusal, f"{spoil.__name__}: {refusal}"
        assert "Traceback" not in suite.log("planner")
    assert suite.operator.plan == good_plan
    # The node still works: a good map that is newer is planned on.
    newer = copy.deepcopy(good_map)
    newer.id, newer.header.stamp.sec = "newer", good_map.header.stamp.sec + 1
    publisher.publish(newer)
    suite.wait(lambda: suite.operator.plan.map_id == "newer", "the plan of the good map")


def plan_without_waypoints(p: SearchPlan) -> None:
    p.x, p.y, p.probability = [], [], []


def plan_with_nan(p: SearchPlan) -> None:
    p.x[3] = math.nan


def plan_with_a_missing_value(p: SearchPlan) -> None:
    p.y = p.y[:-1]


def plan_beyond_certainty(p: SearchPlan) -> None:
    p.probability[-1] = 1.5


def plan_without_swath(p: SearchPlan) -> None:
    p.swath_radius = 0.0


def plan_with_an_endless_swath(p: SearchPlan) -> None:
    p.swath_radius = 1e300


def plan_to_the_stars(p: SearchPlan) -> None:
    p.x[3] = 1e300


def plan_off_the_earth(p: SearchPlan) -> None:
    p.origin.longitude = math.nan


WRONG_PLANS = {
    plan_without_waypoints: "at least one waypoint",
    plan_with_nan: "finite",
    plan_with_a_missing_value: "equally long",
    plan_beyond_certainty: "between 0 and 1",
    plan_without_swath: "swath_radius",
    plan_with_an_endless_swath: "swath_radius",
    plan_to_the_stars: "waypoints must be metres from the origin",
    plan_off_the_earth: "longitude",
}


def test_a_wrong_plan_is_refused_by_drone_and_bridge(suite, mixture_file) -> None:
    suite.start_autopilot()
    suite.start_map(mixture_file)
    suite.start_planner()
    suite.start_drone()
    suite.start_bridge()
    operator = suite.operator
    suite.wait_for_flight()
    flown = operator.progress
    publisher = operator.node.create_publisher(SearchPlan, "plan", LATCHED)
    suite.wait(lambda: publisher.get_subscription_count() >= 3, "drone and bridge")
    good = operator.plan
    # A reader keeps one plan: a wrong one that comes before the good one was read replaces it.
    suite.wait(operator.can_upload, "the good plan at the bridge")
    for number, (spoil, reason) in enumerate(WRONG_PLANS.items(), start=1):
        wrong = copy.deepcopy(good)
        spoil(wrong)
        publisher.publish(wrong)
        for name in ("sim_drone", "mavlink_bridge"):
            suite.wait(
                lambda n=number, node=name: suite.log(node).count("plan refused") >= n,
                f"{name}: {spoil.__name__}",
            )
            refusal = [x for x in suite.log(name).splitlines() if "plan refused" in x][-1]
            assert reason in refusal, f"{spoil.__name__}: {refusal}"
    assert operator.progress == flown
    # What the bridge uploads is still the good plan.
    suite.wait(operator.can_upload, "the bridge's link")
    operator.request_upload(good.map_id)
    suite.wait(lambda: operator.upload_result, "the upload")
    assert operator.upload_result.error_code == 0, operator.upload_result.error_text
    assert operator.upload_result.items == len(good.x) + 3


def test_a_plan_of_another_map_waits_and_is_not_uploaded_by_mistake(suite, mixture_file) -> None:
    suite.start_autopilot()
    suite.start_map(mixture_file)
    suite.start_planner()
    suite.start_drone()
    suite.start_bridge()
    operator = suite.operator
    suite.wait_for_flight()
    stale = copy.deepcopy(operator.plan)
    stale.map_id = "another map"
    publisher = operator.node.create_publisher(SearchPlan, "plan", LATCHED)
    suite.wait(lambda: publisher.get_subscription_count() >= 3, "drone and bridge")
    flown = operator.progress
    publisher.publish(stale)
    warning = "plan of map 'another map' waits for that map"
    suite.wait(lambda: warning in suite.log("sim_drone"), "the drone's warning")
    assert operator.progress == flown
    suite.wait(
        lambda: operator.mission and operator.mission.planned_map_id == "another map",
        "the bridge's plan",
    )
    suite.wait_for_bridge()
    operator.request_upload(flown.map_id)
    suite.wait(lambda: operator.upload_result, "the bridge's answer")
    assert operator.upload_result.error_code == operator.upload_result.WRONG_MAP
    assert "another map" in operator.upload_result.error_text


def test_an_upload_without_plan_or_link_says_so(suite, mixture_file) -> None:
    suite.start_bridge()
    operator = suite.operator
    suite.wait_for_bridge()
    assert operator.mission.state == MissionStatus.NO_LINK
    operator.request_upload()
    suite.wait(lambda: operator.upload_result, "the answer without a plan")
    assert operator.upload_result.error_code == operator.upload_result.NO_PLAN
    suite.start_map(mixture_file)
    suite.start_planner()
    suite.wait(lambda: "with" in suite.log("mavlink_bridge") and operator.plan, "the plan")
    suite.wait(lambda: "call upload_mission" in suite.log("mavlink_bridge"), "the bridge's plan")
    operator.request_upload()
    suite.wait(lambda: operator.upload_result, "the answer without a link")
    assert operator.upload_result.error_code == operator.upload_result.NO_LINK


WRONG_PARAMETERS = (
    ("planner", "teleport"),
    ("swath_radius", -1.0),
    ("step_length", 0.0),
    ("max_distance", math.nan),
    ("max_distance", math.inf),
    ("start", [1.0, 2.0, 3.0]),
    ("start", [math.nan, 0.0]),
    ("lawnmower.lane_spacing", -5.0),
)


def test_a_wrong_parameter_is_refused(suite, mixture_file) -> None:
    suite.start_map(mixture_file)
    suite.start_planner()
    suite.wait_for_plan()
    good = suite.operator.plan
    for name, value in WRONG_PARAMETERS:
        result = suite.set_parameter(name, value)
        assert not result.successful, name
        assert result.reason
    time.sleep(0.3)
    assert suite.operator.plan == good


@pytest.mark.parametrize(
    ("package", "node", "choices"),
    [
        ("wisar_planner", "pdm_server", ()),
        ("wisar_planner", "planner", ()),
        ("wisar_planner", "mavlink_bridge", ("end", "altitude_frame")),
        ("wisar_sim", "sim_drone", ("method",)),
    ],
)
def test_every_parameter_has_a_meaning_and_its_values_are_checked(
    suite, package: str, node: str, choices: tuple[str, ...]
) -> None:
    suite.start(package, node)
    found = suite.ask(ListParameters, f"{node}/list_parameters", ListParameters.Request())
    names = [name for name in found.result.names if not name.startswith(ROS_OWN)]
    assert names
    request = DescribeParameters.Request(names=names)
    for each in suite.ask(DescribeParameters, f"{node}/describe_parameters", request).descriptors:
        assert each.description, each.name
        if each.type == ParameterType.PARAMETER_INTEGER:
            assert each.integer_range, each.name
        if each.type == ParameterType.PARAMETER_DOUBLE:
            (limits,) = each.floating_point_range
            assert math.isfinite(limits.from_value), each.name
            assert math.isfinite(limits.to_value), each.name
    for name in choices:
        result = suite.set_parameter(name, "teleport", node)
        assert not result.successful
        assert f"{name} must be one of" in result.reason
    if choices:
        suite.processes.kill(node)
        wrong_from_the_start = suite.start(package, node, **{choices[0]: "teleport"})
        assert wrong_from_the_start.wait(timeout=60) == 2
        assert f"{choices[0]} must be one of" in suite.log(node)


ROS_OWN = ("use_sim_time", "start_type_description_service", "qos_overrides")
