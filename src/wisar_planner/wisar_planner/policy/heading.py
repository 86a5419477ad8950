"""From the actor's outputs to a heading.

There are two kinds of policies, by how their turns are distributed: a squashed Gaussian, as soft
actor-critic has it, or one of the directions with an offset each. The second can hold two good ways
apart, for example around a seen area to the left or to the right, where the first has to pass over
the bad ones between them.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any

import numpy as np
from array_api_compat import array_namespace, device

from wisar_planner.policy.observation import DIRECTIONS
from wisar_planner.policy.unseen_map import Array

#: Outputs of the actor per direction: how good it is; how certain, or where in it to turn.
ACTOR_OUTPUTS = 2
#: How a policy's turns are distributed.
GAUSSIAN, DIRECTED = "gaussian", "directed"
DISTRIBUTIONS = (GAUSSIAN, DIRECTED)
#: Angle between neighbouring directions, in units of pi.
SPACING = 2.0 / DIRECTIONS
#: Limits of the logarithm of a Gaussian's standard deviation.
LOG_STD_MIN, LOG_STD_MAX = -5.0, 0.5
_ALMOST_ONE = 1.0 - 1e-6


def likeliest_turn(output: Array, distribution: str) -> Array:
    """Return the policy's most likely turns, (B,), in units of pi, -1 to 1.

    Parameters
    ----------
    output : (ACTOR_OUTPUTS, B, DIRECTIONS)
        What the actor's network returned.
    distribution : str
        One of `DISTRIBUTIONS`.
    """
    xp = array_namespace(output)
    if distribution == GAUSSIAN:
        return xp.tanh(actor_distribution(output)[0])
    logits, offsets = directions_and_offsets(output)
    return _turn_in(offsets, xp.argmax(logits, axis=-1))


def directions_and_offsets(output: Array) -> tuple[Array, Array]:
    """Return logits of the directions and offsets of the turn in each, (B, DIRECTIONS) each.

    Offsets are in units of pi and reach to the neighbouring directions.
    """
    xp = array_namespace(output)
    return output[0], SPACING * xp.tanh(output[1])


def _turn_in(offsets: Array, direction: Array) -> Array:
    xp = array_namespace(offsets)
    search = xp.arange(offsets.shape[0], device=device(offsets))
    return wrapped(SPACING * xp.astype(direction, offsets.dtype) + offsets[search, direction])


def wrapped(turn: Array) -> Array:
    """Return turns in units of pi as their equals from -1 to below 1."""
    return (turn + 1.0) % 2.0 - 1.0


def actor_distribution(output: Array) -> tuple[Array, Array]:
    """Return mean and logarithm of the standard deviation of the actor's Gaussian, (B,) each.

    The squashed sample, tanh of it, is the turn from the last heading in units of pi.

    Parameters
    ----------
    output : (ACTOR_OUTPUTS, B, DIRECTIONS)
        What the actor's network returned.
    """
    xp = array_namespace(output)
    logits = output[0] - xp.max(output[0], axis=-1, keepdims=True)
    weights = xp.exp(logits)
    cosines, sines = _unit_vectors(xp, device(output))
    turn = xp.atan2(xp.sum(weights * sines, axis=-1), xp.sum(weights * cosines, axis=-1))
    action = xp.clip(turn / math.pi, -_ALMOST_ONE, _ALMOST_ONE)
    certainty = xp.tanh(xp.mean(output[1], axis=-1))
    log_std = LOG_STD_MIN + 0.5 * (LOG_STD_MAX - LOG_STD_MIN) * (certainty + 1.0)
    return xp.atanh(action), log_std


@lru_cache
def _unit_vectors(xp: Any, where: Any) -> tuple[Array, Array]:
    """Return cosines and sines of the directions in an array library, on a device."""
    angles = 2.0 * np.pi / DIRECTIONS * np.arange(DIRECTIONS)
    cosines, sines = (f(angles).astype(np.float32) for f in (np.cos, np.sin))
    return xp.asarray(cosines, device=where), xp.asarray(sines, device=where)


def value_at(values: Array, action: Array) -> Array:
    """Return values per direction at turns between them, by periodic cubic interpolation.

    Parameters
    ----------
    values : (..., B, DIRECTIONS)
        Values at the directions.
    action : (..., B, M)
        Turns in units of pi, -1 to 1.

    Returns
    -------
    (..., B, M)
        Catmull-Rom interpolation.
    """
    xp = array_namespace(values)
    place = action * (0.5 * DIRECTIONS)
    low = xp.floor(place)
    t = place - low
    first = xp.astype(low, xp.int64)
    before, here, after, beyond = (
        xp.take_along_axis(values, (first + offset) % DIRECTIONS, axis=-1)
        for offset in (-1, 0, 1, 2)
    )
    linear = 0.5 * (after - before)
    square = before - 2.5 * here + 2.0 * after - 0.5 * beyond
    cube = 0.5 * (beyond - before) + 1.5 * (here - after)
    return here + t * (linear + t * (square + t * cube))
