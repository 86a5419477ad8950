"""What PX4, ArduPilot and others do differently, chosen by the autopilot type in the heartbeat."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from pymavlink.dialects.v20 import common as mav

from wisar_planner.mavlink.mission import Mission, MissionItem, MissionKind, plain_frame


@dataclass(frozen=True)
class Dialect:
    """How one family of autopilots speaks the mission protocol.

    Parameters
    ----------
    name
        For messages to people.
    home_item
        Whether item 0 of the mission is home: it is not flown, and reads back as the autopilot
        wants it.
    strict_sequence
        Whether an item that was not asked for may end the upload (INVALID_SEQUENCE). Then items
        are sent twice on suspicion only when the autopilot's own repeated request is overdue.
    stores_defaults
        Whether a parameter sent as NaN ("your default") has to be sent as 0.
    altitude_step, rally_altitude_step
        Coarseness in metres with which altitudes are kept.
    asks_again_after_s
        How long a request that is repeated may take to arrive, on a link that loses one.
    terrain_frames
        Whether heights above terrain are taken.
    replaces_in_place
        Whether a mission is replaced item by item as they arrive, and cut to the new length at
        the start: an upload that ends early leaves a mixture of the old and the new mission.
    start_goes_on
        Whether a mission started in flight goes on with its current item instead of the first.
    gives_up_after_s
        How long the autopilot waits for an item before it forgets the upload.
    """

    name: str
    home_item: bool = False
    strict_sequence: bool = False
    stores_defaults: bool = False
    altitude_step: float = 1e-3
    rally_altitude_step: float = 1e-3
    asks_again_after_s: float = 1.0
    gives_up_after_s: float = 5.0
    terrain_frames: bool = True
    replaces_in_place: bool = False
    start_goes_on: bool = False

    def to_wire(self, kind: MissionKind, items: Sequence[MissionItem]) -> tuple[MissionItem, ...]:
        """Turn a list as people mean it into the list that is sent."""
        wire = tuple(_without_nan(i) for i in items) if self.stores_defaults else tuple(items)
        if self.home_item and kind is MissionKind.MISSION and wire:
            return (_home_placeholder(wire), *wire)
        return wire

    def from_wire(self, kind: MissionKind, items: Sequence[MissionItem]) -> tuple[MissionItem, ...]:
        """Turn a list as it was read back into the list as people mean it."""
        if self.home_item and kind is MissionKind.MISSION:
            return tuple(items[1:])
        return tuple(items)

    def refusal_of(self, mission: Mission) -> str:
        """Return in words why this family takes no such mission; empty if it may."""
        terrain = mav.MAV_FRAME_GLOBAL_TERRAIN_ALT
        if not self.terrain_frames and any(plain_frame(i.frame) == terrain for i in mission.items):
            return (
                f"{self.name} takes no heights above terrain; use altitude_frame 'relative' and "
                "compare the heights with the ground"
            )
        return ""

    def differences(
        self, kind: MissionKind, wanted: Sequence[MissionItem], found: Sequence[MissionItem]
    ) -> tuple[str, ...]:
        """Compare two lists as people mean them.

        Returns
        -------
        tuple of str
            One sentence per difference, at most ten; empty if the lists are the same but for
            what this family of autopilots is known to normalise.
        """
        if len(wanted) != len(found):
            return (f"{len(wanted)} items were sent, {len(found)} read back",)
        step = self.altitude_step if kind is not MissionKind.RALLY else self.rally_altitude_step
        said: list[str] = []
        for number, (a, b) in enumerate(zip(wanted, found, strict=True)):
            reason = _difference(a, b, step, self.stores_defaults)
            # PX4 keeps no such flag for corners and rally points, where it means nothing.
            if reason is None and kind is MissionKind.MISSION and a.autocontinue > b.autocontinue:
                reason = "autocontinue was lost"
            if reason is not None:
                said.append(f"item {number}: {reason}")
                if len(said) == 10:
                    break
        return tuple(said)


def _without_nan(item: MissionItem) -> MissionItem:
    if not any(math.isnan(p) for p in item.params):
        return item
    first, second, third, fourth = (0.0 if math.isnan(p) else p for p in item.params)
    return replace(item, params=(first, second, third, fourth))


def _home_placeholder(items: Sequence[MissionItem]) -> MissionItem:
    # ArduPilot overwrites it with its own home; a real place keeps maps from jumping to 0, 0.
    place = next((i for i in items if i.is_global), None)
    if place is None:
        return MissionItem(mav.MAV_CMD_NAV_WAYPOINT, mav.MAV_FRAME_GLOBAL)
    return MissionItem(mav.MAV_CMD_NAV_WAYPOINT, mav.MAV_FRAME_GLOBAL, x=place.x, y=place.y)


def _difference(
    wanted: MissionItem, found: MissionItem, altitude_step: float, lossy_params: bool
) -> str | None:
    if wanted.command != found.command:
        return f"command {wanted.command} became {found.command}"
    if wanted.is_global and plain_frame(wanted.frame) != plain_frame(found.frame):
        return f"frame {wanted.frame} became {found.frame}"
    # One unit is 1e-7 degrees, about a centimetre: what a conversion through a double may cost.
    tolerance = 1 if wanted.is_global else 0
    if abs(wanted.x - found.x) > tolerance or abs(wanted.y - found.y) > tolerance:
        return f"place {wanted.x}, {wanted.y} (1e-7 degrees) became {found.x}, {found.y}"
    if not abs(wanted.z - found.z) <= altitude_step + 1e-6 * abs(wanted.z):
        return f"altitude {wanted.z:g} became {found.z:g}"
    for number, (a, b) in enumerate(zip(wanted.params, found.params, strict=True), start=1):
        if math.isnan(a) or (lossy_params and a == 0.0 and math.isnan(b)):
            continue
        if not math.isclose(a, b, rel_tol=1e-5, abs_tol=1e-5):
            return f"parameter {number} {a:g} became {b:g}"
    return None


PX4 = Dialect("PX4", gives_up_after_s=5.0, terrain_frames=False)
ARDUPILOT = Dialect(
    "ArduPilot",
    home_item=True,
    stores_defaults=True,
    altitude_step=0.011,
    rally_altitude_step=1.0,
    asks_again_after_s=2.5,
    gives_up_after_s=8.0,
    replaces_in_place=True,
    start_goes_on=True,
)
GENERIC = Dialect("generic", gives_up_after_s=8.0)

_DIALECTS = {
    mav.MAV_AUTOPILOT_PX4: PX4,
    mav.MAV_AUTOPILOT_ARDUPILOTMEGA: ARDUPILOT,
}


def dialect_of(autopilot: int) -> Dialect:
    """Return the dialect for a MAV_AUTOPILOT code of a heartbeat."""
    return _DIALECTS.get(autopilot, GENERIC)
