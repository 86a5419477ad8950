"""Fence items back to rings of latitude and longitude."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from pymavlink.dialects.v20 import common as mav

from wisar_planner.mavlink.mission import MissionItem

_INSIDE = {
    mav.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION: True,
    mav.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION: False,
}


class Ring(NamedTuple):
    """A polygon of the fence.

    Parameters
    ----------
    corners
        Latitude and longitude in degrees, (N, 2), open.
    inclusion
        Whether to stay inside; otherwise outside.
    """

    corners: NDArray[np.float64]
    inclusion: bool


def fence_rings(fence: Sequence[MissionItem]) -> tuple[Ring, ...]:
    """Collect the polygons of a fence; corners that make no whole polygon are left out."""
    rings: list[Ring] = []
    at = 0
    while at < len(fence):
        first = fence[at]
        count = _corner_count(first)
        corners = fence[at : at + count]
        if count < 3 or len(corners) < count or any(c.command != first.command for c in corners):
            at += 1
            continue
        places = np.array([(c.latitude, c.longitude) for c in corners])
        rings.append(Ring(places, _INSIDE[first.command]))
        at += count
    return tuple(rings)


def _corner_count(item: MissionItem) -> int:
    """Return how many corners an item says its polygon has; 0 where it is no corner of one."""
    # Items come from links and files, where NaN stands for what was not set.
    if item.command not in _INSIDE or not math.isfinite(item.params[0]):
        return 0
    return int(item.params[0])
