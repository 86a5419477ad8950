"""Compiled union of capsules: the seen area, kept as the pieces of its boundary.

The union is kept as the pieces of the parts of capsules (`capsule_kernels`) that lie outside all
other capsules. A new capsule changes it only near by: the region that it adds is bounded by the
pieces of its own boundary outside the union and by the pieces of the union's boundary inside it,
the latter reversed. A hash of square cells finds the capsules near by, so the cost does not grow
with the length of the path.

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
from numba import njit

from wisar_planner.errors import FloatArray
from wisar_planner.search.capsule_kernels import (
    MOST_CUTS,
    SLOP,
    WHOLE,
    IntArray,
    Records,
    apart,
    beside,
    contains,
    emit_piece,
    find_cuts,
    part_extent,
    part_point,
    set_capsule,
    swallows,
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
EMPTY_KEY = np.iinfo(np.int64).min

# Share by which a capsule is thinner than the one before it, per radius of its own extent.
_THINNER = 1e-13
# Largest gap, in radii, between the ends of a boundary that closes.
_CLOSED = 1e-8
_ATTEMPTS = 8
# Side of a cell of the spatial hash, in swath radii.
_CELL = 4.0


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
    reach = capsule["radius"] * (1.0 + SLOP)
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
                    apart(boxes, old, WHOLE, new, WHOLE)
                    or beside(capsule, other)
                    or beside(other, capsule)
                ):
                    continue
                if swallows(other, capsule):
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
    reach = capsule["radius"] * (1.0 + SLOP)
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
    extent = part_extent(capsule, part)
    if extent == 0.0 or apart(boxes, new, part, old, WHOLE):
        return count
    ox, oy = other["ax"] - capsule["ax"], other["ay"] - capsule["ay"]
    begin = 0.0
    was_inside = False
    for k in range(counts[1, part] + 1):
        end = cuts[1, part, k] if k < counts[1, part] else extent
        if end <= begin:
            continue
        x, y = part_point(capsule, part, 0.5 * (begin + end))
        inside = contains(other, x - ox, y - oy)
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
    reachable = not apart(boxes, old, part, new, WHOLE)
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
            inside = contains(capsule, x + ox, y + oy)
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
        found = find_cuts(capsules, boxes, cuts, counts, old, new)
        if found == 0 and not contains(
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
        extent = part_extent(capsule, part)
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
        thinner = before * (1.0 - share * (1.0 + 2.7 * attempt))
        set_capsule(union.capsules, union.boxes, new, ax, ay, bx, by, thinner)
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
        emit_piece(capsules[piece["capsule"]], piece["part"], begin, end, out, index)
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
            emit_piece(capsules[i], piece["part"], piece["begin"], piece["end"], out, count)
            count += 1
            index = piece["next"]
    return out[:count]
