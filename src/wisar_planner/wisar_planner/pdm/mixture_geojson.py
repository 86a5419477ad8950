"""Gaussian mixtures as GeoJSON: what an analyst draws in a GIS, point by point.

A FeatureCollection in WGS84 degrees (RFC 7946). Each Point feature is one component, its position
the mean; its properties are ``weight`` and one of

- ``covariance_m2``: ``[[xx, xy], [xy, yy]]``, square metres, east and north;
- ``sigma_m``: one standard deviation in every direction;
- ``semi_major_m``, ``semi_minor_m``, ``bearing_deg``: the one-sigma ellipse and the bearing of
  its long axis, degrees clockwise from north.

Polygon features with the property ``role: search_area`` are the search area, in its absence a
rectangle of three standard deviations around the components. The role ``keep_out`` is refused.
The property ``kind`` stands for ``role`` where there is none.
The foreign member ``origin``, ``[longitude, latitude]`` with an optional altitude, is where the
local metres are measured from; without it, the middle of the points.
"""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from wisar_planner.errors import InvalidInput
from wisar_planner.pdm.gaussian_mixture import GaussianMixture
from wisar_planner.pdm.geodesy import GeoOrigin, LocalFrame
from wisar_planner.pdm.geojson import (
    SEARCH_AREA,
    Area,
    features_of,
    polygon_from_geometry,
    polygon_to_geometry,
    polygons_in,
    position,
    read_geojson,
    role_of,
    union_of,
    wrapped_degrees,
)
from wisar_planner.pdm.loaded_map import LoadedMap
from wisar_planner.pdm.mixture_fields import build_mixture, default_area, matrix, number

_SPREADS = "covariance_m2, or sigma_m, or semi_major_m with semi_minor_m and bearing_deg"


def load_geojson_mixture(path: Path, origin: GeoOrigin | None = None) -> LoadedMap:
    """Read a mixture from GeoJSON.

    Parameters
    ----------
    path : Path
        The file, as described above.
    origin : GeoOrigin, optional
        Where to measure local metres from, instead of what the file says.

    Raises
    ------
    InvalidInput
        If the file is wrong; the message names the feature and the property.
    OSError
        If it cannot be read.
    """
    document = read_geojson(path)
    weights, places, covariances, polygons = [], [], [], []
    for i, feature in enumerate(features_of(document, str(path))):
        where = f"{path}: features[{i}]"
        geometry, properties = feature["geometry"], feature["properties"] or {}
        role = role_of(feature, where)
        if geometry.get("type") == "Point":
            weights.append(number(properties.get("weight"), f"{where}.properties.weight"))
            covariances.append(_covariance(properties, f"{where}.properties"))
            places.append(position(geometry.get("coordinates"), f"{where}.geometry.coordinates"))
        elif role == SEARCH_AREA:
            found = list(polygons_in(geometry, f"{where}.geometry"))
            # What is no polygon is refused where it is projected.
            polygons.extend(found or [(geometry, f"{where}.geometry")])
        else:
            raise InvalidInput(
                f"{where} is a {geometry.get('type')} with role {role!r}; a component is a Point "
                "with a weight, the search area a Polygon with role 'search_area'"
            )
    if not places:
        raise InvalidInput(f"{path}: no Point with a weight; a mixture needs a component")

    latitudes, longitudes = np.array(places).T
    origin = origin or _origin(document, latitudes, longitudes, str(path))
    frame = LocalFrame(origin)
    mixture = build_mixture(weights, frame.to_local(latitudes, longitudes), covariances, str(path))
    if polygons:
        parts = [polygon_from_geometry(geometry, frame, where) for geometry, where in polygons]
        return LoadedMap(mixture, union_of(parts, f"{path}: the search area"), origin, str(path))
    note = "no search_area in the file: 3 standard deviations around the components"
    return LoadedMap(mixture, default_area(mixture), origin, str(path), (note,))


def save_geojson_mixture(
    path: Path, mixture: GaussianMixture, area: Area, origin: GeoOrigin
) -> None:
    """Write a mixture and its search area as GeoJSON.

    Parameters
    ----------
    path : Path
        The file to write.
    mixture : GaussianMixture
        In metres about `origin`.
    area : shapely.Polygon or shapely.MultiPolygon
        The search area in the same metres.
    origin : GeoOrigin
        Where (0, 0) is.
    """
    frame = LocalFrame(origin)
    components = [
        {
            "type": "Feature",
            "geometry": {"type": "Point", "coordinates": [longitude, latitude]},
            "properties": {"weight": weight, "covariance_m2": covariance},
        }
        for (latitude, longitude), weight, covariance in zip(
            frame.to_geodetic(mixture.means).tolist(),
            mixture.weights.tolist(),
            mixture.covariances.tolist(),
            strict=True,
        )
    ]
    search_area = {
        "type": "Feature",
        "geometry": polygon_to_geometry(area, frame),
        "properties": {"role": SEARCH_AREA},
    }
    document = {
        "type": "FeatureCollection",
        "origin": [origin.longitude, origin.latitude, origin.altitude],
        "features": [search_area, *components],
    }
    path.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")


def _covariance(properties: dict[str, Any], where: str) -> list[list[float]]:
    given = [name for name in ("covariance_m2", "sigma_m", "semi_major_m") if name in properties]
    if len(given) != 1:
        raise InvalidInput(f"{where}: give exactly one of {_SPREADS}, not {given or 'none'}")
    if given == ["covariance_m2"]:
        return matrix(properties["covariance_m2"], f"{where}.covariance_m2")
    if given == ["sigma_m"]:
        variance = _square(properties, "sigma_m", where)
        return [[variance, 0.0], [0.0, variance]]
    major = _square(properties, "semi_major_m", where)
    minor = _square(properties, "semi_minor_m", where)
    bearing = math.radians(number(properties.get("bearing_deg"), f"{where}.bearing_deg"))
    sin, cos = math.sin(bearing), math.cos(bearing)
    xy = (major - minor) * sin * cos
    return [
        [major * sin**2 + minor * cos**2, xy],
        [xy, major * cos**2 + minor * sin**2],
    ]


def _square(properties: dict[str, Any], name: str, where: str) -> float:
    """Read a length and return its square; infinite, and so refused later, if that overflows."""
    value = number(properties.get(name), f"{where}.{name}")
    if value <= 0.0:
        raise InvalidInput(f"{where}.{name} is {value:g}; give a length above 0 in metres")
    return value * value


def _origin(document: dict[str, Any], latitudes: Any, longitudes: Any, where: str) -> GeoOrigin:
    given = document.get("origin")
    if given is not None:
        latitude, longitude = position(given, f"{where}: origin")
        altitude = number(given[2], f"{where}: origin[2]") if len(given) == 3 else 0.0
        return GeoOrigin(latitude, longitude, altitude)
    # Differences from the first point, wrapped, so that a group astride 180 degrees has a middle.
    east = wrapped_degrees(longitudes - longitudes[0])
    longitude = float(wrapped_degrees(longitudes[0] + east.mean()))
    return GeoOrigin(float(latitudes.mean()), longitude)
