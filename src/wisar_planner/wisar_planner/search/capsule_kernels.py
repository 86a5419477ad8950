"""Compiled geometry of the seen area: the boundary of a union of capsules.

A step sees a capsule, all within the swath radius of its leg. Its boundary, walked with the
inside to the left, has four parts: 0 the right side, 1 the half circle about the end, 2 the left
side, 3 the half circle about the start. A position on a part is the distance along a side or the
angle turned along a half circle.

The union is kept as the pieces of these parts that lie outside all other capsules. A new capsule
changes it only near by: the region that it adds is bounded by the pieces of its own boundary
outside the union and by the pieces of the union's boundary inside it, the latter reversed. A hash
of square cells finds the capsules near by, so the cost does not grow with the length of the path.

Boundaries that coincide (collinear steps, a retraced leg, lanes two radii apart, crossings at a
waypoint) are told apart by controlled perturbation (Halperin and Shelton 1998): each capsule is
thinner than those before it by a share of 1e-13 and more, so that what coincided becomes nested.
The added region's boundary must close; where rounding got a decision wrong it does not, and the
step is tried again a little thinner.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

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
PIECE = np.dtype(
    [
        ("capsule", np.int64),
        ("part", np.int64),
        ("begin", np.float64),  # positions on the part
        ("end", np.float64),
        ("next", np.int64),  # next piece of the same capsule, or the next free one; -1 ends
    ]
)
CELL = np.dtype([("key", np.int64), ("first", np.int64)])
ENTRY = np.dtype([("capsule", np.int64), ("next", np.int64)])

# Slots of the `used` array: how much of each array is in use, and the rest of the state.
CAPSULES, PIECES, FREE, ENTRIES, CELLS, QUERIES, OUT, STEPS = range(8)
# The box of a whole capsule, after those of its parts.
WHOLE = 4
EMPTY_KEY = np.iinfo(np.int64).min

# Share by which a capsule is thinner than the one before it, per radius of its own extent.
_THINNER = 1e-13
# A crossing this many radii past the end of a part still cuts the other part.
_SLOP = 1e-9
# Largest gap, in radii, between the ends of a boundary that closes.
_CLOSED = 1e-8
_ATTEMPTS = 8
# A shorter leg, m, has no direction that doubles could tell.
_STILL = 1e-150
# Legs at a smaller angle have no crossing sides; over their length that is less than what capsules
# differ in thickness.
_PARALLEL = 1e-14
# Side of a cell of the spatial hash, in swath radii.
_CELL = 4.0
# Two boundaries cross at most twice per pair of parts.
MOST_CUTS = 8

IntArray = npt.NDArray[np.int64]
Records = npt.NDArray[Any]


class Union(NamedTuple):
    """The arrays that hold a union of capsules, and room for the kernels to work in.

    The kernels never allocate: one that runs out of room says so, and the caller doubles it all.
    """

    capsules: Records
    boxes: FloatArray  # (N, 5, 4): (xmin, ymin, xmax, ymax) of the parts of a capsule, of all of it
    pieces: Records
    cells: Records  # a hash table by open addressing; its length is a power of two
    entries: Records
    used: IntArray
    neighbours: IntArray  # of the capsule at hand
    fresh: Records  # pieces that the capsule at hand makes or changes
    covers: FloatArray  # (4, N, 2): parts of its boundary inside other capsules
    n_covers: IntArray  # (4,)
    cuts: FloatArray  # (2, 4, N): crossings on the parts of two capsules
    cut_counts: IntArray  # (2, 4)
    out: FloatArray  # (N, 5): pieces for a map to integrate along
    owners: IntArray  # (N,)


@njit(cache=True)
def _set_capsule(
    union: Union, i: int, ax: float, ay: float, bx: float, by: float, radius: float
) -> None:
    capsule = union.capsules[i]
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

    boxes = union.boxes
    # Generous by more than the slop of crossings and the rounding of coordinates.
    margin = 2.0 * _SLOP * radius + 1e-15 * (abs(ax) + abs(ay) + abs(bx) + abs(by))
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
def _apart(boxes: FloatArray, i: int, part: int, j: int, other_part: int) -> bool:
    """Return whether the boxes of two parts are disjoint."""
    # Without short cuts: one branch to predict instead of four.
    return (
        (boxes[i, part, 0] > boxes[j, other_part, 2])
        | (boxes[i, part, 2] < boxes[j, other_part, 0])
        | (boxes[i, part, 1] > boxes[j, other_part, 3])
        | (boxes[i, part, 3] < boxes[j, other_part, 1])
    )


@njit(cache=True)
def _beside(one: Any, other: Any) -> bool:
    """Return whether a capsule lies wholly to one side of another."""
    reach = one["radius"] + other["radius"]
    ux, uy = one["ux"], one["uy"]
    begin = ux * (other["ay"] - one["ay"]) - uy * (other["ax"] - one["ax"])
    end = ux * (other["by"] - one["ay"]) - uy * (other["bx"] - one["ax"])
    return min(begin, end) > reach or max(begin, end) < -reach


@njit(cache=True)
def _extent(capsule: Any, part: int) -> float:
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
    slop = _SLOP * capsule["radius"]
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
def _contains(capsule: Any, x: float, y: float) -> bool:
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
def _swallows(outer: Any, inner: Any) -> bool:
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
def _find_cuts(
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
        if _apart(boxes, old, old_part, new, WHOLE) or _extent(one, old_part) == 0.0:
            continue
        for new_part in range(4):
            if _apart(boxes, old, old_part, new, new_part) or _extent(other, new_part) == 0.0:
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
def _row_span(
    ax: float, ay: float, bx: float, by: float, reach: float, low: float, high: float
) -> tuple[float, float]:
    """Return the range in x of what lies within `reach` of a leg between two values of y."""
    if by < ay:
        ax, ay, bx, by = bx, by, ax, ay
    start, end = ax, bx
    if by > ay:
        start = ax + (bx - ax) * ((min(max(low - reach, ay), by) - ay) / (by - ay))
        end = ax + (bx - ax) * ((min(max(high + reach, ay), by) - ay) / (by - ay))
    return min(start, end) - reach, max(start, end) + reach


@njit(cache=True)
def _find_cell(cells: Records, key: int) -> int:
    """Return the slot of a cell in the hash table, or the free slot where it belongs."""
    mask = len(cells) - 1
    # Multiplicative hashing by 2^64 over the golden ratio.
    slot = ((key * -7046029254386353131) >> 20) & mask
    while cells[slot]["key"] != key and cells[slot]["key"] != EMPTY_KEY:
        slot = (slot + 1) & mask
    return slot


@njit(cache=True)
def _key(column: int, row: int) -> int:
    return (column << 32) ^ (row & 0xFFFFFFFF)


@njit(cache=True)
def _find_neighbours(union: Union, new: int, cell: float) -> int:
    """List the capsules that may overlap capsule `new`.

    Returns their number; -1 if one of them contains it; -2 if there is no room.
    """
    capsules, boxes, neighbours = union.capsules, union.boxes, union.neighbours
    cells, entries, used = union.cells, union.entries, union.used
    capsule = capsules[new]
    ax, ay, bx, by = capsule["ax"], capsule["ay"], capsule["bx"], capsule["by"]
    reach = capsule["radius"] * (1.0 + _SLOP)
    used[QUERIES] += 1
    query = used[QUERIES]
    count = 0
    for row in range(
        math.floor((min(ay, by) - reach) / cell), math.floor((max(ay, by) + reach) / cell) + 1
    ):
        left, right = _row_span(ax, ay, bx, by, reach, row * cell, (row + 1) * cell)
        for column in range(math.floor(left / cell), math.floor(right / cell) + 1):
            slot = _find_cell(cells, _key(column, row))
            if cells[slot]["key"] == EMPTY_KEY:
                continue
            entry = cells[slot]["first"]
            while entry >= 0:
                old = entries[entry]["capsule"]
                entry = entries[entry]["next"]
                other = capsules[old]
                if other["stamp"] == query:
                    continue
                other["stamp"] = query
                if (
                    _apart(boxes, old, WHOLE, new, WHOLE)
                    or _beside(capsule, other)
                    or _beside(other, capsule)
                ):
                    continue
                if _swallows(other, capsule):
                    return -1
                if count == len(neighbours):
                    return -2
                neighbours[count] = old
                count += 1
    return count


@njit(cache=True)
def _register(union: Union, new: int, cell: float) -> bool:
    """Enter a capsule in all cells that it may touch; return False if there is no room."""
    cells, entries, used = union.cells, union.entries, union.used
    capsule = union.capsules[new]
    ax, ay, bx, by = capsule["ax"], capsule["ay"], capsule["bx"], capsule["by"]
    reach = capsule["radius"] * (1.0 + _SLOP)
    low = math.floor((min(ay, by) - reach) / cell)
    high = math.floor((max(ay, by) + reach) / cell)
    needed = 0  # Count first, so that a refusal leaves nothing behind.
    for row in range(low, high + 1):
        left, right = _row_span(ax, ay, bx, by, reach, row * cell, (row + 1) * cell)
        needed += math.floor(right / cell) + 1 - math.floor(left / cell)
    if used[ENTRIES] + needed > len(entries) or 2 * (used[CELLS] + needed) > len(cells):
        return False
    for row in range(low, high + 1):
        left, right = _row_span(ax, ay, bx, by, reach, row * cell, (row + 1) * cell)
        for column in range(math.floor(left / cell), math.floor(right / cell) + 1):
            slot = _find_cell(cells, _key(column, row))
            if cells[slot]["key"] == EMPTY_KEY:
                cells[slot]["key"] = _key(column, row)
                cells[slot]["first"] = -1
                used[CELLS] += 1
            entry = used[ENTRIES]
            entries[entry]["capsule"] = new
            entries[entry]["next"] = cells[slot]["first"]
            cells[slot]["first"] = entry
            used[ENTRIES] += 1
    return True


@njit(cache=True)
def _emit(capsule: Any, part: int, begin: float, end: float, out: FloatArray, index: int) -> None:
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


@njit(cache=True)
def _landmark(capsule: Any, part: int, t: float, frame: Any, unit: float) -> float:
    """Return a generic function of a point of a boundary, in the frame of another capsule.

    Summed over the ends of pieces less their beginnings it vanishes if the pieces close. It is
    not linear, lest errors on two opposite sides cancel.
    """
    x, y = part_point(capsule, part, t)
    x = (x + capsule["ax"] - frame["ax"]) / unit
    y = (y + capsule["ay"] - frame["ay"]) / unit
    return x * (0.73 + 0.41 * x - 0.29 * y) + y * (0.57 + 0.83 * y)


@njit(cache=True)
def _cover(
    capsules: Records,
    boxes: FloatArray,
    cuts: FloatArray,
    counts: IntArray,
    old: int,
    new: int,
    part: int,
    covers: FloatArray,
    count: int,
) -> int:
    """Append what of a part of the new boundary lies inside an old capsule to `covers`.

    The first `count` covers of the part are taken; returns how many are then.
    """
    capsule, other = capsules[new], capsules[old]
    extent = _extent(capsule, part)
    if extent == 0.0 or _apart(boxes, new, part, old, WHOLE):
        return count
    ox, oy = other["ax"] - capsule["ax"], other["ay"] - capsule["ay"]
    begin = 0.0
    was_inside = False
    for k in range(counts[1, part] + 1):
        end = cuts[1, part, k] if k < counts[1, part] else extent
        if end <= begin:
            continue
        x, y = part_point(capsule, part, 0.5 * (begin + end))
        inside = _contains(other, x - ox, y - oy)
        if inside:
            if not was_inside:
                covers[part, count, 0] = begin
                count += 1
            covers[part, count - 1, 1] = end
        was_inside = inside
        begin = end
    return count


@njit(cache=True)
def _split(
    capsules: Records,
    boxes: FloatArray,
    cuts: FloatArray,
    counts: IntArray,
    piece: Any,
    new: int,
    fresh: Records,
    front: int,
    back: int,
) -> tuple[int, int]:
    """Split a piece of the union's boundary into what lies inside a new capsule and the rest.

    What lies inside goes to the front of `fresh`, the rest to its back, behind what is there.
    Returns the new number of pieces at the front and at the back.
    """
    old, part = piece["capsule"], piece["part"]
    capsule, other = capsules[new], capsules[old]
    ox, oy = other["ax"] - capsule["ax"], other["ay"] - capsule["ay"]
    reachable = not _apart(boxes, old, part, new, WHOLE)
    begin = piece["begin"]
    side = 0
    for k in range(counts[0, part] + 1):
        end = piece["end"]
        if k < counts[0, part]:
            end = min(cuts[0, part, k], end)
        if end <= begin:
            continue
        inside = False
        if reachable:
            x, y = part_point(other, part, 0.5 * (begin + end))
            inside = _contains(capsule, x + ox, y + oy)
        if inside:
            if side != 1:
                fresh[front]["capsule"] = old
                fresh[front]["part"] = part
                fresh[front]["begin"] = begin
                front += 1
            fresh[front - 1]["end"] = end
        else:
            if side != -1:
                back += 1
                fresh[-back]["capsule"] = old
                fresh[-back]["part"] = part
                fresh[-back]["begin"] = begin
            fresh[-back]["end"] = end
        side = 1 if inside else -1
        begin = end
    return front, back


@njit(cache=True)
def _uncovered(
    covers: FloatArray, count: int, new: int, part: int, extent: float, fresh: Records, front: int
) -> int:
    """Append what of a part of the new boundary is not covered to the front of `fresh`."""
    for k in range(1, count):  # Sort by where they begin; there are few.
        begin, end = covers[part, k, 0], covers[part, k, 1]
        j = k
        while j > 0 and covers[part, j - 1, 0] > begin:
            covers[part, j, 0] = covers[part, j - 1, 0]
            covers[part, j, 1] = covers[part, j - 1, 1]
            j -= 1
        covers[part, j, 0], covers[part, j, 1] = begin, end
    begin = 0.0
    for k in range(count + 1):
        end = covers[part, k, 0] if k < count else extent
        if end > begin:
            fresh[front]["capsule"] = new
            fresh[front]["part"] = part
            fresh[front]["begin"] = begin
            fresh[front]["end"] = end
            front += 1
        if k < count:
            begin = max(begin, covers[part, k, 1])
    return front


@njit(cache=True)
def _added_region(union: Union, n_neighbours: int, new: int) -> tuple[int, int, float]:
    """Find the boundary of the region that capsule `new` adds to the union.

    Fills `fresh` with, from the front, the pieces of the union's boundary inside the new capsule
    and those of the new capsule's boundary outside the union, told apart by their capsule; and,
    from the back, the pieces outside the new capsule of those capsules that lose some.

    Returns the number of pieces at the front and at the back, and by how much the boundary fails
    to close, in radii. The first is -1 if there is no room.
    """
    capsules, boxes, pieces, fresh = union.capsules, union.boxes, union.pieces, union.fresh
    neighbours, cuts, counts = union.neighbours, union.cuts, union.cut_counts
    covers, n_covers = union.covers, union.n_covers
    capsule = capsules[new]
    for part in range(4):
        n_covers[part] = 0
    front, back = 0, 0
    for m in range(n_neighbours):
        old = neighbours[m]
        other = capsules[old]
        found = _find_cuts(capsules, boxes, cuts, counts, old, new)
        if found == 0 and not _contains(
            capsule, other["ax"] - capsule["ax"], other["ay"] - capsule["ay"]
        ):
            continue  # Apart, as neither contains the other.
        for part in range(4):
            if n_covers[part] + MOST_CUTS > covers.shape[1]:
                return -1, 0, 0.0
            n_covers[part] = _cover(
                capsules, boxes, cuts, counts, old, new, part, covers, n_covers[part]
            )
        unchanged_front, unchanged_back = front, back
        index = other["first"]
        while index >= 0:
            if front + back + 2 * (MOST_CUTS + 1) > len(fresh):
                return -1, 0, 0.0
            front, back = _split(
                capsules, boxes, cuts, counts, pieces[index], new, fresh, front, back
            )
            index = pieces[index]["next"]
        if front == unchanged_front:
            back = unchanged_back

    lost = front
    for part in range(4):
        if front + back + n_covers[part] + 1 > len(fresh):
            return -1, 0, 0.0
        extent = _extent(capsule, part)
        front = _uncovered(covers, n_covers[part], new, part, extent, fresh, front)

    unit = capsule["radius"] + capsule["length"]
    gap = 0.0
    for k in range(front):
        piece = fresh[k]
        owner = capsules[piece["capsule"]]
        rise = _landmark(owner, piece["part"], piece["end"], capsule, unit)
        rise -= _landmark(owner, piece["part"], piece["begin"], capsule, unit)
        gap += rise if k >= lost else -rise
    return front, back, abs(gap) * unit / capsule["radius"]


@njit(cache=True)
def _place(
    union: Union, ax: float, ay: float, bx: float, by: float, radius: float
) -> tuple[int, int]:
    """Put a capsule in the first free place and find the region that it adds.

    Returns the number of pieces at the front and at the back of `fresh`, as `_added_region`;
    (0, 0) if it adds nothing, and -1 if there is no room.
    """
    new = union.used[CAPSULES]
    if new == len(union.capsules):
        return -1, 0
    before = union.capsules[new - 1]["radius"] if new > 0 else radius
    share = _THINNER * (1.0 + math.hypot(bx - ax, by - ay) / radius)
    front, back = 0, 0
    for attempt in range(_ATTEMPTS):
        _set_capsule(union, new, ax, ay, bx, by, before * (1.0 - share * (1.0 + 2.7 * attempt)))
        count = _find_neighbours(union, new, _CELL * radius)
        if count == -1:
            return 0, 0
        if count == -2:
            return -1, 0
        front, back, gap = _added_region(union, count, new)
        if front < 0 or gap < _CLOSED:
            break
    return front, back


@njit(cache=True)
def _emit_region(union: Union, front: int, owner: int) -> None:
    """Write the boundary of the region that the last capsule adds."""
    capsules, fresh, out, owners = union.capsules, union.fresh, union.out, union.owners
    new, index = union.used[CAPSULES], union.used[OUT]
    for k in range(front):
        piece = fresh[k]
        begin, end = piece["begin"], piece["end"]
        if piece["capsule"] != new:
            begin, end = end, begin
        _emit(capsules[piece["capsule"]], piece["part"], begin, end, out, index)
        owners[index] = owner
        index += 1
    union.used[OUT] = index


@njit(cache=True)
def try_steps(union: Union, radius: float, start: FloatArray, ends: FloatArray, first: int) -> int:
    """Write the boundaries of what steps from `start` to each of `ends` would add.

    Step i is the owner i of its pieces in `out`; `used[OUT]` counts them. Begins with the end
    `first` and returns the number of ends done: fewer than all if there is no room.
    """
    for i in range(first, len(ends)):
        front, _ = _place(union, start[0], start[1], ends[i, 0], ends[i, 1], radius)
        if front < 0 or union.used[OUT] + front > len(union.out):
            return i
        _emit_region(union, front, i)
    return len(ends)


@njit(cache=True)
def _store(union: Union, front: int, back: int) -> None:
    """Bring the pieces of the union's boundary up to date with a new capsule."""
    capsules, pieces, fresh, used = union.capsules, union.pieces, union.fresh, union.used
    new = used[CAPSULES]
    for k in range(front):  # Free the pieces of the capsules that lose some.
        old = fresh[k]["capsule"]
        if old == new:
            continue
        index = capsules[old]["first"]
        capsules[old]["first"] = -1
        while index >= 0:
            after = pieces[index]["next"]
            pieces[index]["next"] = used[FREE]
            used[FREE] = index
            index = after
    for k in range(front + back):  # Store what is left of them, and the new capsule's.
        piece = fresh[k] if k < front else fresh[front - 1 - k]
        owner = piece["capsule"]
        if k < front and owner != new:
            continue
        index = used[FREE]
        if index >= 0:
            used[FREE] = pieces[index]["next"]
        else:
            index = used[PIECES]
            used[PIECES] += 1
        stored = pieces[index]
        stored["capsule"] = owner
        stored["part"] = piece["part"]
        stored["begin"] = piece["begin"]
        stored["end"] = piece["end"]
        stored["next"] = capsules[owner]["first"]
        capsules[owner]["first"] = index
    used[CAPSULES] += 1


@njit(cache=True)
def add_steps(
    union: Union, radius: float, starts: FloatArray, ends: FloatArray, first: int, emitting: bool
) -> int:
    """Add steps to the union, and write the boundary of what each adds if `emitting`.

    Step i is the owner i of its pieces in `out`; `used[OUT]` counts them. Begins with step
    `first` and returns the number of steps done: fewer than all if there is no room.
    """
    used = union.used
    for i in range(first, len(ends)):
        front, back = _place(union, starts[i, 0], starts[i, 1], ends[i, 0], ends[i, 1], radius)
        if front == 0:
            used[STEPS] += 1
            continue
        if (
            front < 0
            or used[PIECES] + front + back > len(union.pieces)
            or (emitting and used[OUT] + front > len(union.out))
            or not _register(union, used[CAPSULES], _CELL * radius)
        ):
            return i
        if emitting:
            _emit_region(union, front, i)
        union.capsules[used[CAPSULES]]["step"] = used[STEPS]
        used[STEPS] += 1
        _store(union, front, back)
    return len(ends)


@njit(cache=True)
def rehash(cells: Records, bigger: Records) -> None:
    """Enter all cells of a hash table in a bigger, empty one."""
    for k in range(len(cells)):
        if cells[k]["key"] != EMPTY_KEY:
            slot = _find_cell(bigger, cells[k]["key"])
            bigger[slot]["key"] = cells[k]["key"]
            bigger[slot]["first"] = cells[k]["first"]


@njit(cache=True)
def union_boundary(union: Union) -> FloatArray:
    """Return the pieces of the union's boundary, (N, 5), as maps integrate along them."""
    capsules, pieces = union.capsules, union.pieces
    out = np.empty((union.used[PIECES], 5))
    count = 0
    for i in range(union.used[CAPSULES]):
        index = capsules[i]["first"]
        while index >= 0:
            piece = pieces[index]
            _emit(capsules[i], piece["part"], piece["begin"], piece["end"], out, count)
            count += 1
            index = piece["next"]
    return out[:count]
