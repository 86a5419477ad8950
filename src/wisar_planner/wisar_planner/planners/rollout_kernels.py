"""Compiled kernel of whole greedy paths on a raster."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from wisar_planner.errors import FloatArray
from wisar_planner.planners.swath_kernels import (
    ADD,
    MEASURE,
    REMOVE,
    Canvas,
    TallyArray,
    paint,
    paint_path,
    period_of,
)
from wisar_planner.search.area_raster import AreaRaster, leg_inside

# Share of what a step over the best unseen block would gain under which a step is not worth it.
_FAR_SHARE = 0.1


@njit(cache=True, nogil=True)
def rollout(
    canvas: Canvas,
    area: AreaRaster,
    radius: float,
    step: float,
    blocks: FloatArray,
    block_cells: float,
    target: int,
    arrival: float,
    hug: float,
    headings: int,
    points: FloatArray,
    tally: TallyArray,
) -> bool:
    """Fly to a target, then greedily to the end of the budget.

    Parameters
    ----------
    canvas, area, radius, step
        The raster, see `SearchRaster`; nothing is painted on it before and after.
    blocks : (B, 3) float64
        Centre (x, y) and weight of the coarse blocks of the map that a target is chosen from.
    block_cells : float
        Cells per block.
    target : int
        Block to fly to first; -1 to be greedy from the start.
    arrival : float
        Heading of the first step at the target, rad; NaN for the greedy one.
    hug : float
        What a step pays for each unit of weight that it leaves unseen beside its swath, up to one
        more swath radius; keeps the path close to what has been seen, so that no gaps remain.
    headings : int
        Number of headings tried per step.
    points : (N + 1, 2) float64
        The path in cells: the first row is the start, the others are written.

    tally : (4,) int64
        Weight that the path sees until the end of each period; written.

    Returns
    -------
    bool
        False where the path met a place that no step leads out of.
    """
    steps = len(points) - 1
    left = blocks[:, 2].copy()
    per_step = 2.0 * radius * step / block_cells
    tally[:] = 0
    flown = 0
    heading = 0.0
    for i in range(steps):
        x, y = points[i, 0], points[i, 1]
        if target >= 0 and math.hypot(blocks[target, 0] - x, blocks[target, 1] - y) < step:
            target = -1
        best_score, best_gain, best_heading = -math.inf, 0, math.nan
        if target < 0:
            for k in range(headings):
                angle = heading + 2.0 * math.pi * k / headings
                if not math.isnan(arrival):
                    angle = arrival + 2.0 * math.pi * k / headings
                end_x, end_y = x + step * math.cos(angle), y + step * math.sin(angle)
                if not leg_inside(area, x, y, end_x, end_y):
                    continue
                gain = paint(canvas, x, y, end_x, end_y, radius, 0, MEASURE, tally)
                score = float(gain)
                if hug > 0.0:
                    wide = paint(canvas, x, y, end_x, end_y, 2.0 * radius, 0, MEASURE, tally)
                    score -= hug * (wide - gain)
                if score > best_score:
                    best_score, best_gain, best_heading = score, gain, angle
                if not math.isnan(arrival):
                    break
            if math.isnan(arrival) and best_gain < _FAR_SHARE * per_step * left.max():
                target = _best_block(blocks, left, x, y, step)
            arrival = math.nan
        if target >= 0:
            best_heading = _towards(
                area, x, y, blocks[target, 0], blocks[target, 1], step, headings
            )
        if math.isnan(best_heading):
            break
        heading = best_heading
        points[i + 1, 0] = x + step * math.cos(heading)
        points[i + 1, 1] = y + step * math.sin(heading)
        gain = paint(
            canvas, x, y, points[i + 1, 0], points[i + 1, 1],
            radius, period_of(i, steps), ADD, tally,
        )  # fmt: skip
        flown += 1
        block = _nearest_block(blocks, 0.5 * (x + points[i + 1, 0]), 0.5 * (y + points[i + 1, 1]))
        left[block] = max(0.0, left[block] - gain)
    paint_path(canvas, points, 0, flown, radius, REMOVE, np.zeros_like(tally))
    return flown == steps


@njit(cache=True, nogil=True)
def _towards(
    area: AreaRaster,
    x: float,
    y: float,
    goal_x: float,
    goal_y: float,
    step: float,
    headings: int,
) -> float:
    """Return the heading inside the area that differs least from the way to a goal, or NaN."""
    straight = math.atan2(goal_y - y, goal_x - x)
    for k in range(headings + 1):
        # 0, +1, -1, +2, -2 ... parts of the circle off the straight way.
        turn = ((k + 1) // 2) * (1 if k % 2 else -1) * 2.0 * math.pi / headings
        angle = straight + turn
        if leg_inside(area, x, y, x + step * math.cos(angle), y + step * math.sin(angle)):
            return angle
    return math.nan


@njit(cache=True, nogil=True)
def _best_block(blocks: FloatArray, left: FloatArray, x: float, y: float, step: float) -> int:
    """Return the block out of reach of a step with the most weight left for its distance, or -1.

    What is within reach was found not to be worth a step, so its blocks are written off.
    """
    best, best_rate = -1, 0.0
    for b in range(len(blocks)):
        distance = math.hypot(blocks[b, 0] - x, blocks[b, 1] - y)
        if distance < step:
            left[b] = 0.0
        elif left[b] / distance > best_rate:
            best, best_rate = b, left[b] / distance
    return best


@njit(cache=True, nogil=True)
def _nearest_block(blocks: FloatArray, x: float, y: float) -> int:
    best, best_square = 0, math.inf
    for b in range(len(blocks)):
        square = (blocks[b, 0] - x) ** 2 + (blocks[b, 1] - y) ** 2
        if square < best_square:
            best, best_square = b, square
    return best
