"""Between latitude and longitude and local metres; the only module that knows pyproj.

Everything inside the suite is planar, in metres, east-north. A local frame is the azimuthal
equidistant projection of the WGS84 ellipsoid about an origin: distances and directions from the
origin are exact, and at 10 km from it a length is off by less than one part in a million, far
below what a drone or a probability map resolves.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pyproj
from numpy.typing import ArrayLike, NDArray
from pyproj.exceptions import ProjError

from wisar_planner.errors import InvalidInput

__all__ = ["MAX_RADIUS", "GeoOrigin", "LocalFrame", "origin_at"]

MAX_RADIUS = 500_000.0
"""Metres from the origin within which lengths in the local frame are true to a thousandth."""

_HALF_ROUND = 20_003_931.0  # metres from pole to pole: nothing lies farther away


@dataclass(frozen=True)
class GeoOrigin:
    """A point on WGS84 at which a local frame stands.

    Parameters
    ----------
    latitude : float
        Degrees north, from -90 to 90.
    longitude : float
        Degrees east, from -180 to 180.
    altitude : float
        Metres above the ellipsoid or the sea, as the source of the map means it; the planar
        frame does not use it.

    Raises
    ------
    InvalidInput
        If a value is not finite or out of range.
    """

    latitude: float
    longitude: float
    altitude: float = 0.0

    def __post_init__(self) -> None:
        _check_degrees("latitude", self.latitude, 90.0)
        _check_degrees("longitude", self.longitude, 180.0)
        if not math.isfinite(self.altitude):
            raise InvalidInput(f"altitude must be a finite number of metres, not {self.altitude}")


@dataclass(frozen=True)
class LocalFrame:
    """East and north in metres about an origin, to and from latitude and longitude.

    Parameters
    ----------
    origin : GeoOrigin
        The point that becomes (0, 0).
    """

    origin: GeoOrigin

    @cached_property
    def crs(self) -> str:
        """The frame as a PROJ string, as GIS programs take it for a coordinate system."""
        # repr keeps every digit of a float, so that the string names the same frame.
        return (
            f"+proj=aeqd +lat_0={float(self.origin.latitude)!r} "
            f"+lon_0={float(self.origin.longitude)!r} +datum=WGS84 +units=m +no_defs"
        )

    @cached_property
    def _projection(self) -> pyproj.Proj:
        # Both sides are on WGS84, so the bare projection does; a Transformer takes far longer to
        # make.
        return pyproj.Proj(self.crs)

    def to_local(self, latitude: ArrayLike, longitude: ArrayLike) -> NDArray[np.float64]:
        """Project geodetic coordinates.

        Parameters
        ----------
        latitude, longitude : array_like, shape (N,)
            WGS84 degrees; scalars count as N = 1.

        Returns
        -------
        numpy.ndarray, shape (N, 2)
            East and north of the origin in metres.

        Raises
        ------
        InvalidInput
            If the lengths differ, or a value is not finite or out of range.
        """
        lat = np.atleast_1d(np.asarray(latitude, dtype=float))
        lon = np.atleast_1d(np.asarray(longitude, dtype=float))
        if lat.ndim != 1 or lat.shape != lon.shape:
            raise InvalidInput(
                "latitude and longitude must be one-dimensional and equally long, "
                f"not of shapes {lat.shape} and {lon.shape}"
            )
        _check_degrees("latitude", lat, 90.0)
        _check_degrees("longitude", lon, 180.0)
        east, north = self._projection(lon, lat)
        return np.column_stack((east, north))

    def project(self, crs: str, x: ArrayLike, y: ArrayLike) -> NDArray[np.float64]:
        """Project coordinates of any coordinate reference system.

        Parameters
        ----------
        crs : str
            What they are in: an authority code such as ``EPSG:27700``, WKT or a PROJ string.
        x, y : array_like, shape (N,)
            Easting and northing, or longitude and latitude, in this order whatever the axes of
            the system.

        Returns
        -------
        numpy.ndarray, shape (N, 2)
            East and north of the origin in metres.

        Raises
        ------
        InvalidInput
            If the system is unknown or bound to no place on Earth, or a point lies outside it.
        """
        return _transformed(crs, self.crs, x, y)

    def to_geodetic(self, points: ArrayLike) -> NDArray[np.float64]:
        """Give latitude and longitude of local points.

        Parameters
        ----------
        points : array_like, shape (N, 2)
            East and north in metres; one pair counts as N = 1.

        Returns
        -------
        numpy.ndarray, shape (N, 2)
            Latitude and longitude in WGS84 degrees.

        Raises
        ------
        InvalidInput
            If the shape is wrong, or a value is not finite or farther from the origin than any
            place on Earth.
        """
        local = np.atleast_2d(np.asarray(points, dtype=float))
        if local.ndim != 2 or (local.size and local.shape[1] != 2):
            raise InvalidInput(f"points must have shape (N, 2), not {np.shape(points)}")
        if not np.isfinite(local).all():
            raise InvalidInput("points must be finite metres east and north of the origin")
        local = local.reshape(-1, 2)
        if (np.hypot(*local.T) > _HALF_ROUND).any():
            raise InvalidInput("points must be metres near the origin; some lie beyond the Earth")
        lon, lat = self._projection(local[:, 0], local[:, 1], inverse=True)
        return np.column_stack((lat, lon))


def origin_at(crs: str, x: float, y: float) -> GeoOrigin:
    """Return the place of a point of any coordinate reference system; see `LocalFrame.project`."""
    ((longitude, latitude),) = _transformed(crs, "EPSG:4326", [x], [y])
    return GeoOrigin(float(latitude), float((longitude + 180.0) % 360.0 - 180.0))


def _transformed(source: str, target: str, x: ArrayLike, y: ArrayLike) -> NDArray[np.float64]:
    try:
        # Without a datum PROJ would guess, and be wrong by up to hundreds of metres.
        transformer = pyproj.Transformer.from_crs(
            source, target, always_xy=True, allow_ballpark=False
        )
    except ProjError as error:
        raise InvalidInput(
            f"crs cannot be brought to WGS84 ({error}); if it names no datum, give the one that it "
            "was made in: gdal_edit.py -a_srs EPSG:... FILE"
        ) from None
    points = np.column_stack(transformer.transform(x, y))
    if not np.isfinite(points).all():
        raise InvalidInput("x and y must lie within the range of their projection")
    return points


def _check_degrees(name: str, value: ArrayLike, limit: float) -> None:
    """Refuse what is not finite or beyond plus or minus ``limit`` degrees."""
    degrees = np.atleast_1d(np.asarray(value, dtype=float))
    wrong = degrees[~(np.abs(degrees) <= limit)]  # so written, NaN is wrong too
    if wrong.size:
        raise InvalidInput(
            f"{name} must lie between -{limit:g} and {limit:g} degrees, not {wrong[0]:g}"
        )
