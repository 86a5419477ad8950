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


def swath_radius_at(altitude: float, field_of_view: float) -> float:
    """Return half the width in metres of the strip seen from a height; see `altitude_for_swath`."""
    half = _half_angle("field_of_view", field_of_view)
    return positive(altitude, "altitude") * math.tan(half)


def trigger_distance(altitude: float, field_of_view_along: float, overlap: float = 0.6) -> float:
    """Return the distance between two pictures.

    Parameters
    ----------
    altitude
        Height above ground in metres.
    field_of_view_along
        Angle of view along the direction of flight, radians.
    overlap
        Share of a picture that the next one shows again, 0 to below 1.

    Raises
    ------
    InvalidInput
        If an argument cannot be right.
    """
    if not 0.0 <= overlap < 1.0:
        raise InvalidInput(f"overlap must be from 0 to below 1, got {overlap}")
    return 2.0 * swath_radius_at(altitude, field_of_view_along) * (1.0 - overlap)
