"""A whole simulated autopilot, without socket and clock: messages and time in, messages out."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from pymavlink.dialects.v20 import common as mav

from wisar_planner.pdm.geodesy import GeoOrigin
from wisar_sim.autopilot.dynamics import Airframe
from wisar_sim.autopilot.mission_server import Client, Message, MissionServer, StoredItem
from wisar_sim.autopilot.profile import Profile
from wisar_sim.autopilot.vehicle import Mode, Vehicle, check_flyable

_MOST_MESSAGES_PER_S = 100.0
_LONGEST_GAP_S = 1.0

# Regular messages by name: their ids, as SET_MESSAGE_INTERVAL has them.
_STREAMS = {
    "position": mav.MAVLINK_MSG_ID_GLOBAL_POSITION_INT,
    "current": mav.MAVLINK_MSG_ID_MISSION_CURRENT,
    "home": mav.MAVLINK_MSG_ID_HOME_POSITION,
    "landed": mav.MAVLINK_MSG_ID_EXTENDED_SYS_STATE,
}
_DEFAULT_INTERVALS = {"position": 0.25, "current": 1.0, "home": 2.0, "landed": 1.0}
# These come as often along the way as at normal speed.
_AS_DENSE = frozenset({"heartbeat", "position", "landed"})
_STREAM_NAMES = {code: name for name, code in _STREAMS.items()}

# Custom modes by profile: what the heartbeat shows and what DO_SET_MODE is given.
# PX4: main mode 4 (AUTO) in bits 16-23, sub-mode in bits 24-31.
_PX4_MODES = {
    (4, 3): Mode.HOLD,
    (4, 4): Mode.MISSION,
    (4, 5): Mode.RETURN,
    (4, 6): Mode.LAND,
}
_COPTER_MODES = {
    3: Mode.MISSION,
    4: Mode.HOLD,
    5: Mode.HOLD,
    17: Mode.HOLD,
    6: Mode.RETURN,
    9: Mode.LAND,
}


class Autopilot:
    """Heartbeat, position, missions and the commands of one vehicle.

    Parameters
    ----------
    profile
        Which autopilot to resemble.
    home
        Where the vehicle stands at first.
    system, component
        Own ids.
    airframe, wind
        See `dynamics.Body`.
    speed_up
        How many seconds are flown in one second.
    """

    def __init__(
        self,
        profile: Profile,
        home: GeoOrigin,
        *,
        system: int = 1,
        component: int = mav.MAV_COMP_ID_AUTOPILOT1,
        airframe: Airframe | None = None,
        wind: tuple[float, float] = (0.0, 0.0),
        speed_up: float = 1.0,
    ) -> None:
        self.profile = profile
        self.system = system
        self.component = component
        self.vehicle = Vehicle(
            home,
            airframe,
            wind,
            on_reached=self._reached,
            on_current=self._current_changed,
            stays_in_mission=profile.stays_in_mission,
            goes_on=profile.goes_on,
        )
        self.missions = MissionServer(profile, self._home_item, self._list_changed)
        self._speed_up = speed_up
        self._outbox: list[Message] = []
        self._copter_mode = 4  # the number last asked for; several stand for a hold
        self._booted_at: float | None = None
        self._ticked_at = 0.0
        self._startable_at = -math.inf
        self._due: dict[str, float] = {}
        self._every = {} if profile.streams_when_asked else dict(_DEFAULT_INTERVALS)
        self._handlers: dict[int, Callable[[tuple[float, ...]], int]] = {
            mav.MAV_CMD_COMPONENT_ARM_DISARM: self._arm,
            mav.MAV_CMD_MISSION_START: self._start,
            mav.MAV_CMD_DO_SET_MODE: self._set_mode,
            mav.MAV_CMD_NAV_RETURN_TO_LAUNCH: lambda _: self._change_mode(Mode.RETURN),
            mav.MAV_CMD_NAV_LAND: lambda _: self._change_mode(Mode.LAND),
            mav.MAV_CMD_DO_PAUSE_CONTINUE: self._pause_continue,
            mav.MAV_CMD_DO_SET_MISSION_CURRENT: self._set_current,
            mav.MAV_CMD_REQUEST_MESSAGE: self._request_message,
            mav.MAV_CMD_SET_MESSAGE_INTERVAL: self._set_interval,
        }

    # -- messages ------------------------------------------------------------------------------

    def receive(self, message: Message, now: float) -> list[Message]:
        """Take in a message and return the answers."""
        self._boot(now)
        name = message.get_type()
        if name == "BAD_DATA" or not self._is_for_us(message):
            return self._flush()
        client = Client(message.get_srcSystem(), message.get_srcComponent())
        if name in ("COMMAND_LONG", "COMMAND_INT"):
            self._on_command(message, client)
        elif name == "SET_MODE":
            self._set_custom_mode(message.custom_mode)
        elif name == "MISSION_SET_CURRENT":
            self._set_current((float(message.seq),))
        elif name.startswith("MISSION_"):
            self._outbox.extend(self.missions.handle(message, client, now))
        elif name == "PARAM_REQUEST_LIST":
            self._outbox.append(
                mav.MAVLink_param_value_message(
                    b"SYSID_THISMAV", float(self.system), mav.MAV_PARAM_TYPE_INT32, 1, 0
                )
            )
        return self._flush()

    def _is_for_us(self, message: Message) -> bool:
        system = getattr(message, "target_system", 0)
        component = getattr(message, "target_component", 0)
        return system in (0, self.system) and component in (0, self.component)

    def tick(self, now: float) -> list[Message]:
        """Let time pass: fly, repeat requests, send what is due."""
        self._boot(now)
        passed = min(max(now - self._ticked_at, 0.0), _LONGEST_GAP_S)
        self._ticked_at = now
        self.vehicle.advance(passed * self._speed_up)
        self._outbox.extend(self.missions.tick(now))
        for name, send in (
            ("heartbeat", self._heartbeat),
            ("position", self._position),
            ("current", self._mission_current),
            ("home", self._home_position),
            ("landed", self._landed_state),
        ):
            every = 1.0 if name == "heartbeat" else self._every.get(name)
            if every is not None and now >= self._due.get(name, 0.0):
                if name in _AS_DENSE:
                    every /= self._speed_up
                self._due[name] = now + max(every, 1.0 / _MOST_MESSAGES_PER_S)
                self._outbox.append(send())
        return self._flush()

    def _boot(self, now: float) -> None:
        if self._booted_at is None:
            self._booted_at = self._ticked_at = now
            self.missions.tick(now)

    def _flush(self) -> list[Message]:
        out, self._outbox = self._outbox, []
        return out

    def _boot_ms(self) -> int:
        return int((self._ticked_at - (self._booted_at or 0.0)) * 1e3) & 0xFFFFFFFF

    def _heartbeat(self) -> Message:
        base = mav.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | mav.MAV_MODE_FLAG_GUIDED_ENABLED
        if self.vehicle.armed:
            base |= mav.MAV_MODE_FLAG_SAFETY_ARMED
        ardupilot = self.profile.autopilot == mav.MAV_AUTOPILOT_ARDUPILOTMEGA
        active = self.vehicle.flying if ardupilot else self.vehicle.armed
        status = mav.MAV_STATE_ACTIVE if active else mav.MAV_STATE_STANDBY
        return mav.MAVLink_heartbeat_message(
            mav.MAV_TYPE_QUADROTOR, self.profile.autopilot, base, self._custom_mode(), status, 3
        )

    def _custom_mode(self) -> int:
        mode = self.vehicle.mode
        if self.profile.autopilot == mav.MAV_AUTOPILOT_ARDUPILOTMEGA:
            if _COPTER_MODES.get(self._copter_mode) is mode:
                return self._copter_mode
            return next(n for n, m in _COPTER_MODES.items() if m is mode)
        return next((main << 16 | sub << 24 for (main, sub), m in _PX4_MODES.items() if m is mode))

    def _position(self) -> Message:
        body = self.vehicle.body
        latitude, longitude = self.vehicle.frame.to_geodetic(body.position[None, :2])[0]
        east, north, up = body.velocity
        heading = math.degrees(math.atan2(east, north)) % 360.0
        return mav.MAVLink_global_position_int_message(
            self._boot_ms(),
            round(latitude * 1e7),
            round(longitude * 1e7),
            round((self.vehicle.home.altitude + body.position[2]) * 1e3),
            round(body.position[2] * 1e3),
            round(north * 100.0),
            round(east * 100.0),
            round(-up * 100.0),
            round(heading * 100.0) % 36_000,
        )

    def _mission_current(self) -> Message:
        return mav.MAVLink_mission_current_message(self._wire_number(self.vehicle.current))

    def _home_position(self) -> Message:
        home = self.vehicle.home
        return mav.MAVLink_home_position_message(
            round(home.latitude * 1e7),
            round(home.longitude * 1e7),
            round(home.altitude * 1e3),
            0.0,
            0.0,
            0.0,
            [1.0, 0.0, 0.0, 0.0],
            0.0,
            0.0,
            0.0,
        )

    def _landed_state(self) -> Message:
        landed = (
            mav.MAV_LANDED_STATE_IN_AIR if self.vehicle.flying else mav.MAV_LANDED_STATE_ON_GROUND
        )
        return mav.MAVLink_extended_sys_state_message(mav.MAV_VTOL_STATE_UNDEFINED, landed)

    def _say(self, severity: int, text: str) -> None:
        self._outbox.append(mav.MAVLink_statustext_message(severity, text.encode()[:50]))

    # -- mission progress ----------------------------------------------------------------------

    def _wire_number(self, number: int) -> int:
        return number + (1 if self.profile.home_item else 0)

    def _reached(self, number: int) -> None:
        returned = self.vehicle.items[number].command == mav.MAV_CMD_NAV_RETURN_TO_LAUNCH
        if returned and not self.profile.tells_return:
            return
        self._outbox.append(mav.MAVLink_mission_item_reached_message(self._wire_number(number)))

    def _current_changed(self, number: int) -> None:
        self._outbox.append(mav.MAVLink_mission_current_message(self._wire_number(number)))

    def _home_item(self) -> StoredItem:
        home = self.vehicle.home
        return StoredItem(
            mav.MAV_CMD_NAV_WAYPOINT,
            mav.MAV_FRAME_GLOBAL,
            (0.0, 0.0, 0.0, 0.0),
            round(home.latitude * 1e7),
            round(home.longitude * 1e7),
            home.altitude,
        )

    def _list_changed(self, kind: int) -> None:
        if kind == mav.MAV_MISSION_TYPE_MISSION:
            self.vehicle.load(self.missions.flight_items)
            self._startable_at = self._ticked_at + self.profile.checks_for_s / self._speed_up
        reason = self._why_not()
        if reason is not None and self.vehicle.items and not self.profile.replaces_in_place:
            # As PX4: the list is acknowledged all the same.
            self._say(mav.MAV_SEVERITY_WARNING, f"Mission denied: {reason}")

    def _why_not(self) -> str | None:
        return check_flyable(self.vehicle, self.missions.lists[mav.MAV_MISSION_TYPE_FENCE])

    # -- commands ------------------------------------------------------------------------------

    def _on_command(self, message: Message, client: Client) -> None:
        params = tuple(getattr(message, f"param{n}") for n in range(1, 5))
        handler = self._handlers.get(message.command)
        if handler is None:
            result = int(mav.MAV_RESULT_UNSUPPORTED)
        elif not all(math.isfinite(p) for p in params[:1]):
            result = int(mav.MAV_RESULT_DENIED)
        else:
            result = handler(params)
        ack = mav.MAVLink_command_ack_message(
            message.command, result, 0, 0, client.system, client.component
        )
        self._outbox.insert(0, ack)

    def _arm(self, params: tuple[float, ...]) -> int:
        wanted = params[0] == 1.0
        if not wanted and self.vehicle.flying:
            return int(mav.MAV_RESULT_DENIED)
        flown = self.vehicle.mode in (Mode.MISSION, Mode.RETURN, Mode.LAND)
        if wanted and flown and self.profile.stays_in_mission:
            self._say(mav.MAV_SEVERITY_CRITICAL, "Arm: AUTO mode not armable")
            return int(mav.MAV_RESULT_FAILED)
        self.vehicle.armed = wanted
        return int(mav.MAV_RESULT_ACCEPTED)

    def _start(self, params: tuple[float, ...]) -> int:
        if not (self.vehicle.armed or self.profile.start_arms):
            self._say(mav.MAV_SEVERITY_CRITICAL, "Mission denied: not armed")
            return int(mav.MAV_RESULT_TEMPORARILY_REJECTED)
        reason = self._why_not()
        if reason is None and self._ticked_at < self._startable_at:
            reason = "no valid mission"
        if reason is not None:
            self._say(mav.MAV_SEVERITY_CRITICAL, f"Mission denied: {reason}")
            return int(mav.MAV_RESULT_DENIED)
        self.vehicle.armed = True
        self.vehicle.start_mission()
        return int(mav.MAV_RESULT_ACCEPTED)

    def _set_mode(self, params: tuple[float, ...]) -> int:
        if not all(math.isfinite(p) and 0.0 <= p <= 255.0 for p in params[:3]):
            return int(mav.MAV_RESULT_DENIED)
        if self.profile.autopilot == mav.MAV_AUTOPILOT_ARDUPILOTMEGA:
            mode = _COPTER_MODES.get(int(params[1]))
            self._copter_mode = int(params[1])
        else:
            mode = _PX4_MODES.get((int(params[1]), int(params[2])))
        if mode is None:
            return int(mav.MAV_RESULT_DENIED)
        return self._change_mode(mode)

    def _set_custom_mode(self, custom_mode: int) -> None:
        if self.profile.autopilot == mav.MAV_AUTOPILOT_ARDUPILOTMEGA:
            mode = _COPTER_MODES.get(custom_mode)
            self._copter_mode = custom_mode
        else:
            mode = _PX4_MODES.get((custom_mode >> 16 & 0xFF, custom_mode >> 24 & 0xFF))
        if mode is not None:
            self._change_mode(mode)

    def _change_mode(self, mode: Mode) -> int:
        if mode is Mode.MISSION and self._why_not() is not None:
            return int(mav.MAV_RESULT_DENIED)
        self.vehicle.set_mode(mode)
        return int(mav.MAV_RESULT_ACCEPTED)

    def _pause_continue(self, params: tuple[float, ...]) -> int:
        return self._change_mode(Mode.MISSION if params[0] >= 1.0 else Mode.HOLD)

    def _set_current(self, params: tuple[float, ...]) -> int:
        number = params[0] - (1 if self.profile.home_item else 0)
        if not 0 <= number < len(self.vehicle.items):
            return int(mav.MAV_RESULT_DENIED)
        self.vehicle.select(int(number))
        return int(mav.MAV_RESULT_ACCEPTED)

    def _set_interval(self, params: tuple[float, ...]) -> int:
        name, microseconds = _STREAM_NAMES.get(int(params[0])), params[1]
        if name is None or not math.isfinite(microseconds):
            return int(mav.MAV_RESULT_DENIED)
        self._due.pop(name, None)
        if microseconds < 0.0:
            self._every.pop(name, None)
        else:
            self._every[name] = microseconds * 1e-6 or _DEFAULT_INTERVALS[name]
        return int(mav.MAV_RESULT_ACCEPTED)

    def _request_message(self, params: tuple[float, ...]) -> int:
        wanted = int(params[0])
        if wanted == mav.MAVLINK_MSG_ID_AUTOPILOT_VERSION:
            self._outbox.append(self._version())
        elif wanted == mav.MAVLINK_MSG_ID_HOME_POSITION:
            self._outbox.append(self._home_position())
        elif wanted == mav.MAVLINK_MSG_ID_GLOBAL_POSITION_INT:
            self._outbox.append(self._position())
        else:
            return int(mav.MAV_RESULT_UNSUPPORTED)
        return int(mav.MAV_RESULT_ACCEPTED)

    def _version(self) -> Message:
        capabilities = (
            mav.MAV_PROTOCOL_CAPABILITY_MISSION_INT
            | mav.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
            | mav.MAV_PROTOCOL_CAPABILITY_MISSION_FENCE
            | mav.MAV_PROTOCOL_CAPABILITY_MISSION_RALLY
            | mav.MAV_PROTOCOL_CAPABILITY_MAVLINK2
        )
        zeros = np.zeros(8, dtype=int).tolist()
        return mav.MAVLink_autopilot_version_message(
            capabilities, 0, 0, 0, 0, zeros, zeros, zeros, 0, 0, 0
        )
