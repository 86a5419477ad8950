"""Compiled geometry of capsules: their boundaries, and how two of them lie and cross.

A step sees a capsule, all within the swath radius of its leg. Its boundary, walked with the
inside to the left, has four parts: 0 the right side, 1 the half circle about the end, 2 the left
side, 3 the half circle about the start. A position on a part is the distance along a side or the
angle turned along a half circle.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt
from numba import njit

from wisar_planner.errors import FloatArray

CAPSULE = np.dtype(
    [
        ("ax", np.float64),  # start of the leg, m
        ("ay", np.float64),
        ("bx", np.float64),  # end of the leg, m
        ("by", np.float64),
        ("ux", np.float64),  # unit vector along the leg
        ("uy", np.float64),
        ("length", np.float64),
        ("radius", np.float64),
        ("step", np.int64),  # which of the steps added it is
        ("first", np.int64),  # its first piece on the union's boundary, or -1
        ("stamp", np.int64),  # the query that met it last
    ]
)

# The box of a whole capsule, after those of its parts.
WHOLE = 4
# A crossing this many radii past the end of a part still cuts the other part.
SLOP = 1e-9
# A shorter leg, m, has no direction that doubles could tell.
_STILL = 1e-150
# Legs at a smaller angle have no crossing sides; over their length that is less than what capsules
# differ in thickness.
_PARALLEL = 1e-14
# Two boundaries cross at most twice per pair of parts.
MOST_CUTS = 8

IntArray = npt.NDArray[np.int64]
Records = npt.NDArray[Any]


@njit(cache=True)
def set_capsule(
    capsules: Records,
    boxes: FloatArray,
    i: int,
    ax: float,
    ay: float,
    bx: float,
    by: float,
    radius: float,
) -> None:
    """Write the capsule about the leg from a to b and the boxes of its parts in place i."""
    capsule = capsules[i]
    dx, dy = bx - ax, by - ay
    length = math.hypot(dx, dy)
    if length < _STILL:
        length = 0.0
    ux, uy = (dx / length, dy / length) if length > 0.0 else (1.0, 0.0)
    capsule["ax"], capsule["ay"], capsule["bx"], capsule["by"] = ax, ay, bx, by
    capsule["ux"], capsule["uy"] = ux, uy
    capsule["length"] = length
    capsule["radius"] = radius
    capsule["first"] = -1
    capsule["stamp"] = 0

    # Generous by more than the slop of crossings and the rounding of coordinates.
    margin = 2.0 * SLOP * radius + 1e-15 * (abs(ax) + abs(ay) + abs(bx) + abs(by))
    reach = radius + margin
    for part in range(4):
        if part % 2 == 0:
            side = radius if part == 0 else -radius
            boxes[i, part, 0] = min(ax, bx) + side * uy - margin
            boxes[i, part, 1] = min(ay, by) - side * ux - margin
            boxes[i, part, 2] = max(ax, bx) + side * uy + margin
            boxes[i, part, 3] = max(ay, by) - side * ux + margin
        else:
            # A half circle reaches a full radius towards its apex and less away from it.
            cx, cy, tx, ty = (bx, by, ux, uy) if part == 1 else (ax, ay, -ux, -uy)
            boxes[i, part, 0] = cx - (reach if tx <= 0.0 else radius * abs(ty) + margin)
            boxes[i, part, 1] = cy - (reach if ty <= 0.0 else radius * abs(tx) + margin)
            boxes[i, part, 2] = cx + (reach if tx >= 0.0 else radius * abs(ty) + margin)
            boxes[i, part, 3] = cy + (reach if ty >= 0.0 else radius * abs(tx) + margin)
    boxes[i, WHOLE, 0] = min(ax, bx) - reach
    boxes[i, WHOLE, 1] = min(ay, by) - reach
    boxes[i, WHOLE, 2] = max(ax, bx) + reach
    boxes[i, WHOLE, 3] = max(ay, by) + reach


@njit(cache=True)
def apart(boxes: FloatArray, i: int, part: int, j: int, other_part: int) -> bool:
    """Return whether the boxes of two parts are disjoint."""
    # Without short cuts: one branch to predict instead of four.
    return (
        (boxes[i, part, 0] > boxes[j, other_part, 2])
        | (boxes[i, part, 2] < boxes[j, other_part, 0])
        | (boxes[i, part, 1] > boxes[j, other_part, 3])
        | (boxes[i, part, 3] < boxes[j, other_part, 1])
    )


@njit(cache=True)
def beside(one: Any, other: Any) -> bool:
    """Return whether a capsule lies wholly to one side of another."""
    reach = one["radius"] + other["radius"]
    ux, uy = one["ux"], one["uy"]
    begin = ux * (other["ay"] - one["ay"]) - uy * (other["ax"] - one["ax"])
    end = ux * (other["by"] - one["ay"]) - uy * (other["bx"] - one["ax"])
    return min(begin, end) > reach or max(begin, end) < -reach


@njit(cache=True)
def part_extent(capsule: Any, part: int) -> float:
    """Return the last position on a part."""
    return math.pi if part % 2 == 1 else capsule["length"]


@njit(cache=True)
def part_point(capsule: Any, part: int, t: float) -> tuple[float, float]:
    """Return the point at position t of a part, relative to the start of the leg."""
    ux, uy, radius = capsule["ux"], capsule["uy"], capsule["radius"]
    if part == 0:
        return t * ux + radius * uy, t * uy - radius * ux
    if part == 2:
        t = capsule["length"] - t
        return t * ux - radius * uy, t * uy + radius * ux
    along, across = radius, 0.0  # At the apex, the middle of a whole half circle.
    if t != 0.5 * math.pi:
        along, across = radius * math.sin(t), -radius * math.cos(t)
    if part == 1:
        dx, dy = capsule["bx"] - capsule["ax"], capsule["by"] - capsule["ay"]
        return dx + along * ux - across * uy, dy + along * uy + across * ux
    return -along * ux + across * uy, -along * uy - across * ux


@njit(cache=True)
def _in_part(capsule: Any, part: int, x: float, y: float) -> tuple[float, float, bool]:
    """Return where a point of the line or circle of a part lies, and whether that is on the part.

    The point is relative to the start of the leg. For a side the first number is its position; for
    a half circle the two are the components along the leg, outwards, and to the left of the apex.
    """
    ux, uy = capsule["ux"], capsule["uy"]
    slop = SLOP * capsule["radius"]
    if part % 2 == 0:
        along, length = x * ux + y * uy, capsule["length"]
        t = along if part == 0 else length - along
        return min(max(t, 0.0), length), 0.0, -slop <= t <= length + slop
    if part == 1:
        x -= capsule["bx"] - capsule["ax"]
        y -= capsule["by"] - capsule["ay"]
    else:
        ux, uy = -ux, -uy
    along = x * ux + y * uy
    return max(along, 0.0), y * ux - x * uy, along >= -slop


@njit(cache=True)
def contains(capsule: Any, x: float, y: float) -> bool:
    """Return whether a capsule contains a point relative to the start of its leg."""
    ux, uy, radius = capsule["ux"], capsule["uy"], capsule["radius"]
    along = x * ux + y * uy
    if along > 0.0:
        if along < capsule["length"]:
            return abs(y * ux - x * uy) < radius
        x -= capsule["bx"] - capsule["ax"]
        y -= capsule["by"] - capsule["ay"]
    return x * x + y * y < radius * radius


@njit(cache=True)
def swallows(outer: Any, inner: Any) -> bool:
    """Return whether one capsule contains the other: both its ends lie deep enough inside."""
    slack = outer["radius"] - inner["radius"]
    if slack < 0.0:
        return False
    ux, uy, length = outer["ux"], outer["uy"], outer["length"]
    for end in range(2):
        px, py = (inner["ax"], inner["ay"]) if end == 0 else (inner["bx"], inner["by"])
        x, y = px - outer["ax"], py - outer["ay"]
        along = x * ux + y * uy
        if along >= length:
            x, y = px - outer["bx"], py - outer["by"]
        elif along > 0.0:
            x, y = y * ux - x * uy, 0.0
        if x * x + y * y > slack * slack:
            return False
    return True


@njit(cache=True)
def _crossings(
    one: Any, part: int, other: Any, other_part: int
) -> tuple[int, float, float, float, float]:
    """Find where the lines or circles of two parts cross: how often, and at which points.

    Points are relative to the start of `one`. Distances between parallel or concentric parts come
    out as differences of radii without rounding, which is what tells coinciding boundaries apart.
    """
    ox, oy = other["ax"] - one["ax"], other["ay"] - one["ay"]
    ux, uy, radius = one["ux"], one["uy"], one["radius"]
    vx, vy, other_radius = other["ux"], other["uy"], other["radius"]
    if part % 2 == 0 and other_part % 2 == 0:
        offset = radius if part == 2 else -radius
        other_offset = other_radius if other_part == 2 else -other_radius
        sine = ux * vy - uy * vx
        if abs(sine) < _PARALLEL:
            return 0, 0.0, 0.0, 0.0, 0.0
        # On `one` at distance t along and `offset` to the left; solve for the distance left of
        # the other's leg.
        left = oy * vx - ox * vy
        t = -(other_offset + left - offset * (ux * vx + uy * vy)) / sine
        return 1, t * ux - offset * uy, t * uy + offset * ux, 0.0, 0.0
    if part % 2 == 1 and other_part % 2 == 1:
        px, py = (one["bx"], one["by"]) if part == 1 else (one["ax"], one["ay"])
        qx, qy = (other["bx"], other["by"]) if other_part == 1 else (other["ax"], other["ay"])
        # Straight from centre to centre, so that a shared waypoint gives 0.
        dx, dy = qx - px, qy - py
        square = dx * dx + dy * dy
        if square == 0.0 or square > (radius + other_radius) * (radius + other_radius):
            return 0, 0.0, 0.0, 0.0, 0.0
        distance = math.sqrt(square)
        near = 0.5 * (distance + (radius - other_radius) * (radius + other_radius) / distance)
        height = (radius - near) * (radius + near)
        if height <= 0.0:
            return 0, 0.0, 0.0, 0.0, 0.0
        dx, dy, height = dx / distance, dy / distance, math.sqrt(height)
        x, y = px - one["ax"] + near * dx, py - one["ay"] + near * dy
        return 2, x - height * dy, y + height * dx, x + height * dy, y - height * dx
    # A side and a half circle, as seen from the leg of the side.
    if part % 2 == 0:
        sx, sy, lx, ly, reach = 0.0, 0.0, ux, uy, other_radius
        offset = radius if part == 2 else -radius
        cx, cy = ox, oy
        if other_part == 1:
            cx, cy = other["bx"] - one["ax"], other["by"] - one["ay"]
    else:
        sx, sy, lx, ly, reach = ox, oy, vx, vy, radius
        offset = other_radius if other_part == 2 else -other_radius
        cx, cy = -ox, -oy
        if part == 1:
            cx, cy = one["bx"] - other["ax"], one["by"] - other["ay"]
    # The centre relative to the start of the leg: along it, and left of its side.
    along, left = cx * lx + cy * ly, cy * lx - cx * ly - offset
    height = (reach - left) * (reach + left)
    if height <= 0.0:
        return 0, 0.0, 0.0, 0.0, 0.0
    height = math.sqrt(height)
    x, y = sx + along * lx - offset * ly, sy + along * ly + offset * lx
    return 2, x + height * lx, y + height * ly, x - height * lx, y - height * ly


@njit(cache=True)
def _insert(cuts: FloatArray, counts: IntArray, which: int, part: int, t: float) -> None:
    """Insert a position into the sorted cuts of a part of the old (0) or new (1) capsule."""
    k = counts[which, part]
    counts[which, part] = k + 1
    while k > 0 and cuts[which, part, k - 1] > t:
        cuts[which, part, k] = cuts[which, part, k - 1]
        k -= 1
    cuts[which, part, k] = t


@njit(cache=True)
def find_cuts(
    capsules: Records, boxes: FloatArray, cuts: FloatArray, counts: IntArray, old: int, new: int
) -> int:
    """Find where the boundaries of two capsules cross, as sorted positions on all their parts.

    Both sides take the position from the same point, so that pieces cut there meet. Returns the
    number of crossings.
    """
    one, other = capsules[old], capsules[new]
    ox, oy = other["ax"] - one["ax"], other["ay"] - one["ay"]
    for part in range(4):
        counts[0, part] = 0
        counts[1, part] = 0
    found = 0
    for old_part in range(4):
        if apart(boxes, old, old_part, new, WHOLE) or part_extent(one, old_part) == 0.0:
            continue
        for new_part in range(4):
            if apart(boxes, old, old_part, new, new_part) or part_extent(other, new_part) == 0.0:
                continue
            count, x, y, next_x, next_y = _crossings(one, old_part, other, new_part)
            for _ in range(count):
                s, s_left, on_old = _in_part(one, old_part, x, y)
                t, t_left, on_new = _in_part(other, new_part, x - ox, y - oy)
                if on_old and on_new:
                    if old_part % 2 == 1:
                        s = math.atan2(s, -s_left)
                    if new_part % 2 == 1:
                        t = math.atan2(t, -t_left)
                    _insert(cuts, counts, 0, old_part, s)
                    _insert(cuts, counts, 1, new_part, t)
                    found += 1
                x, y = next_x, next_y
    return found


@njit(cache=True)
def emit_piece(
    capsule: Any, part: int, begin: float, end: float, out: FloatArray, index: int
) -> None:
    """Write a piece, from `begin` to `end` on a part, as maps integrate along it."""
    if part % 2 == 0:
        x0, y0 = part_point(capsule, part, begin)
        x1, y1 = part_point(capsule, part, end)
        out[index, 0] = capsule["ax"] + x0
        out[index, 1] = capsule["ay"] + y0
        out[index, 2] = capsule["ax"] + x1
        out[index, 3] = capsule["ay"] + y1
        out[index, 4] = 0.0
    else:
        heading = math.atan2(capsule["uy"], capsule["ux"])
        zero = heading - 0.5 * math.pi if part == 1 else heading + 0.5 * math.pi
        out[index, 0] = capsule["bx"] if part == 1 else capsule["ax"]
        out[index, 1] = capsule["by"] if part == 1 else capsule["ay"]
        out[index, 2] = zero + begin
        out[index, 3] = zero + end
        out[index, 4] = capsule["radius"]
