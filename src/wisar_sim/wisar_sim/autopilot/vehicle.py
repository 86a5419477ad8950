"""The simulated vehicle: it flies the mission that it holds when it is told to."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from enum import Enum

import numpy as np
from numpy.typing import NDArray
from pymavlink.dialects.v20 import common as mav

from wisar_planner.errors import InvalidInput
from wisar_planner.pdm.geodesy import GeoOrigin, LocalFrame
from wisar_sim.autopilot.dynamics import Airframe, Body
from wisar_sim.autopilot.mission_server import StoredItem

_STEP_S = 0.05
_RETURN_ALTITUDE_M = 30.0
_DEGREES = 1e-7

_WAITING_COMMANDS = frozenset(
    {
        mav.MAV_CMD_NAV_WAYPOINT,
        mav.MAV_CMD_NAV_LOITER_UNLIM,
        mav.MAV_CMD_NAV_LOITER_TIME,
        mav.MAV_CMD_NAV_TAKEOFF,
        mav.MAV_CMD_NAV_LAND,
        mav.MAV_CMD_NAV_RETURN_TO_LAUNCH,
    }
)

# Corners of a fence's polygons, and whether to stay inside.
_POLYGONS = {
    mav.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION: True,
    mav.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION: False,
}


class Mode(Enum):
    """What the vehicle is doing."""

    HOLD = "hold"
    MISSION = "mission"
    RETURN = "return"
    LAND = "land"


class Vehicle:
    """A multicopter with a mission.

    Parameters
    ----------
    home
        Where it stands at first.
    airframe, wind
        See `dynamics.Body`.
    on_reached, on_current
        Called with the number of an item that was reached, or that is flown to next.
    stays_in_mission
        Whether the mode remains that of the mission at its end.
    goes_on
        Whether a mission that is replaced or started in flight goes on with the current item.
    """

    def __init__(
        self,
        home: GeoOrigin,
        airframe: Airframe | None = None,
        wind: tuple[float, float] = (0.0, 0.0),
        *,
        on_reached: Callable[[int], None] = lambda _: None,
        on_current: Callable[[int], None] = lambda _: None,
        stays_in_mission: bool = False,
        goes_on: bool = False,
    ) -> None:
        self.home = home
        self.frame = LocalFrame(home)
        self.body = Body(airframe or Airframe(), wind)
        self.armed = False
        self.mode = Mode.HOLD
        self.items: tuple[StoredItem, ...] = ()
        self.current = 0
        self._stays_in_mission = stays_in_mission
        self._goes_on = goes_on
        self._mission_ended = False
        self._speed = self.body.airframe.cruise_speed
        self._waited_s = 0.0
        self._target: NDArray[np.float64] | None = None
        self._hold_at: NDArray[np.float64] | None = None
        self._left_over_s = 0.0
        self._on_reached = on_reached
        self._on_current = on_current

    # -- what others ask for -------------------------------------------------------------------

    def load(self, items: Sequence[StoredItem]) -> None:
        """Take in a new mission; in the mission's mode it is flown at once."""
        self.items = tuple(items)
        if self._goes_on and self.armed:
            self._target = None
        else:
            self._go_to(0)

    def set_mode(self, mode: Mode) -> None:
        """Change what the vehicle does; a mission flown to its end begins anew."""
        if mode is Mode.MISSION and self._mission_ended:
            self._mission_ended = False
            self._go_to(0)
        self.mode = mode
        self._target = None
        self._hold_at = None
        self._waited_s = 0.0

    def start_mission(self) -> None:
        """Fly the mission, from its first item unless it goes on."""
        if not (self._goes_on and self.flying):
            self._speed = self.body.airframe.cruise_speed
            self.select(0)
        self.set_mode(Mode.MISSION)

    def select(self, number: int) -> None:
        """Make an item the current one; the mode stays."""
        self._mission_ended = False
        self._go_to(number)

    @property
    def flying(self) -> bool:
        """Whether the vehicle is in the air."""
        return self.armed and not self.body.on_ground

    def places(self) -> NDArray[np.float64]:
        """East and north in metres of the mission's places, (N, 2).

        Raises
        ------
        InvalidInput
            If an item lies nowhere on Earth.
        """
        places = [i for i in self.items if i.frame != mav.MAV_FRAME_MISSION and (i.x or i.y)]
        if not places:
            return np.empty((0, 2))
        return self.frame.to_local(
            [i.x * _DEGREES for i in places], [i.y * _DEGREES for i in places]
        )

    # -- flying --------------------------------------------------------------------------------

    def advance(self, seconds: float) -> None:
        """Let simulated time pass."""
        self._left_over_s += seconds
        while self._left_over_s >= _STEP_S:
            self._left_over_s -= _STEP_S
            self._step(_STEP_S)

    def _step(self, dt: float) -> None:
        if not self.armed:
            self.body.stand()
            return
        if self.mode is Mode.MISSION and not self._mission_ended:
            self._step_mission(dt)
        elif self.mode is Mode.RETURN:
            self._step_return(dt)
        elif self.mode is Mode.LAND:
            self._land(self.body.position, dt)
        elif self.flying:
            if self._hold_at is None:
                self._hold_at = self.body.position.copy()
            self.body.fly_towards(self._hold_at, self._speed, dt)

    def _step_mission(self, dt: float) -> None:
        # Commands that take no time are carried out at once, but never more than there are.
        for _ in range(len(self.items)):
            if self.current >= len(self.items):
                break
            item = self.items[self.current]
            if item.command in _WAITING_COMMANDS:
                self._fly_item(item, dt)
                return
            if item.command == mav.MAV_CMD_DO_CHANGE_SPEED and item.params[1] > 0.0:
                self._speed = min(item.params[1], self.body.airframe.max_airspeed)
            self._finish_item()
        self._end_mission()

    def _fly_item(self, item: StoredItem, dt: float) -> None:
        if item.command == mav.MAV_CMD_NAV_RETURN_TO_LAUNCH:
            if self._step_return(dt):
                self._finish_item()
            return
        if item.command == mav.MAV_CMD_NAV_LAND:
            if self._land(self._place_of(item), dt):
                self._finish_item()
            return
        target = self._place_of(item)
        if item.command == mav.MAV_CMD_NAV_TAKEOFF and self.body.position[2] < 0.95 * target[2]:
            up = self.body.position.copy()
            up[2] = target[2]
            self.body.fly_towards(up, self._speed, dt)
            return
        self.body.fly_towards(target, self._speed, dt)
        if not self.body.within(target, self.body.airframe.acceptance_radius):
            return
        if item.command == mav.MAV_CMD_NAV_LOITER_UNLIM:
            return
        self._waited_s += dt
        hold = item.params[0] if item.command != mav.MAV_CMD_NAV_TAKEOFF else 0.0
        if self._waited_s >= hold:
            self._finish_item()

    def _place_of(self, item: StoredItem) -> NDArray[np.float64]:
        if self._target is None:
            here = self.body.position
            if item.x or item.y:
                place = self.frame.to_local([item.x * _DEGREES], [item.y * _DEGREES])[0]
            else:
                place = here[:2]
            above_sea = item.frame in (mav.MAV_FRAME_GLOBAL, mav.MAV_FRAME_GLOBAL_INT)
            height = item.z - (self.home.altitude if above_sea else 0.0)
            self._target = np.array([place[0], place[1], height])
        return self._target

    def _step_return(self, dt: float) -> bool:
        """Fly home; return whether the vehicle has landed there."""
        body = self.body
        if math.hypot(body.position[0], body.position[1]) > body.airframe.acceptance_radius:
            height = max(body.position[2], _RETURN_ALTITUDE_M)
            body.fly_towards(np.array([0.0, 0.0, height]), self._speed, dt)
            return False
        return self._land(np.zeros(3), dt)

    def _land(self, place: NDArray[np.float64], dt: float) -> bool:
        body = self.body
        body.fly_towards(np.array([place[0], place[1], -1.0]), self._speed, dt)
        if not body.on_ground:
            return False
        body.stand()
        self.armed = False
        return True

    def _finish_item(self) -> None:
        self._on_reached(self.current)
        if self.current + 1 < len(self.items):
            self._go_to(self.current + 1)
        else:
            self._end_mission()

    def _end_mission(self) -> None:
        if not self._stays_in_mission:
            self.set_mode(Mode.HOLD)
        self._mission_ended = True

    def _go_to(self, number: int) -> None:
        self.current = number
        self._target = None
        self._waited_s = 0.0
        self._on_current(number)


def check_flyable(vehicle: Vehicle, fence: Sequence[StoredItem]) -> str | None:
    """Say why a mission cannot be flown, or return None.

    Parameters
    ----------
    vehicle
        With its mission loaded.
    fence
        Fence items that the autopilot holds.
    """
    if not vehicle.items:
        return "no mission"
    if any(not math.isfinite(i.z) for i in vehicle.items):
        return "an altitude is not a number"
    try:
        places = vehicle.places()
        rings = _fence_rings(vehicle.frame, fence)
    except InvalidInput as error:
        return str(error)
    import shapely

    points = shapely.points(places)
    for ring, inside in rings:
        contained = shapely.intersects(shapely.Polygon(ring), points)
        if inside and not contained.all():
            return "a waypoint lies outside the fence"
        if not inside and contained.any():
            return "a waypoint lies in a keep-out area"
    return None


def _fence_rings(
    frame: LocalFrame, fence: Sequence[StoredItem]
) -> list[tuple[NDArray[np.float64], bool]]:
    rings = []
    at = 0
    while at < len(fence):
        item = fence[at]
        corners = _corner_count(item)
        if corners < 3 or at + corners > len(fence):
            at += 1
            continue
        ring = fence[at : at + corners]
        places = frame.to_local([i.x * _DEGREES for i in ring], [i.y * _DEGREES for i in ring])
        rings.append((places, _POLYGONS[item.command]))
        at += corners
    return rings


def _corner_count(item: StoredItem) -> int:
    """Return how many corners an item says its polygon has; 0 where it is no corner of one."""
    # What a client sends is kept as it is, and may be NaN or infinite.
    if item.command not in _POLYGONS or not math.isfinite(item.params[0]):
        return 0
    return int(item.params[0])
