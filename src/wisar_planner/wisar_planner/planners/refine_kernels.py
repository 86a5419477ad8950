"""Compiled kernels of the refinement: moves that keep every step's length, and annealing.

A move rewrites the points strictly between two points `a` and `b` of the path, or all points after
`a` where `b` is one past the last. Each kernel below writes the new points and returns ``(a, b)``,
or ``(-1, -1)`` where the move is impossible.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from wisar_planner.errors import FloatArray
from wisar_planner.planners.cell_vectors import PERIODS
from wisar_planner.planners.random_kernels import StateArray, uniform
from wisar_planner.planners.swath_kernels import (
    ADD,
    REMOVE,
    Canvas,
    TallyArray,
    count_path,
    paint_path,
    path_value,
)
from wisar_planner.search.area_raster import AreaRaster, leg_inside

# Moves, with how often each is tried. The first two find most for their time, as they repaint few
# steps; the others lead out of where these find nothing more. Measured, see docs/policy.md.
SWAP_NEIGHBOURS, BEND_THREE, SHIFT_CHUNKS, SWAP_STEPS, REVERSE = 0, 1, 2, 3, 4
MIRROR, RELOCATE, TURN_TAIL, SWING_TAIL, DROP_STEP, INSERT_STEP = 5, 6, 7, 8, 9, 10
_FREQUENCIES = np.array([24.0, 24.0, 6.0, 1.0, 1.0, 1.0, 1.0, 0.25, 0.25, 0.075, 0.075])
THRESHOLDS = np.cumsum(_FREQUENCIES) / _FREQUENCIES.sum()

# Longest stretch of steps that a move rewrites, but for the tail.
_WINDOW = 16
# Longest tail that is moved as a whole.
_TAIL = 64


@njit(cache=True, nogil=True)
def anneal(
    canvas: Canvas,
    area: AreaRaster,
    radius: float,
    step: float,
    early_weight: float,
    points: FloatArray,
    best_points: FloatArray,
    tallies: TallyArray,
    iterations: int,
    hot: float,
    cold: float,
    thresholds: FloatArray,
    state: StateArray,
) -> None:
    """Try `iterations` random moves on a path, accepting by simulated annealing.

    Parameters
    ----------
    canvas, area, radius, step
        The raster, see `SearchRaster`; the path is painted on it, and is kept up to date.
    early_weight : float
        What is maximised is `path_value` with this weight.
    points : (N + 1, 2) float64
        The path in cells, N >= 1; changed in place.
    best_points : (N + 1, 2) float64
        The best path so far; overwritten with better ones.
    tallies : (2, 4) int64
        Weight that `points` and `best_points` see until the end of each period; kept up to date.
    iterations : int
        Number of moves to try.
    hot, cold : float
        Temperature, in units of weight, at the first and the last of them.
    thresholds : (11,) float64
        Cumulative frequencies of the moves.
    state : (1,) uint64
        Random state.
    """
    last = len(points) - 1
    new = np.empty_like(points)
    tally, unchanged = tallies[0], np.empty(PERIODS, np.int64)
    value, best_value = path_value(tally, early_weight), path_value(tallies[1], early_weight)
    for i in range(iterations):
        temperature = hot * (cold / hot) ** (i / iterations)
        a, b = _propose(points, new, step, thresholds, state)
        if a < 0:
            continue
        end = min(b, last)
        new[a] = points[a]
        if b <= last:
            new[b] = points[b]
        if not _stays_inside(area, new, a, end):
            continue
        unchanged[:] = tally
        paint_path(canvas, points, a, end, radius, REMOVE, tally)
        paint_path(canvas, new, a, end, radius, ADD, tally)
        new_value = path_value(tally, early_weight)
        change = new_value - value
        if change >= 0 or uniform(state) < math.exp(change / temperature):
            points[a + 1 : b] = new[a + 1 : b]
            value = new_value
            if value > best_value:
                best_value = value
                best_points[:] = points
                tallies[1] = tally
        else:
            count_path(canvas, new, a, end, radius, REMOVE)
            count_path(canvas, points, a, end, radius, ADD)
            tally[:] = unchanged


@njit(cache=True, nogil=True)
def _propose(
    points: FloatArray,
    new: FloatArray,
    step: float,
    thresholds: FloatArray,
    state: StateArray,
) -> tuple[int, int]:
    """Write a random move of a random kind; see the module's text."""
    steps = len(points) - 1
    draw = uniform(state)
    move = 0
    while move < INSERT_STEP and draw > thresholds[move]:
        move += 1
    if move >= TURN_TAIL:
        a = steps - min(steps, 1 + int(uniform(state) ** 2 * min(steps, _TAIL)))
        if move == TURN_TAIL:
            return _turn_tail(points, new, a, _small_angle(state))
        if move == SWING_TAIL:
            return _swing_tail(points, new, a, _small_angle(state))
        if move == DROP_STEP:
            return _drop_step(points, new, a, step, 2.0 * math.pi * uniform(state))
        return _insert_step(points, new, a, step, 2.0 * math.pi * uniform(state))
    width = 2
    if move == BEND_THREE:
        width = 3
    elif move > BEND_THREE:
        width = 3 + int(uniform(state) * (_WINDOW - 2))
    if width > steps:
        return -1, -1
    a = int(uniform(state) * (steps - width + 1))
    b = a + width
    if move == SWAP_NEIGHBOURS:
        return _swap_steps(points, new, a, b)
    if move == BEND_THREE:
        return _shift_chunks(points, new, a, a + 1, b, step, state)
    if move == SHIFT_CHUNKS:
        middle = a + 1 + int(uniform(state) * (width - 2))
        return _shift_chunks(points, new, a, middle, b, step, state)
    if move == SWAP_STEPS:
        return _swap_steps(points, new, a, b)
    if move == REVERSE:
        return _reverse(points, new, a, b)
    if move == MIRROR:
        return _mirror(points, new, a, b)
    return _relocate(points, new, a, b, uniform(state) < 0.5)


@njit(cache=True, nogil=True)
def _small_angle(state: StateArray) -> float:
    """Return a random angle: mostly small, now and then anything."""
    if uniform(state) < 0.1:
        return 2.0 * math.pi * (uniform(state) - 0.5)
    return 3.0 * (uniform(state) + uniform(state) - 1.0) ** 3


@njit(cache=True, nogil=True)
def _stays_inside(area: AreaRaster, points: FloatArray, first: int, last: int) -> bool:
    """Return whether all steps from one point of a path to another stay in the area."""
    for i in range(first, last):
        x, y = points[i]
        if not leg_inside(area, x, y, points[i + 1, 0], points[i + 1, 1]):
            return False
    return True


@njit(cache=True, nogil=True)
def _swap_steps(points: FloatArray, new: FloatArray, a: int, b: int) -> tuple[int, int]:
    """Exchange the first and the last step of a stretch; what lies between is shifted."""
    for axis in range(2):
        shift = points[b, axis] - points[b - 1, axis] - points[a + 1, axis] + points[a, axis]
        for i in range(a + 1, b):
            new[i, axis] = points[i, axis] + shift
    return a, b


@njit(cache=True, nogil=True)
def _shift_chunks(
    points: FloatArray,
    new: FloatArray,
    a: int,
    middle: int,
    b: int,
    step: float,
    state: StateArray,
) -> tuple[int, int]:
    """Turn three steps of a stretch so that its ends stay: the chunks between them are shifted.

    The steps are the first, the one after `middle` and the last. One turns by a random angle; the
    other two then have a given sum and, up to their order, one way to reach it. For three
    neighbours this is the motion of a four-bar linkage.
    """
    turned = int(3.0 * uniform(state))
    at = np.array([a, middle, b - 1])
    f, g, h = at[turned], at[(turned + 1) % 3], at[(turned + 2) % 3]
    fx, fy = points[f + 1, 0] - points[f, 0], points[f + 1, 1] - points[f, 1]
    gx, gy = points[g + 1, 0] - points[g, 0], points[g + 1, 1] - points[g, 1]
    hx, hy = points[h + 1, 0] - points[h, 0], points[h + 1, 1] - points[h, 1]
    angle = _small_angle(state)
    cos, sin = math.cos(angle), math.sin(angle)
    fx_new, fy_new = cos * fx - sin * fy, sin * fx + cos * fy
    sx, sy = fx + gx + hx - fx_new, fy + gy + hy - fy_new
    square = sx * sx + sy * sy
    if square > 4.0 * step * step or square < 1e-12 * step * step:
        return -1, -1
    bulge = math.sqrt(step * step / square - 0.25)
    if (gx * hy - gy * hx > 0.0) != (uniform(state) < 0.1):  # Mostly keep the side it bulges to.
        bulge = -bulge
    gx_new, gy_new = 0.5 * sx - bulge * sy, 0.5 * sy + bulge * sx
    moved = np.empty((3, 2))
    moved[turned] = fx_new, fy_new
    moved[(turned + 1) % 3] = gx_new, gy_new
    moved[(turned + 2) % 3] = sx - gx_new, sy - gy_new
    for axis in range(2):
        shift = points[a, axis] + moved[0, axis] - points[a + 1, axis]
        for i in range(a + 1, middle + 1):
            new[i, axis] = points[i, axis] + shift
        shift = new[middle, axis] + moved[1, axis] - points[middle + 1, axis]
        for i in range(middle + 1, b):
            new[i, axis] = points[i, axis] + shift
    return a, b


@njit(cache=True, nogil=True)
def _reverse(points: FloatArray, new: FloatArray, a: int, b: int) -> tuple[int, int]:
    """Fly the steps of a stretch in reverse order."""
    for i in range(a + 1, b):
        for axis in range(2):
            new[i, axis] = points[a, axis] + points[b, axis] - points[a + b - i, axis]
    return a, b


@njit(cache=True, nogil=True)
def _mirror(points: FloatArray, new: FloatArray, a: int, b: int) -> tuple[int, int]:
    """Mirror a stretch at the line through its ends."""
    dx, dy = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1]
    square = dx * dx + dy * dy
    if square < 1e-9:
        return -1, -1
    for i in range(a + 1, b):
        x, y = points[i, 0] - points[a, 0], points[i, 1] - points[a, 1]
        twice = 2.0 * (x * dx + y * dy) / square
        new[i, 0] = points[a, 0] + twice * dx - x
        new[i, 1] = points[a, 1] + twice * dy - y
    return a, b


@njit(cache=True, nogil=True)
def _relocate(
    points: FloatArray, new: FloatArray, a: int, b: int, forward: bool
) -> tuple[int, int]:
    """Take the first step of a stretch to its end, or its last to the front."""
    for axis in range(2):
        if forward:
            shift = points[a, axis] - points[a + 1, axis]
            for i in range(a + 1, b):
                new[i, axis] = points[i + 1, axis] + shift
        else:
            shift = points[b, axis] - points[b - 1, axis]
            for i in range(a + 1, b):
                new[i, axis] = points[i - 1, axis] + shift
    return a, b


@njit(cache=True, nogil=True)
def _turn_tail(points: FloatArray, new: FloatArray, a: int, angle: float) -> tuple[int, int]:
    """Turn all after a point about it."""
    cos, sin = math.cos(angle), math.sin(angle)
    for i in range(a + 1, len(points)):
        x, y = points[i, 0] - points[a, 0], points[i, 1] - points[a, 1]
        new[i, 0] = points[a, 0] + cos * x - sin * y
        new[i, 1] = points[a, 1] + sin * x + cos * y
    return a, len(points)


@njit(cache=True, nogil=True)
def _swing_tail(points: FloatArray, new: FloatArray, a: int, angle: float) -> tuple[int, int]:
    """Turn one step; all after it is shifted."""
    cos, sin = math.cos(angle), math.sin(angle)
    x, y = points[a + 1, 0] - points[a, 0], points[a + 1, 1] - points[a, 1]
    shift_x, shift_y = cos * x - sin * y - x, sin * x + cos * y - y
    for i in range(a + 1, len(points)):
        new[i, 0] = points[i, 0] + shift_x
        new[i, 1] = points[i, 1] + shift_y
    return a, len(points)


@njit(cache=True, nogil=True)
def _drop_step(
    points: FloatArray, new: FloatArray, a: int, step: float, heading: float
) -> tuple[int, int]:
    """Leave a step out, shift what follows, and put a new step at the end."""
    last = len(points) - 1
    for axis in range(2):
        shift = points[a, axis] - points[a + 1, axis]
        for i in range(a + 1, last):
            new[i, axis] = points[i + 1, axis] + shift
        new[last, axis] = points[last, axis] + shift
    new[last, 0] += step * math.cos(heading)
    new[last, 1] += step * math.sin(heading)
    return a, len(points)


@njit(cache=True, nogil=True)
def _insert_step(
    points: FloatArray, new: FloatArray, a: int, step: float, heading: float
) -> tuple[int, int]:
    """Put a new step in, shift what follows, and leave the last step out."""
    shift_x, shift_y = step * math.cos(heading), step * math.sin(heading)
    for i in range(a + 1, len(points)):
        new[i, 0] = points[i - 1, 0] + shift_x
        new[i, 1] = points[i - 1, 1] + shift_y
    return a, len(points)
