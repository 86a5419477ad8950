"""What is still unseen, as rasters of three resolutions, for many searches at once."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
from array_api_compat import array_namespace, device

from wisar_planner.policy import unseen_kernels

# Arrays of NumPy or PyTorch.
Array = Any

# Cells of one level that make a cell of the next, along each side.
RATIO = 4
LEVELS = 3
# Sides of the finest raster and of its windows are multiples of this.
BLOCK = RATIO ** (LEVELS - 1)
# Value outside the search area.
OUTSIDE = -0.25


class UnseenMap:
    """Unseen probability density over the ground, for B searches side by side.

    Lengths and positions are in cells of the finest raster: cell (row, column) covers
    ``column <= x < column + 1`` and ``row <= y < row + 1``.

    Parameters
    ----------
    density : (B, rows, columns) float32
        Density of the map in any unit, not negative where it counts, `OUTSIDE` elsewhere; the
        sides are multiples of `BLOCK`. Taken over and changed by `see`.
    step : (B,) float32
        Step length as the policy sees it, the unit of its distances.
    radius : (B,) float32
        Swath radius. Positions keep off the raster's border, see `margin`.
    window : int
        Side of the square that a step can touch, see `window_side`.

    Attributes
    ----------
    levels : list of (B, rows, columns) float32
        The rasters, the finest first.
    step, radius, window
        As given.
    before : (B, 2) float32
        Where the last flight of each search began; NaN before the first.
    """

    def __init__(self, density: Array, step: Array, radius: Array, window: int) -> None:
        xp = array_namespace(density)
        self.step, self.radius = step, radius
        self.window = window
        self.levels = [density]
        for _ in range(1, LEVELS):
            self.levels.append(_block_mean(xp, self.levels[-1]))
        self.before = xp.full(
            (density.shape[0], 2), math.nan, dtype=step.dtype, device=device(step)
        )
        self._searches = xp.arange(density.shape[0], device=device(density))
        self._side = xp.arange(window, device=device(density))

    def arrays(self) -> dict[str, Array]:
        """Return all that changes, by name; written to, it is the state of another search."""
        levels = {f"unseen{i}": level for i, level in enumerate(self.levels)}
        return {**levels, "step": self.step, "radius": self.radius, "before": self.before}

    def levels_in_memory(self) -> unseen_kernels.Levels:
        """Return the rasters for compiled kernels: NumPy arrays that share their memory."""
        fine, middle, coarse = (np.asarray(level) for level in self.levels)
        return fine, middle, coarse

    def replace(self, searches: Array, others: UnseenMap) -> None:
        """Continue some searches, given by their numbers, as those of another map of this size."""
        for level, other in zip(self.levels, others.levels, strict=True):
            level[searches] = other
        self.step[searches] = others.step
        self.radius[searches] = others.radius
        self.before[searches] = others.before

    def see(self, start: Array, end: Array) -> Array:
        """Take out what straight flights see; return how much that was, (B,), in density x cells.

        A cell at the swath's edge counts by the share of it that the swath covers. Where the edge
        runs along that of the flight before, the share is of both together, since they bend around
        the same point; crossing edges of older flights count as independent.

        Parameters
        ----------
        start, end : (B, 2) float32
            Ends of the flights, not longer than fit into the window; each begins where the one
            before ended.
        """
        if not in_main_memory(start):
            return self.see_in_arrays(start, end)
        gain = unseen_kernels.see(
            self.levels_in_memory(), np.asarray(self.before), np.asarray(start), np.asarray(end),
            np.asarray(self.radius), self.window, BLOCK, RATIO,
        )  # fmt: skip
        return array_namespace(start).asarray(gain)

    def see_path(self, points: Array) -> Array:
        """Take out what the first points and the flights between them see; see `see`.

        Parameters
        ----------
        points : (K + 1, B, 2) float32
            The ends of the flights, one after the other.
        """
        seen = self.see(points[0], points[0])
        for start, end in itertools.pairwise(points):
            seen = seen + self.see(start, end)
        return seen

    def see_in_arrays(self, start: Array, end: Array) -> Array:
        """Do what `see` does in array operations, for any device."""
        xp = array_namespace(start)
        rows, columns = self.levels[0].shape[1:]
        low = 0.5 * (start + end) - 0.5 * (self.window - BLOCK + 1)
        corner = xp.astype(xp.floor(low / BLOCK), xp.int64) * BLOCK
        x = xp.clip(corner[:, 0], 0, columns - self.window)[:, None] + self._side
        y = xp.clip(corner[:, 1], 0, rows - self.window)[:, None] + self._side
        covered = self._covered(xp, x, y, start, end)
        earlier = xp.where(xp.isnan(self.before), start, self.before)
        overlap = self._covered(xp, x, y, earlier, start)
        first = xp.isnan(self.before[:, :1, None])
        overlap = xp.where(first, 0.0, overlap)
        covered = xp.maximum(covered - overlap, 0.0) / xp.maximum(1.0 - overlap, 1e-6)
        self.before[...] = start
        where = (self._searches[:, None, None], y[:, :, None], x[:, None, :])
        before = self.levels[0][where]
        seen = xp.maximum(before, 0.0) * covered
        after = before - seen
        self.levels[0][where] = after
        for level in self.levels[1:]:
            after = _block_mean(xp, after)
            x, y = x[:, ::RATIO] // RATIO, y[:, ::RATIO] // RATIO
            level[self._searches[:, None, None], y[:, :, None], x[:, None, :]] = after
        return xp.sum(seen, axis=(1, 2))

    def _covered(self, xp: Any, x: Array, y: Array, start: Array, end: Array) -> Array:
        """Return the share of cells, (B, rows, columns), that the swath of a flight covers."""
        along = end - start
        length = xp.sum(along * along, axis=1)
        px = xp.astype(x, start.dtype) + 0.5 - start[:, :1]
        py = xp.astype(y, start.dtype) + 0.5 - start[:, 1:]
        scale = along / xp.maximum(length, 1e-12)[:, None]
        share = (px * scale[:, :1])[:, None, :] + (py * scale[:, 1:])[:, :, None]
        share = xp.minimum(xp.maximum(share, 0.0), 1.0)
        dx = px[:, None, :] - share * along[:, 0, None, None]
        dy = py[:, :, None] - share * along[:, 1, None, None]
        distance = xp.sqrt(dx * dx + dy * dy)
        return xp.minimum(xp.maximum(self.radius[:, None, None] - distance + 0.5, 0.0), 1.0)

    def nearest(self, points: Array) -> Array:
        """Return the unseen density of the cells that points, (B, ..., 2), lie in, (B, ...)."""
        xp = array_namespace(points)
        low = self._inside(xp, 0, xp.floor(points), 1)
        return self._values(xp, 0, low)

    def interpolated(self, level: int, points: Array) -> Array:
        """Return the unseen density at points, (B, ...), bilinear between the cells of a level.

        Parameters
        ----------
        level : int
            0 for the finest raster.
        points : (B, ..., 2) float32
            Positions; off the raster all is `OUTSIDE`.
        """
        xp = array_namespace(points)
        scaled = points * (1.0 / RATIO**level) - 0.5
        low = self._inside(xp, level, xp.floor(scaled), 2)
        share = xp.minimum(xp.maximum(scaled - low, 0.0), 1.0)
        x, y = share[..., 0], share[..., 1]
        columns = self.levels[level].shape[2]
        a, b, c, d = (self._values(xp, level, low, shift) for shift in (0, 1, columns, columns + 1))
        lower, upper = a + x * (b - a), c + x * (d - c)
        return lower + y * (upper - lower)

    def _inside(self, xp: Any, level: int, cells: Array, side: int) -> Array:
        """Move blocks of `side` x `side` cells, given by their lowest, onto the raster."""
        rows, columns = self.levels[level].shape[1:]
        most = xp.asarray([columns - side, rows - side], dtype=cells.dtype, device=device(cells))
        return xp.minimum(xp.maximum(cells, 0.0), most)

    def _values(self, xp: Any, level: int, cells: Array, shift: int = 0) -> Array:
        """Return the values of cells given by whole numbers, moved by a shift of the flat one."""
        raster = self.levels[level]
        rows, columns = raster.shape[1:]
        first = (self._searches * (rows * columns) + shift).reshape((-1, *(1,) * (cells.ndim - 2)))
        index = xp.astype(cells[..., 1] * columns + cells[..., 0], xp.int64)
        return raster.reshape((-1,))[index + first]


def in_main_memory(array: Array) -> bool:
    """Return whether compiled kernels can work on an array: NumPy's, or PyTorch's on the CPU."""
    return str(device(array)) == "cpu"


def margin(step: float, radius: float) -> int:
    """Return how many cells to leave between the search area and the raster's border.

    A swath fits in, and beyond it one cell of the coarsest raster, so that whatever lies off the
    raster has the value of its border.
    """
    return BLOCK + math.ceil(max(radius, 0.5 * step + radius - BLOCK)) + 2


def window_side(step: float, radius: float) -> int:
    """Return the side of a window that holds the largest step, a multiple of `BLOCK`, in cells."""
    return BLOCK * math.ceil((step + 2.0 * radius + 2.0 + BLOCK - 1.0) / BLOCK)


def _block_mean(xp: Any, raster: Array) -> Array:
    """Return the means of blocks of RATIO x RATIO cells."""
    count, rows, columns = raster.shape
    blocks = raster.reshape((count, rows // RATIO, RATIO, columns // RATIO, RATIO))
    return xp.mean(blocks, axis=(2, 4))
