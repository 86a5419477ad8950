"""What is refused before it is sent, and camera geometry."""

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from wisar_planner.errors import InvalidInput
from wisar_planner.mavlink.camera import altitude_for_swath
from wisar_planner.mavlink.checks import Limits, check_mission
from wisar_planner.mavlink.mission import Mission, MissionItem, build_mission, fence_items

# About 1 km by 1 km around the origin of latitude and longitude, where a degree is 111 km.
KM = 1.0 / 111.195
PLAN = [(0.0, 0.0), (0.0, KM), (KM, KM)]
ROOM = [(-KM, -KM), (-KM, 2 * KM), (2 * KM, 2 * KM), (2 * KM, -KM)]

WEDGE = [(-KM, 0.4 * KM), (KM, 0.4 * KM), (KM, 0.6 * KM)]


def mission(plan=PLAN, **changes):
    return build_mission(plan, **{"altitude_m": 40.0, **changes})


def test_a_good_mission_passes():
    good = mission(
        inclusions=[ROOM],
        exclusions=[[(0.3 * KM, 0.1 * KM), (0.5 * KM, 0.1 * KM), (0.4 * KM, 0.3 * KM)]],
    )
    limits = Limits(endurance_m=5_000.0)
    assert check_mission(good, limits, vehicle=(0.0, 0.0), home=(0.0, 0.0)) == ()
    assert check_mission(good) == ()


@pytest.mark.parametrize(
    ("bad", "limits", "words"),
    [
        (mission(altitude_m=130.0), Limits(), "130 m is outside the limits"),
        (mission(altitude_m=1.0), Limits(), "outside the limits"),
        (mission(inclusions=[[ROOM[0], ROOM[2], ROOM[3]]]), Limits(), "leaves the fence"),
        (mission(exclusions=[WEDGE]), Limits(), "keep-out"),
        (mission(inclusions=[[ROOM[0], ROOM[2], ROOM[1], ROOM[3]]]), Limits(), "crosses itself"),
        (mission(), Limits(endurance_m=3_000.0), "longer than the endurance"),
        (mission(), Limits(first_waypoint_m=100.0), "first waypoint is 501 m"),
        (mission(), Limits(most_items=4), "5 mission items are more than the limit of 4"),
        (Mission(), Limits(), "no waypoint"),
    ],
)  # fmt: skip
def test_what_cannot_be_right_is_refused(bad, limits, words):
    reasons = check_mission(bad, limits, vehicle=(0.0, -0.5 * KM), home=(0.0, -0.5 * KM))
    assert any(words in reason for reason in reasons), reasons


def test_the_leg_home_counts():
    # 0.5 km there, 2 km of search, and sqrt(1 + 1.5^2) = 1.8 km back.
    for endurance, refused in ((4_350.0, False), (4_250.0, True)):
        reasons = check_mission(mission(), Limits(endurance_m=endurance), vehicle=(0.0, -0.5 * KM))
        assert bool(reasons) is refused


def test_the_ways_there_and_home_stay_inside_the_fence_too():
    keep_out = [(-0.6 * KM, -0.1 * KM), (-0.4 * KM, -0.1 * KM), (-0.5 * KM, 0.3 * KM)]
    fenced = mission(inclusions=[ROOM], exclusions=[keep_out])
    near, outside, behind = (0.2 * KM, 0.2 * KM), (0.0, -1.5 * KM), (-0.9 * KM, 0.0)
    assert check_mission(fenced, vehicle=near, home=near) == ()
    there, back = check_mission(fenced, vehicle=outside)
    assert "to the first waypoint leaves the fence" in there
    assert "home from the last waypoint leaves the fence" in back
    (there,) = check_mission(fenced, vehicle=behind, home=near)
    assert "to the first waypoint crosses a keep-out area" in there
    stays = mission(inclusions=[ROOM], end="loiter")
    assert check_mission(stays, vehicle=near, home=outside) == ()


def test_a_leg_between_waypoints_inside_may_still_leave_the_fence():
    c_shape = [(0, 0), (0, 4), (3, 4), (3, 3), (1, 3), (1, 1), (3, 1), (3, 0)]
    ring = [(a * KM / 4, b * KM / 4) for a, b in c_shape]
    across = mission(
        [(2.5 * KM / 4, 0.5 * KM / 4), (2.5 * KM / 4, 3.5 * KM / 4)], inclusions=[ring]
    )
    assert "leaves the fence" in check_mission(across)[0]


def test_every_inclusion_polygon_holds():
    half = [ROOM[0], ROOM[1], (0.5 * KM, 2 * KM), (0.5 * KM, -KM)]
    assert check_mission(mission(inclusions=[ROOM])) == ()
    assert "leaves the fence" in check_mission(mission(inclusions=[ROOM, half]))[0]


@pytest.mark.parametrize(
    "wrong",
    [
        {"z": math.nan},
        {"z": math.inf},
        {"x": 950_000_000},
        {"y": -1_900_000_000},
        {"params": (math.inf, 0.0, 0.0, 0.0)},
    ],
)
def test_numbers_that_cannot_be_are_found_in_every_list(wrong):
    item = MissionItem.at(16, 0.0, 0.0, 40.0)
    bad = replace(item, **wrong)
    whole = mission()
    for name in ("items", "fence", "rally"):
        spoiled = replace(whole, **{name: (*getattr(whole, name), bad)})
        assert any("cannot be" in reason for reason in check_mission(spoiled))


def test_an_incomplete_fence_is_refused():
    whole = fence_items([ROOM])
    assert "not complete" in check_mission(replace(mission(), fence=whole[:3]))[0]


@pytest.mark.parametrize(
    "wrong",
    [
        {"endurance_m": -1.0},
        {"first_waypoint_m": math.nan},
        {"min_altitude_m": 100.0, "max_altitude_m": 50.0},
        {"most_items": 70_000},
    ],
)
def test_limits_that_cannot_be_are_refused(wrong):
    with pytest.raises(InvalidInput, match=next(iter(wrong))):
        Limits(**wrong)


@given(st.floats(0.1, 1e3), st.floats(0.05, 3.0))
def test_height_and_swath_belong_together(radius, angle):
    height = altitude_for_swath(radius, angle)
    # The edge of the swath is seen under half the angle of view.
    assert math.atan2(radius, height) == pytest.approx(angle / 2.0)


@pytest.mark.parametrize(
    "call",
    [
        lambda: altitude_for_swath(0.0, 1.0),
        lambda: altitude_for_swath(1.0, math.pi),
        lambda: altitude_for_swath(math.nan, 1.0),
    ],
)
def test_impossible_cameras_are_refused(call):
    with pytest.raises(InvalidInput):
        call()
