"""Compiled kernel of a flight: look, decide, fly a step, see.

It puts together the kernels of what a policy sees and of its network, and decides as `heading`
says; calling the same parts from Python takes three times as long. Tests compare the two.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from wisar_planner.errors import FloatArray
from wisar_planner.policy.heading import ACTOR_OUTPUTS, LOG_STD_MAX, LOG_STD_MIN, SPACING
from wisar_planner.policy.observation import BRIGHTEST, DIRECTIONS, NUMBERS, SCALES, VIEW_WIDTH
from wisar_planner.policy.ring_kernels import RingWeights, ring_network
from wisar_planner.policy.unseen_kernels import (
    Float32Array,
    Levels,
    see,
    write_numbers,
    write_view,
)
from wisar_planner.policy.unseen_map import BLOCK, RATIO
from wisar_planner.search.area_raster import AreaRaster, leg_inside

# Turns tried where a step would leave the area: as many to each side as make the circle.
_TURNS = 32


class Flights(NamedTuple):
    """B searches in flight; lengths and positions are in cells of the finest raster.

    Attributes
    ----------
    levels, before, step, radius
        What is unseen, see `UnseenMap`; changed.
    window : int
        See `UnseenMap`.
    distances, swath
        Where to look, see `observation.Constants`.
    position : (B, 2) float64
        Where the drones are; changed.
    heading : (B,) float64
        Their last headings, rad; changed.
    seen : (B,) float64
        Density x cells that each has seen; changed.
    """

    levels: Levels
    before: Float32Array
    step: Float32Array
    radius: Float32Array
    window: int
    distances: Levels
    swath: Levels
    position: FloatArray
    heading: FloatArray
    seen: FloatArray


@njit(cache=True, nogil=True)
def fly_step(
    flights: Flights,
    weights: RingWeights,
    gaussian: bool,
    area: AreaRaster,
    length: float,
    steps_left: float,
    noise: Float32Array,
) -> bool:
    """Fly a step of each search; return whether all found one that stays in the area.

    Parameters
    ----------
    flights : Flights
        The searches; changed.
    weights, gaussian
        The policy: its network, and whether its turns are distributed as `heading.GAUSSIAN`.
    area : AreaRaster
        Where they may fly.
    length : float
        Length of a step in cells.
    steps_left : float
        What the policy is told of the steps left.
    noise : (B, DIRECTIONS) float32
        See `decide`.
    """
    searches = len(flights.position)
    view = np.empty((searches, DIRECTIONS, VIEW_WIDTH), np.float32)
    numbers = np.empty((searches, NUMBERS), np.float32)
    output = np.empty((ACTOR_OUTPUTS, searches, DIRECTIONS), np.float32)
    start = flights.position.astype(np.float32)
    write_view(
        flights.levels, RATIO, start, flights.heading.astype(np.float32), flights.distances,
        flights.swath, flights.step, flights.radius, BRIGHTEST, view,
    )  # fmt: skip
    left = np.full(searches, steps_left, np.float32)
    write_numbers(flights.levels, left, SCALES, flights.step, flights.radius, BRIGHTEST, numbers)
    ring_network(weights, view, numbers, output)
    for b in range(searches):
        heading = flights.heading[b] + math.pi * decide(output[:, b], gaussian, noise[b])
        x, y = flights.position[b]
        heading = _kept_inside(area, x, y, length, heading)
        if math.isnan(heading):
            return False
        flights.heading[b] = heading
        flights.position[b, 0] = x + length * math.cos(heading)
        flights.position[b, 1] = y + length * math.sin(heading)
    end = flights.position.astype(np.float32)
    gain = see(
        flights.levels, flights.before, start, end, flights.radius, flights.window, BLOCK, RATIO
    )
    for b in range(searches):
        flights.seen[b] += gain[b]
    return True


@njit(cache=True, nogil=True)
def decide(output: Float32Array, gaussian: bool, noise: Float32Array) -> float:
    """Return a turn of a policy in units of pi, -1 to 1; see `heading`.

    Parameters
    ----------
    output : (ACTOR_OUTPUTS, DIRECTIONS) float32
        What the actor's network returned for one search.
    gaussian : bool
        Whether turns are distributed as `heading.GAUSSIAN`, or as `heading.DIRECTED`.
    noise : (DIRECTIONS,) float32
        0 for the most likely turn. For a random one, draws from the Gumbel distribution; of a
        Gaussian policy the first counts alone, a draw from the standard normal distribution.
    """
    directions = output.shape[1]
    if gaussian:
        greatest = output[0].max()
        x, y, certainty = 0.0, 0.0, 0.0
        for d in range(directions):
            weight = math.exp(output[0, d] - greatest)
            x += weight * math.cos(2.0 * math.pi * d / directions)
            y += weight * math.sin(2.0 * math.pi * d / directions)
            certainty += output[1, d] / directions
        limit = 1.0 - 1e-6
        mean = math.atanh(min(max(math.atan2(y, x) / math.pi, -limit), limit))
        share = 0.5 * (math.tanh(certainty) + 1.0)
        log_std = LOG_STD_MIN + (LOG_STD_MAX - LOG_STD_MIN) * share
        return math.tanh(mean + math.exp(log_std) * noise[0])
    # The greatest of logits with Gumbel noise is a draw from their softmax.
    best = 0
    for d in range(1, directions):
        if output[0, d] + noise[d] > output[0, best] + noise[best]:
            best = d
    turn = SPACING * (best + math.tanh(output[1, best]))
    return (turn + 1.0) % 2.0 - 1.0


@njit(cache=True, nogil=True)
def _kept_inside(area: AreaRaster, x: float, y: float, length: float, heading: float) -> float:
    """Return the heading nearest to a wanted one whose step stays in the area, or NaN."""
    for k in range(_TURNS + 1):
        turn = (1 - 2 * (k % 2)) * ((k + 1) // 2) * 2.0 * math.pi / _TURNS
        angle = heading + turn
        end_x, end_y = x + length * math.cos(angle), y + length * math.sin(angle)
        if leg_inside(area, x - 0.5, y - 0.5, end_x - 0.5, end_y - 0.5):
            return angle
    return math.nan
