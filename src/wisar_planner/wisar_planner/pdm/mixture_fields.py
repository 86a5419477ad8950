"""What the mixture files share: reading a field with a message that names it."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from shapely import Polygon, box

from wisar_planner.errors import InvalidInput
from wisar_planner.pdm.gaussian_mixture import GaussianMixture

DEFAULT_AREA_SIGMAS = 3.0
"""Half side of the search area around each component, where the file gives no area."""


def number(value: Any, where: str) -> float:
    """Read a finite number.

    Raises
    ------
    InvalidInput
        If it is missing, of another type, NaN or infinite.
    """
    # A bool is an int to Python, and a quoted number a mistake worth naming.
    if isinstance(value, int | float) and not isinstance(value, bool):
        result = as_float(value)
        if math.isfinite(result):
            return result
    raise InvalidInput(f"{where} {_what(value)}; give a finite number")


def as_float(value: int | float) -> float:
    """Return a number as a float; infinity for an integer that is too large for one."""
    try:
        return float(value)
    except OverflowError:
        return math.inf if value > 0 else -math.inf


def numbers(value: Any, count: int, where: str) -> list[float]:
    """Read a list of `count` finite numbers."""
    if not isinstance(value, list) or len(value) != count:
        raise InvalidInput(f"{where} {_what(value)}; give a list of {count} numbers")
    return [number(entry, f"{where}[{i}]") for i, entry in enumerate(value)]


def matrix(value: Any, where: str) -> list[list[float]]:
    """Read a 2 x 2 matrix, given as two rows."""
    if not isinstance(value, list) or len(value) != 2:
        raise InvalidInput(f"{where} {_what(value)}; give [[xx, xy], [xy, yy]] in square metres")
    return [numbers(row, 2, f"{where}[{i}]") for i, row in enumerate(value)]


def build_mixture(
    weights: list[float],
    means: Any,
    covariances: list[list[list[float]]],
    where: str,
) -> GaussianMixture:
    """Make the mixture, with the file's name in front of what it refuses."""
    total = sum(weights)  # infinite where it overflows, and so refused
    if weights and total > 0.0 and abs(total - 1.0) > 1e-6:
        # Not rescaled in silence: the usual cause is a component that was forgotten.
        raise InvalidInput(
            f"{where}: the weights sum to {total:.6g} and not to 1; "
            f"add the missing component or divide each weight by {total:.6g}"
        )
    try:
        return GaussianMixture(np.array(weights), np.array(means), np.array(covariances))
    except InvalidInput as error:
        raise InvalidInput(f"{where}: {error}") from None


def default_area(mixture: GaussianMixture) -> Polygon:
    """Return the rectangle that holds 3 standard deviations around every component."""
    reach = DEFAULT_AREA_SIGMAS * mixture.covariances.diagonal(axis1=1, axis2=2) ** 0.5
    low, high = (mixture.means - reach).min(axis=0), (mixture.means + reach).max(axis=0)
    return box(*low, *high)


def shown(value: Any) -> str:
    """Return a value as a message shows it, in one line's length."""
    try:
        text = repr(value)
    except ValueError:  # an integer of more digits than Python prints
        return "a number of thousands of digits"
    return text if len(text) <= 60 else f"{text[:57]}..."


def _what(value: Any) -> str:
    return "is missing" if value is None else f"is {shown(value)}"
