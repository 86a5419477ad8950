"""Flying a mission: dynamics, wind, modes, and what the vehicle says about it."""

import math
from collections import Counter

import numpy as np
import pytest
from pymavlink.dialects.v20 import common as mav

from wisar_planner.mavlink.exchange import Address, item_message
from wisar_planner.mavlink.mission import build_mission, fence_items
from wisar_planner.pdm.geodesy import GeoOrigin, LocalFrame
from wisar_sim.autopilot.autopilot import Autopilot
from wisar_sim.autopilot.dynamics import Airframe, Body
from wisar_sim.autopilot.profile import PROFILES

HOME = GeoOrigin(57.0, -4.0, 100.0)
FRAME = LocalFrame(HOME)
CORNERS = np.array([[0.0, 0.0], [60.0, 0.0], [60.0, 40.0]])


class Bench:
    """An autopilot with a clock, and a client that only asks."""

    def __init__(self, profile="px4", **options):
        self.autopilot = Autopilot(PROFILES[profile], HOME, **options)
        self.now = 0.0
        self.heard = []
        self.step(7.0)  # past ArduPilot's start

    def step(self, seconds, dt=0.05):
        end = self.now + seconds
        while self.now < end:
            self.now += dt
            self.heard += self.autopilot.tick(self.now)

    def send(self, message):
        message._header.srcSystem, message._header.srcComponent = 245, 190
        out = self.autopilot.receive(message, self.now)
        self.heard += out
        return out

    def command(self, code, *params):
        padded = (*params, *(0.0,) * (7 - len(params)))
        out = self.send(mav.MAVLink_command_long_message(1, 1, code, 0, *padded))
        return next(m.result for m in out if m.get_type() == "COMMAND_ACK")

    def upload(self, mission, wait=1.1):
        for kind, items in ((1, mission.fence), (0, mission.items)):
            if self.autopilot.profile.home_item and kind == 0:
                items = (items[0], *items)
            self.send(mav.MAVLink_mission_count_message(1, 1, len(items), kind))
            for n, item in enumerate(items):
                self.send(item_message(item, n, kind, Address(1, 1)))
        self.step(wait)  # PX4 checks the mission first

    def last(self, name):
        return next(m for m in reversed(self.heard) if m.get_type() == name)

    def arm(self):
        return self.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)

    def start(self):
        return self.command(mav.MAV_CMD_MISSION_START)


def mission(**changes):
    return build_mission(
        FRAME.to_geodetic(CORNERS), **{"altitude_m": 20.0, "speed": 6.0, **changes}
    )


OK = mav.MAV_RESULT_ACCEPTED


@pytest.mark.parametrize("profile", sorted(PROFILES))
def test_a_mission_is_flown_to_its_end(profile):
    bench = Bench(profile)
    bench.upload(mission())
    if profile != "px4":
        assert bench.start() != OK  # not armed
    assert bench.arm() == OK
    assert bench.start() == OK
    track = []
    for _ in range(1200):
        bench.step(0.1)
        track.append(bench.autopilot.vehicle.body.position.copy())
        if not bench.autopilot.vehicle.armed:
            break
    track = np.array(track)
    for corner in CORNERS:
        nearest = np.linalg.norm(track[:, :2] - corner, axis=1).min()
        assert nearest < 2.5
    assert track[:, 2].max() == pytest.approx(20.0, abs=10.5)  # the return climbs to 30 m
    assert np.linalg.norm(track[-1]) < 2.5
    offset = 1 if profile == "ardupilot" else 0
    reached = [m.seq for m in bench.heard if m.get_type() == "MISSION_ITEM_REACHED"]
    told = 5 if profile == "px4" else 6  # PX4 does not tell the return
    assert reached == [n + offset for n in range(told)]
    bench.step(1.1)
    heartbeat = bench.last("HEARTBEAT")
    assert heartbeat.autopilot == PROFILES[profile].autopilot
    assert not heartbeat.base_mode & mav.MAV_MODE_FLAG_SAFETY_ARMED


def test_px4_checks_a_new_mission_first_and_arms_to_start_it():
    bench = Bench("px4")
    bench.upload(mission(), wait=0.5)
    assert bench.start() == mav.MAV_RESULT_DENIED
    assert "no valid mission" in bench.last("STATUSTEXT").text
    assert not bench.autopilot.vehicle.armed
    bench.step(0.7)
    assert bench.start() == OK
    assert bench.autopilot.vehicle.armed


def test_positions_are_told_in_mavlinks_units():
    bench = Bench()
    bench.upload(mission(end="loiter"))
    bench.arm()
    bench.start()
    bench.step(60.0)
    position = bench.last("GLOBAL_POSITION_INT")
    expected = FRAME.to_geodetic(CORNERS[-1:])[0]
    assert (position.lat, position.lon) == pytest.approx(expected * 1e7, abs=250)
    assert position.relative_alt == pytest.approx(20_000, abs=500)
    assert position.alt - position.relative_alt == 100_000


def test_speed_up_flies_faster_not_differently():
    slow, fast = Bench(), Bench(speed_up=10.0)
    for bench, seconds in ((slow, 20.0), (fast, 2.0)):
        bench.upload(mission(end="loiter"))
        bench.arm()
        bench.start()
        bench.step(seconds)
    difference = slow.autopilot.vehicle.body.position - fast.autopilot.vehicle.body.position
    assert np.linalg.norm(difference) < 10.0


def test_pause_holds_and_resume_goes_on():
    bench = Bench("mavsdk")
    bench.upload(mission())
    bench.arm()
    bench.start()
    bench.step(12.0)
    assert bench.command(mav.MAV_CMD_DO_PAUSE_CONTINUE, 0.0) == OK
    bench.step(5.0)
    held = bench.autopilot.vehicle.body.position.copy()
    bench.step(5.0)
    assert np.linalg.norm(bench.autopilot.vehicle.body.position - held) < 0.5
    current = bench.autopilot.vehicle.current
    assert bench.command(mav.MAV_CMD_DO_PAUSE_CONTINUE, 1.0) == OK
    bench.step(30.0)
    assert bench.autopilot.vehicle.current > current


@pytest.mark.parametrize(
    ("profile", "params"), [("px4", (1.0, 4.0, 5.0)), ("ardupilot", (1.0, 6.0, 0.0))]
)
def test_return_to_launch_by_mode(profile, params):
    bench = Bench(profile)
    bench.upload(mission())
    bench.arm()
    bench.start()
    bench.step(15.0)
    assert bench.command(mav.MAV_CMD_DO_SET_MODE, *params) == OK
    bench.step(60.0)
    assert not bench.autopilot.vehicle.armed
    assert np.linalg.norm(bench.autopilot.vehicle.body.position) < 2.5


def test_a_mission_outside_an_old_fence_is_acknowledged_but_not_flown():
    bench = Bench()
    far = FRAME.to_geodetic([[500.0, 500.0], [600.0, 500.0], [600.0, 600.0]])
    bench.upload(build_mission(FRAME.to_geodetic(CORNERS), altitude_m=20.0, inclusions=[far]))
    assert bench.last("MISSION_ACK").type == mav.MAV_MISSION_ACCEPTED
    bench.arm()
    assert bench.start() == mav.MAV_RESULT_DENIED
    assert "outside the fence" in bench.last("STATUSTEXT").text
    bench.send(mav.MAVLink_mission_clear_all_message(1, 1, 1))
    assert bench.start() == OK


def test_a_mission_into_a_keep_out_area_is_not_flown():
    bench = Bench()
    bench.upload(mission(exclusions=[FRAME.to_geodetic([[50.0, -9.0], [70.0, -9.0], [60.0, 9.0]])]))
    bench.arm()
    assert bench.start() == mav.MAV_RESULT_DENIED


def test_places_outside_the_earth_are_not_flown():
    bench = Bench()  # PX4 acknowledges them
    bench.send(mav.MAVLink_mission_count_message(1, 1, 1, 0))
    bench.send(
        mav.MAVLink_mission_item_int_message(
            1, 1, 0, 6, 16, 0, 1, 0, 0, 0, 0, 950_000_000, 0, 20.0, 0
        )
    )
    assert bench.last("MISSION_ACK").type == mav.MAV_MISSION_ACCEPTED
    bench.arm()
    assert bench.start() == mav.MAV_RESULT_DENIED


def test_motors_do_not_stop_in_the_air():
    bench = Bench()
    bench.upload(mission())
    bench.arm()
    bench.start()
    bench.step(10.0)
    assert bench.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 0.0) == mav.MAV_RESULT_DENIED


@pytest.mark.parametrize("profile", ["px4", "ardupilot"])
def test_a_new_mission_in_flight_is_flown_at_once(profile):
    bench = Bench(profile)
    bench.upload(mission(end="loiter"))
    bench.arm()
    bench.start()
    bench.step(15.0)
    flown = bench.autopilot.vehicle.current
    assert flown > 1
    bench.upload(mission(altitude_m=45.0, end="loiter"), wait=0.0)
    assert bench.autopilot.vehicle.current == (0 if profile == "px4" else flown)
    bench.step(30.0)
    assert bench.autopilot.vehicle.mode.value == "mission"
    assert bench.autopilot.vehicle.body.position[2] == pytest.approx(45.0, abs=1.0)


@pytest.mark.parametrize("profile", ["px4", "ardupilot"])
def test_a_start_in_flight(profile):
    """ArduPilot goes on with the current item; choosing one changes no mode."""
    bench = Bench(profile)
    bench.upload(mission())
    bench.arm()
    bench.start()
    bench.step(15.0)
    vehicle = bench.autopilot.vehicle
    hold = (1.0, 4.0, 3.0) if profile == "px4" else (1.0, 4.0)
    assert bench.command(mav.MAV_CMD_DO_SET_MODE, *hold) == OK
    flown = vehicle.current
    assert flown > 1
    assert bench.start() == OK
    assert vehicle.current == (0 if profile == "px4" else flown)
    assert bench.command(mav.MAV_CMD_DO_SET_MODE, *hold) == OK
    first = 0.0 if profile == "px4" else 1.0
    assert bench.command(mav.MAV_CMD_DO_SET_MISSION_CURRENT, first) == OK
    assert (vehicle.current, vehicle.mode.value) == (0, "hold")
    assert bench.start() == OK
    assert vehicle.current == 0


def test_messages_to_others_are_ignored():
    bench = Bench()
    message = mav.MAVLink_mission_count_message(2, 1, 3, 0)
    assert bench.send(message) == []
    assert bench.send(mav.MAVLink_mission_count_message(1, 55, 3, 0)) == []


def test_unknown_commands_and_nan_are_answered():
    bench = Bench()
    assert bench.command(31_999) == mav.MAV_RESULT_UNSUPPORTED
    assert bench.command(mav.MAV_CMD_DO_SET_MODE, 1.0, math.nan) == mav.MAV_RESULT_DENIED
    assert bench.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, math.nan) == mav.MAV_RESULT_DENIED


@pytest.mark.parametrize("profile", ["px4", "mavsdk"])
@pytest.mark.parametrize("corners", [math.nan, math.inf, -math.inf])
def test_a_fence_without_a_number_of_corners_is_kept_but_not_judged(profile, corners):
    bench = Bench(profile)
    bench.upload(mission())
    place = (round(HOME.latitude * 1e7), round(HOME.longitude * 1e7))
    inclusion = mav.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION
    bench.send(mav.MAVLink_mission_count_message(1, 1, 1, 1))
    bench.send(
        mav.MAVLink_mission_item_int_message(
            1, 1, 0, 0, inclusion, 0, 1, corners, 0, 0, 0, *place, 0.0, 1
        )
    )
    assert bench.last("MISSION_ACK").type == mav.MAV_MISSION_ACCEPTED
    assert bench.last("MISSION_ACK").mission_type == mav.MAV_MISSION_TYPE_FENCE
    bench.step(1.1)
    bench.arm()
    assert bench.start() == OK


def test_fences_of_circles_are_kept_but_not_judged():
    bench = Bench()
    circle = fence_items([FRAME.to_geodetic(CORNERS)])[:1]
    assert circle
    bench.upload(mission())
    bench.arm()
    assert bench.start() == OK


# -- dynamics ------------------------------------------------------------------------------------


def fly(wind=(0.0, 0.0), speed=8.0, seconds=60.0, dt=0.05):
    body = Body(Airframe(), wind=wind)
    body.position[2] = 20.0
    target = np.array([100.0, 0.0, 20.0])
    track = []
    for _ in range(int(seconds / dt)):
        body.fly_towards(target, speed, dt)
        track.append((body.position.copy(), body.velocity.copy()))
    return body, np.array([p for p, _ in track]), np.array([v for _, v in track])


@pytest.mark.parametrize("wind", [(0.0, 0.0), (6.0, 0.0), (0.0, -9.0), (-8.0, 5.0)])
def test_the_target_is_reached_and_held_in_wind(wind):
    body, _, velocities = fly(wind)
    assert np.linalg.norm(body.position[:2] - [100.0, 0.0]) < 1.0
    speeds = np.linalg.norm(velocities[:, :2], axis=1)
    assert speeds.max() <= 8.0 + 1e-9 + max(np.hypot(*wind) - 8.0, 0.0)
    assert np.linalg.norm(np.diff(velocities[:, :2], axis=0), axis=1).max() <= 4.0 * 0.05 + 1e-9


def test_airspeed_is_limited():
    wind = np.array([-15.0, 0.0])
    _, _, velocities = fly(tuple(wind))
    through_air = np.linalg.norm(velocities[40:, :2] - wind, axis=1)
    assert through_air.max() <= Airframe().max_airspeed + 1e-9


def test_a_storm_blows_the_vehicle_away():
    body, track, _ = fly((-25.0, 0.0))
    assert track[-1, 0] < -100.0
    assert body.position[0] < track[len(track) // 2, 0]


def test_ardupilot_sends_only_heartbeats_until_it_is_asked():
    def names(bench, seconds):
        before = len(bench.heard)
        bench.step(seconds)
        return Counter(m.get_type() for m in bench.heard[before:])

    assert names(Bench("px4"), 5.0)["GLOBAL_POSITION_INT"] > 10
    bench = Bench("ardupilot")
    assert set(names(bench, 5.0)) == {"HEARTBEAT"}
    interval = mav.MAV_CMD_SET_MESSAGE_INTERVAL
    position = float(mav.MAVLINK_MSG_ID_GLOBAL_POSITION_INT)
    assert bench.command(interval, position, 5e5) == OK
    assert names(bench, 10.0)["GLOBAL_POSITION_INT"] in (20, 21)
    assert bench.command(interval, position, -1.0) == OK
    assert set(names(bench, 5.0)) == {"HEARTBEAT"}
    assert bench.command(interval, 99.0, 5e5) == mav.MAV_RESULT_DENIED


def test_a_copter_of_ardupilot_stays_in_auto_where_it_cannot_be_armed():
    bench = Bench("ardupilot")
    bench.upload(mission())
    assert bench.arm() == OK
    assert bench.start() == OK
    bench.step(120.0)
    assert not bench.autopilot.vehicle.armed
    assert bench.last("HEARTBEAT").custom_mode == 3
    assert bench.arm() == mav.MAV_RESULT_FAILED
    assert bench.command(mav.MAV_CMD_DO_SET_MODE, 1.0, 4.0) == OK
    assert bench.arm() == OK


def test_a_mission_that_was_flown_begins_anew_in_auto():
    """Not with its last item, the return, which would land and disarm it at once."""
    bench = Bench("ardupilot")
    bench.upload(mission())
    assert bench.arm() == OK
    assert bench.start() == OK
    bench.step(120.0)
    assert bench.command(mav.MAV_CMD_DO_SET_MODE, 1.0, 4.0) == OK
    assert bench.arm() == OK
    assert bench.command(mav.MAV_CMD_DO_SET_MODE, 1.0, 3.0) == OK
    bench.step(1.0)  # time that may pass before the start is asked for
    assert bench.autopilot.vehicle.armed
    assert bench.start() == OK
    bench.step(5.0)
    assert bench.autopilot.vehicle.flying
