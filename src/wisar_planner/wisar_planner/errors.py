"""The exception for user mistakes and the checks that raise it."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]


class InvalidInput(ValueError):  # noqa: N818 - reads as a statement about the argument
    """An argument that cannot be right.

    The message names the argument, says what is wrong with it and what to do.
    """


def finite_array(value: Any, name: str, shape: tuple[int | None, ...]) -> FloatArray:
    """Return `value` as a float64 array of the given shape with finite entries.

    Parameters
    ----------
    value : array_like
        What the caller was given.
    name : str
        Name of the argument, for the message.
    shape : tuple of int or None
        Required shape; None accepts any length in that axis.

    Raises
    ------
    InvalidInput
        When `value` is not numeric, has another shape, or holds NaN or infinity.
    """
    try:
        array = np.array(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InvalidInput(f"{name} must be an array of numbers ({error})") from None
    wanted = "(" + ", ".join("n" if n is None else str(n) for n in shape) + ")"
    if array.ndim != len(shape) or any(
        n is not None and n != m for n, m in zip(shape, array.shape, strict=True)
    ):
        raise InvalidInput(f"{name} must have the shape {wanted}, not {array.shape}")
    if not np.isfinite(array).all():
        where = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
        raise InvalidInput(
            f"{name} must be finite, but {name}{list(where)} is {array[where]}; "
            "remove or replace NaN and infinite values"
        )
    return array


def positive(value: Any, name: str) -> float:
    """Return `value` as a float that is finite and above 0.

    Raises
    ------
    InvalidInput
        When it is not.
    """
    try:
        number = float(value)
    except (TypeError, ValueError):
        raise InvalidInput(f"{name} must be a number, not {value!r}") from None
    if not (math.isfinite(number) and number > 0.0):
        raise InvalidInput(f"{name} must be a finite number above 0, not {number}")
    return number
