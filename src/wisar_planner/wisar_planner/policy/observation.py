"""What the policy observes: the unseen map from the drone's seat, and a few numbers."""

from __future__ import annotations

import itertools
import math
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from array_api_compat import array_namespace, device

from wisar_planner.policy import unseen_kernels
from wisar_planner.policy.unseen_map import RATIO, Array, UnseenMap, in_main_memory

#: Changes with every change of what follows; a model serves only the version it was trained on.
VERSION = 1

#: Directions of the view, evenly spaced, counted from the last heading to the left.
DIRECTIONS = 32
#: Distances of the view in steps, growing geometrically.
DISTANCES = np.geomspace(0.25, 25.0, 16)
#: Columns of `Observation.view` and `Observation.numbers`.
VIEW_WIDTH = len(DISTANCES) + 1
NUMBERS = 8

#: Distances, in steps, from which the middle and the coarse raster are read.
MIDDLE_FROM, COARSE_FROM = 1.5, 6.0
# Points per step, along and across, that its gain is taken from.
_ALONG, _ACROSS = 8, 6
#: Greatest density that is shown.
BRIGHTEST = 4.0
#: Scales of the steps left.
SCALES = (2.0, 8.0, 32.0, 128.0)


class Observation(NamedTuple):
    """What B searches show.

    Attributes
    ----------
    view : (B, DIRECTIONS, VIEW_WIDTH) float32
        For each direction from the last heading on: unseen density at `DISTANCES`, then the mean
        unseen density of the ground that a step in this direction would newly sweep. In units of
        the reference density, see `reference_density`; -0.25 outside the area.
    numbers : (B, NUMBERS) float32
        Steps left, on five scales; swath radius in steps; greatest unseen density on the middle and
        on the coarse raster.
    """

    view: Array
    numbers: Array


def observe(unseen: UnseenMap, position: Array, heading: Array, steps_left: Array) -> Observation:
    """Return what searches show.

    Parameters
    ----------
    unseen : UnseenMap
        Unseen density in units of the reference density.
    position : (B, 2) float32
        Where the drones are, in cells.
    heading : (B,) float32
        Their last headings, rad.
    steps_left : (B,) float32
        Steps that they have left.
    """
    if in_main_memory(position):
        return _compiled(unseen, position, heading, steps_left)
    return observe_in_arrays(unseen, position, heading, steps_left)


def observe_in_arrays(
    unseen: UnseenMap, position: Array, heading: Array, steps_left: Array
) -> Observation:
    """Return what `observe` returns by array operations, for any device."""
    xp = array_namespace(position)
    fixed = constants(xp, device(position))
    angles = heading[:, None] + fixed.directions
    unit = xp.stack([xp.cos(angles), xp.sin(angles)], axis=-1)  # (B, A, 2)
    view = xp.minimum(_view(unseen, position, unit, fixed), BRIGHTEST)
    middle, coarse = (xp.max(level, axis=(1, 2)) for level in unseen.levels[1:])
    numbers = [xp.exp(-steps_left / scale) for scale in SCALES]
    numbers += [
        xp.log(steps_left) / 4.0,
        unseen.radius / unseen.step,
        xp.minimum(middle, BRIGHTEST),
        xp.minimum(coarse, BRIGHTEST),
    ]
    return Observation(view, xp.stack(numbers, axis=-1))


def _compiled(unseen: UnseenMap, position: Array, heading: Array, steps_left: Array) -> Observation:
    """Return the same by compiled kernels."""
    fixed = constants(np, "cpu")
    view = np.empty((len(position), DIRECTIONS, VIEW_WIDTH), dtype=np.float32)
    numbers = np.empty((len(position), NUMBERS), dtype=np.float32)
    levels = unseen.levels_in_memory()
    where, ahead, left, step, radius = (
        np.asarray(each) for each in (position, heading, steps_left, unseen.step, unseen.radius)
    )
    unseen_kernels.write_view(
        levels, RATIO, where, ahead, fixed.distances, fixed.swath, step, radius, BRIGHTEST, view
    )
    unseen_kernels.write_numbers(levels, left, SCALES, step, radius, BRIGHTEST, numbers)
    xp = array_namespace(position)
    return Observation(xp.asarray(view), xp.asarray(numbers))


def _view(unseen: UnseenMap, position: Array, unit: Array, fixed: Constants) -> Array:
    """Return the view, (B, DIRECTIONS, VIEW_WIDTH), without its limit."""
    xp = array_namespace(position)
    parts = []
    for level, distances in enumerate(fixed.distances):
        reach = unseen.step[:, None] * distances  # (B, R)
        points = position[:, None, None, :] + unit[:, :, None, :] * reach[:, None, :, None]
        parts.append(unseen.interpolated(level, points))
    parts.append(step_gains(unseen, position, unit)[..., None])
    return xp.concat(parts, axis=-1)


def step_gains(unseen: UnseenMap, position: Array, unit: Array) -> Array:
    """Return the mean unseen density of what steps would newly sweep, (B, D).

    What is within the swath radius of the position counts as seen; the rest of the swath is
    the disc's front half moved along the step, of area 2 x radius x step.

    Parameters
    ----------
    unseen : UnseenMap
        Unseen density.
    position : (B, 2) float32
        Where the steps begin, in cells.
    unit : (B, D, 2) float32
        Unit vectors of the steps.
    """
    xp = array_namespace(position)
    u, v, w = constants(xp, device(position)).swath
    ahead = (u * unseen.step[:, None] + w * unseen.radius[:, None])[:, None, :]
    aside = (v * unseen.radius[:, None])[:, None, :]
    x = position[:, 0, None, None] + ahead * unit[..., 0, None] - aside * unit[..., 1, None]
    y = position[:, 1, None, None] + ahead * unit[..., 1, None] + aside * unit[..., 0, None]
    density = unseen.nearest(xp.stack([x, y], axis=-1))
    return xp.mean(xp.maximum(density, 0.0), axis=-1)


class Constants(NamedTuple):
    """Fixed arrays of the observation.

    Attributes
    ----------
    directions : (A,)
        Directions from the last heading, rad.
    distances : LEVELS arrays
        Distances that are read from each level, in steps.
    swath : three (P,) arrays
        Points on a step's swath: share of the way along and across (-1 to 1) before it is bent by
        the disc's front, and how far the front bulges there, in swath radii.
    """

    directions: Array
    distances: tuple[Array, ...]
    swath: tuple[Array, ...]


@lru_cache
def constants(xp: Any, where: Any) -> Constants:
    """Return the fixed arrays in an array library, on a device."""

    def array(value: npt.NDArray[Any]) -> Array:
        return xp.asarray(np.ascontiguousarray(value, dtype=np.float32), device=where)

    limits = (0.0, MIDDLE_FROM, COARSE_FROM, math.inf)
    along = (np.arange(_ALONG) + 0.5) / _ALONG
    across = 2.0 * (np.arange(_ACROSS) + 0.5) / _ACROSS - 1.0
    u, v = (each.reshape(-1) for each in np.meshgrid(along, across, indexing="ij"))
    return Constants(
        array(2.0 * np.pi / DIRECTIONS * np.arange(DIRECTIONS)),
        tuple(
            array(DISTANCES[(low <= DISTANCES) & (high > DISTANCES)])
            for low, high in itertools.pairwise(limits)
        ),
        (array(u), array(v), array(np.sqrt(1.0 - v**2))),
    )


def cells_per_step(radius: Array) -> Array:
    """Return how many cells of the finest raster make a step.

    Parameters
    ----------
    radius : float or (B,) array
        Swath radius in steps.
    """
    # At least 8 per step and 2.5 per swath radius.
    if isinstance(radius, float):
        return max(8.0, 2.5 / radius)
    xp = array_namespace(radius)
    return xp.maximum(2.5 / radius, 8.0)


def reference_density(unseen: UnseenMap, steps: Array) -> Array:
    """Return the mean density of the most probable ground that fits into the swath, (B,).

    The unit of density that makes maps of any shape and size alike: no search can gain more than
    one unit per area swept on average.

    Parameters
    ----------
    unseen : UnseenMap
        Density in any unit, nothing seen yet.
    steps : (B,) array
        Steps that the budget allows.
    """
    xp = array_namespace(unseen.step)
    middle = unseen.levels[1]
    cells = xp.clip(middle.reshape((middle.shape[0], -1)), 0.0)
    sorted_cells = xp.flip(xp.sort(cells, axis=1), axis=1)
    sums = xp.cumulative_sum(sorted_cells, axis=1)
    swept = 2.0 * unseen.radius * unseen.step * steps / RATIO**2
    count = xp.clip(xp.astype(swept, xp.int64), 1, cells.shape[1])
    search = xp.arange(middle.shape[0], device=device(middle))
    return sums[search, count - 1] / xp.astype(count, sums.dtype)
