"""Compiled kernel of the reachable bound."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from numba import njit

from wisar_planner.errors import FloatArray

_IntArray = npt.NDArray[np.int64]


@njit(cache=True)
def _next_open(following: _IntArray, slot: int) -> int:
    """Return the first slot from `slot` on that has room, shortening the way there."""
    found = slot
    while following[found] != found:
        found = following[found]
    while following[slot] != found:
        following[slot], slot = found, following[slot]
    return found


@njit(cache=True)
def scheduled_mass(
    order: _IntArray, release: _IntArray, areas: FloatArray, densities: FloatArray, room: FloatArray
) -> float:
    """Return the most mass that can be seen when area is seen in time slots.

    Pieces are taken in `order`, of falling density, each as early as it may be: from slot
    `release` on, as far as `room` goes. This is Kruskal's greedy algorithm on the polymatroid of
    what can be scheduled, with a union-find over the slots that are full.

    Parameters
    ----------
    order : (N,) int64
        Pieces by falling density.
    release : (N,) int64
        First slot in which a piece can be seen; the number of slots for never.
    areas : (N,) float64
        Area of each piece, m^2.
    densities : (N,) float64
        Density of each piece, 1/m^2.
    room : (S,) float64
        Area that can be seen in each slot, m^2; used up in place.
    """
    slots = len(room)
    following = np.arange(slots + 1)
    mass = 0.0
    for piece in order:
        if following[0] == slots:
            break
        wanted = areas[piece]
        slot = _next_open(following, release[piece])
        while wanted > 0.0 and slot < slots:
            taken = min(wanted, room[slot])
            mass += taken * densities[piece]
            wanted -= taken
            room[slot] -= taken
            if room[slot] <= 0.0:
                following[slot] = slot + 1
                slot = _next_open(following, slot)
    return mass
