"""Gaussian mixtures as YAML: what a researcher writes by hand, in local metres.

    origin: {latitude: 56.78, longitude: -4.98, altitude: 0}    # altitude may be left out
    weights: [0.6, 0.4]
    means: [[40, 60], [110, 90]]                 # metres east and north of the origin
    covariances: [[[500, 0], [0, 500]], [[900, 200], [200, 400]]]    # square metres
    area: {rectangle: [0, 0, 150, 150]}          # xmin, ymin, xmax, ymax
    # or: area: {polygon: [[0, 0], [150, 0], [150, 150]]}

A polygon with holes is a list of rings, several polygons a list of these, as in GeoJSON. Without
an area, a rectangle of three standard deviations around the components is taken.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import shapely
import yaml
from shapely.geometry import shape

from wisar_planner.errors import InvalidInput
from wisar_planner.pdm.gaussian_mixture import GaussianMixture
from wisar_planner.pdm.geodesy import GeoOrigin
from wisar_planner.pdm.geojson import Area, checked_polygon, geometry_of
from wisar_planner.pdm.loaded_map import LoadedMap
from wisar_planner.pdm.mixture_fields import (
    build_mixture,
    default_area,
    matrix,
    number,
    numbers,
)
from wisar_planner.yaml_files import read_yaml

_FIELDS = ("origin", "weights", "means", "covariances", "area")


def load_yaml_mixture(path: Path) -> LoadedMap:
    """Read a mixture from YAML.

    Parameters
    ----------
    path : Path
        The file, as described above.

    Raises
    ------
    InvalidInput
        If the file is wrong; the message names the field.
    OSError
        If it cannot be read.
    """
    fields = _mapping(read_yaml(path), _FIELDS, f"{path}:")
    where = f"{path}: "
    origin = _origin(fields.get("origin"), f"{where}origin")
    weights = _list(fields.get("weights"), f"{where}weights")
    means = _list(fields.get("means"), f"{where}means")
    covariances = _list(fields.get("covariances"), f"{where}covariances")
    if not len(weights) == len(means) == len(covariances):
        raise InvalidInput(
            f"{where}weights, means and covariances must be equally long, "
            f"not {len(weights)}, {len(means)} and {len(covariances)}"
        )
    mixture = build_mixture(
        [number(v, f"{where}weights[{i}]") for i, v in enumerate(weights)],
        [numbers(v, 2, f"{where}means[{i}]") for i, v in enumerate(means)],
        [matrix(v, f"{where}covariances[{i}]") for i, v in enumerate(covariances)],
        str(path),
    )
    if fields.get("area") is None:
        note = "no area in the file: 3 standard deviations around the components"
        return LoadedMap(mixture, default_area(mixture), origin, str(path), (note,))
    area = _area(fields["area"], f"{where}area")
    return LoadedMap(mixture, area, origin, str(path))


def save_yaml_mixture(path: Path, mixture: GaussianMixture, area: Area, origin: GeoOrigin) -> None:
    """Write a mixture and its search area as YAML, in metres about `origin`."""
    document = {
        "origin": {
            "latitude": float(origin.latitude),
            "longitude": float(origin.longitude),
            "altitude": float(origin.altitude),
        },
        "weights": mixture.weights.tolist(),
        "means": mixture.means.tolist(),
        "covariances": mixture.covariances.tolist(),
        "area": {"polygon": geometry_of(area)["coordinates"]},
    }
    text = yaml.safe_dump(document, sort_keys=False, default_flow_style=None)
    path.write_text(text, encoding="utf-8")


def _mapping(value: Any, known: tuple[str, ...], where: str) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise InvalidInput(f"{where} must have the fields {', '.join(known)}")
    unknown = [str(name) for name in value if name not in known]
    if unknown:
        raise InvalidInput(f"{where} unknown field {unknown[0]!r}; known: {', '.join(known)}")
    return value


def _list(value: Any, where: str) -> list[Any]:
    if not isinstance(value, list) or not value:
        raise InvalidInput(f"{where} must be a list with one entry for each component")
    return value


def _origin(value: Any, where: str) -> GeoOrigin:
    if value is None:
        raise InvalidInput(f"{where} is missing; add origin: {{latitude: ..., longitude: ...}}")
    fields = _mapping(value, ("latitude", "longitude", "altitude"), where)
    latitude = number(fields.get("latitude"), f"{where}.latitude")
    longitude = number(fields.get("longitude"), f"{where}.longitude")
    altitude = number(fields.get("altitude", 0.0), f"{where}.altitude")
    try:
        return GeoOrigin(latitude, longitude, altitude)
    except InvalidInput as error:
        raise InvalidInput(f"{where}: {error}") from None


def _area(value: Any, where: str) -> Area:
    fields = _mapping(value, ("rectangle", "polygon"), where)
    if len(fields) != 1:
        raise InvalidInput(f"{where} must have one of rectangle and polygon")
    if "polygon" in fields:
        return _polygon(fields["polygon"], f"{where}.polygon")
    x0, y0, x1, y1 = numbers(fields["rectangle"], 4, f"{where}.rectangle")
    if not (x1 > x0 and y1 > y0):
        raise InvalidInput(f"{where}.rectangle must be [xmin, ymin, xmax, ymax] with an area")
    return shapely.box(x0, y0, x1, y1)


def _polygon(value: Any, where: str) -> Area:
    """Read corners, rings or polygons: the depth of the nesting tells which."""
    depth, inner = 0, value
    while isinstance(inner, list) and inner and depth <= 4:  # an alias may nest without end
        depth, inner = depth + 1, inner[0]
    geometries = {
        2: {"type": "Polygon", "coordinates": [value]},
        3: {"type": "Polygon", "coordinates": value},
        4: {"type": "MultiPolygon", "coordinates": value},
    }
    if depth not in geometries:
        raise InvalidInput(f"{where} must be corners [[x, y], ...] in metres")
    try:
        polygon = shape(geometries[depth])
        finite = bool(np.isfinite(shapely.get_coordinates(polygon)).all())
    except (
        TypeError, ValueError, OverflowError, IndexError, shapely.errors.ShapelyError
    ) as error:  # fmt: skip
        raise InvalidInput(f"{where} must be corners [[x, y], ...] in metres ({error})") from None
    if not finite:
        raise InvalidInput(f"{where} must have finite corners")
    return checked_polygon(polygon, where)
