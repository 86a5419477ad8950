"""What a camera that looks straight down sees, over flat ground."""

from __future__ import annotations

import math

from wisar_planner.errors import InvalidInput, positive


def _half_angle(name: str, angle: float) -> float:
    if not (math.isfinite(angle) and 0.0 < angle < math.pi):
        raise InvalidInput(f"{name} must be between 0 and pi radians, got {angle}")
    return angle / 2.0


def altitude_for_swath(swath_radius: float, field_of_view: float) -> float:
    """Return the height at which the camera sees the wanted strip, no more and no less.

    Parameters
    ----------
    swath_radius
        Half the width of the strip in metres.
    field_of_view
        Angle of view across the direction of flight, radians.

    Returns
    -------
    float
        Height above ground in metres: ``swath_radius / tan(field_of_view / 2)``.

    Raises
    ------
    InvalidInput
        If an argument cannot be right.
    """
    half = _half_angle("field_of_view", field_of_view)
    return positive(swath_radius, "swath_radius") / math.tan(half)
