"""From the actor's outputs to a heading."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any

import numpy as np
from array_api_compat import array_namespace, device

from wisar_planner.policy.observation import DIRECTIONS
from wisar_planner.policy.unseen_map import Array

#: Outputs of the actor per direction: how good it is, and how certain.
ACTOR_OUTPUTS = 2
_LOG_STD_MIN, _LOG_STD_MAX = -5.0, 0.5
_ALMOST_ONE = 1.0 - 1e-6


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
    log_std = _LOG_STD_MIN + 0.5 * (_LOG_STD_MAX - _LOG_STD_MIN) * (certainty + 1.0)
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
