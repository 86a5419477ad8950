"""Compiled kernel of the local hill climb."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from numba import njit

from wisar_planner.errors import FloatArray


@njit(cache=True, nogil=True)
def climb(
    cells: FloatArray,
    moves: npt.NDArray[np.bool_],
    row: int,
    column: int,
    budget: float,
    warming: float,
    kernel: int,
) -> tuple[FloatArray, float]:
    """Climb one map that is lowered by a constant.

    Parameters
    ----------
    cells : (rows, columns) float64
        Probability per cell of the original map.
    moves : (rows, columns, 3, 3) bool
        Which of the neighbours, rows and columns from -1 to 1, each cell may be left for.
    row, column : int
        Cell to start from.
    budget : float
        Distance to fly, in cells; a diagonal move costs sqrt(2).
    warming : float
        What is taken from every cell; cells do not fall below 0.
    kernel : int
        Side of the box, in cells, whose mass breaks ties.

    Returns
    -------
    path : (N, 2) float64
        Row and column of each cell flown over; the last move may pass the budget.
    score : float
        Probability collected on the original map.
    """
    rows, columns = cells.shape
    lowered = np.maximum(cells - warming, 0.0)
    visits = np.zeros((rows, columns), np.int64)
    capacity = int(budget) + 2
    path = np.empty((capacity, 2))
    path[0] = row, column
    count = 1
    score = cells[row, column]
    lowered[row, column] = 0.0
    visits[row, column] = 1
    last_row, last_column = -1, -1
    half = kernel // 2
    flown = 0.0
    while flown < budget:
        # Unvisited cells first; the cell just left only where there is no other way.
        best_rank, best_value, best_mass = 3, -1.0, -1.0
        next_row, next_column = -1, -1
        for dr in range(-1, 2):
            for dc in range(-1, 2):
                r, c = row + dr, column + dc
                if (dr == 0 and dc == 0) or r < 0 or c < 0 or r >= rows or c >= columns:
                    continue
                if not moves[row, column, dr + 1, dc + 1]:
                    continue
                rank = 0
                if r == last_row and c == last_column:
                    rank = 2
                elif visits[r, c] > 0:
                    rank = 1
                value = lowered[r, c]
                if rank > best_rank or (rank == best_rank and value < best_value):
                    continue
                better = rank < best_rank or value > best_value
                mass = -1.0
                if not better:
                    if best_mass < 0.0:
                        best_mass = _box_mass(lowered, next_row, next_column, half)
                    mass = _box_mass(lowered, r, c, half)
                    # Where even the box ties, as in a flooded plain, the least visited cell wins.
                    better = mass > best_mass or (
                        mass == best_mass and visits[r, c] < visits[next_row, next_column]
                    )
                if better:
                    best_rank, best_value, best_mass = rank, value, mass
                    next_row, next_column = r, c
        if next_row < 0:
            break
        flown += math.sqrt(2.0) if next_row != row and next_column != column else 1.0
        last_row, last_column = row, column
        row, column = next_row, next_column
        path[count] = row, column
        count += 1
        lowered[row, column] = 0.0
        if visits[row, column] == 0 and flown <= budget:
            score += cells[row, column]
        visits[row, column] += 1
    return path[:count], score


@njit(cache=True, nogil=True)
def _box_mass(cells: FloatArray, row: int, column: int, half: int) -> float:
    """Return the sum of the box of cells around one; beyond the map there is nothing."""
    mass = 0.0
    for r in range(max(0, row - half), min(cells.shape[0], row + half + 1)):
        for c in range(max(0, column - half), min(cells.shape[1], column + half + 1)):
            mass += cells[r, c]
    return mass
