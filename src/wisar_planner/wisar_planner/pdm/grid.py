"""A regular grid of square cells over the ground."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from wisar_planner.errors import FloatArray, InvalidInput, positive


@dataclass(frozen=True)
class Grid:
    """Square cells in local metres; row 0 is the southernmost, column 0 the westernmost.

    Parameters
    ----------
    x0, y0 : float
        Lower-left (south-west) corner, m.
    cell : float
        Side of a cell, m.
    columns, rows : int
        Number of cells to the east and to the north, each at least 1.

    Raises
    ------
    InvalidInput
        When a value is not finite, or `cell`, `columns` or `rows` is not positive.
    """

    x0: float
    y0: float
    cell: float
    columns: int
    rows: int

    def __post_init__(self) -> None:
        positive(self.cell, "cell")
        for name in ("x0", "y0"):
            if not math.isfinite(getattr(self, name)):
                raise InvalidInput(f"{name} must be finite, not {getattr(self, name)}")
        for name in ("columns", "rows"):
            count = getattr(self, name)
            if int(count) != count or count < 1:
                raise InvalidInput(f"{name} must be a whole number of at least 1, not {count}")

    @classmethod
    def covering(cls, bounds: tuple[float, float, float, float], cell: float) -> Grid:
        """Return the smallest grid from the lower-left corner of `bounds` that covers them.

        Parameters
        ----------
        bounds : (xmin, ymin, xmax, ymax)
            Rectangle to cover, m.
        cell : float
            Side of a cell, m.
        """
        xmin, ymin, xmax, ymax = (float(b) for b in bounds)
        cell = positive(cell, "cell")
        if not (xmax >= xmin and ymax >= ymin and math.isfinite(xmax - xmin + ymax - ymin)):
            raise InvalidInput(f"bounds must be finite and ordered, not {bounds}")
        # A hair less than the exact quotient, lest rounding adds an empty column.
        columns = max(1, math.ceil((xmax - xmin) / cell - 1e-9))
        rows = max(1, math.ceil((ymax - ymin) / cell - 1e-9))
        return cls(xmin, ymin, cell, columns, rows)

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """(xmin, ymin, xmax, ymax) in metres."""
        return (
            self.x0,
            self.y0,
            self.x0 + self.columns * self.cell,
            self.y0 + self.rows * self.cell,
        )

    @property
    def x_edges(self) -> FloatArray:
        """Borders between columns, (columns + 1,), m."""
        return self.x0 + self.cell * np.arange(self.columns + 1, dtype=np.float64)

    @property
    def y_edges(self) -> FloatArray:
        """Borders between rows, (rows + 1,), m."""
        return self.y0 + self.cell * np.arange(self.rows + 1, dtype=np.float64)

    def centres(self) -> FloatArray:
        """Centres of the cells, (rows, columns, 2), m."""
        x = self.x0 + self.cell * (np.arange(self.columns) + 0.5)
        y = self.y0 + self.cell * (np.arange(self.rows) + 0.5)
        return np.stack(np.broadcast_arrays(x[None, :], y[:, None]), axis=-1)
