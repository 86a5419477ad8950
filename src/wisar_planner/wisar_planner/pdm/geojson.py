"""GeoJSON (RFC 7946) documents, and polygons between them and local metres.

RFC 7946 knows one coordinate reference system, WGS84 longitude and latitude in degrees, in this
order. Documents of the 2008 draft that name another in a ``crs`` member are refused.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NoReturn, TypeAlias

import numpy as np
import shapely
from shapely import MultiPolygon, Polygon
from shapely.geometry import mapping
from shapely.geometry.polygon import orient

from wisar_planner.errors import FloatArray, InvalidInput
from wisar_planner.pdm.geodesy import LocalFrame
from wisar_planner.pdm.mixture_fields import as_float, shown
from wisar_planner.pdm.protocol import IntArray

Area: TypeAlias = Polygon | MultiPolygon

SEARCH_AREA = "search_area"
"""Role of the polygons to search."""

# What nobody calls ground that may be flown over.
_NO_FLYING = (
    r"keep.?out(?!look)|stay.?out|no.?(over.?)?fl(y|ight)|do.?n[o\W]?.?t.?(over)?.?fly|nfz|"
    r"tfr(?![a-z])|no.?drones?(?![a-z])|do.?not.?enter|off.?limits"
)
# In whatever words: keep-out, no fly zone, nogo, exclusion zone, prohibited, restricted and danger
# areas (ICAO's kinds), ... Only from the beginning of a word: not "unrestricted", "volcano gorge".
_FORBIDDEN = re.compile(
    rf"(?<![a-z])({_NO_FLYING}|no.?go(zone)?(?![a-z])|no.?entry|exclu|restrict|prohibit|forbid|"
    r"danger|hazard|avoid|not.?allowed|closed|military)",
    re.IGNORECASE,
)
# A name may be that of a place: Danger Hill is searched, "No-fly zone" is not.
_FORBIDDEN_NAME = re.compile(
    rf"(?<![a-z])({_NO_FLYING}|(prohibited|restricted|danger).?(area|airspace)|exclusion.?zone)",
    re.IGNORECASE,
)

# What an edge that is straight in degrees may be bent in metres, m: less than a vehicle's position
# is known to. Parts of an area that are nearer than twice this are one.
_BEND = 0.25
# Most pieces that an edge is cut into for it.
_MOST_PIECES = 1000

_MOST_NAMED = 5  # polygons left out that are named one by one

_WGS84_NAMES = ("CRS84", "EPSG::4326", "EPSG:4326")


def read_geojson(path: Path) -> dict[str, Any]:
    """Parse a GeoJSON file.

    Raises
    ------
    InvalidInput
        If it is not a JSON object, holds NaN or infinity, or names a CRS other than WGS84.
    OSError
        If it cannot be read.
    """

    def refuse(constant: str) -> NoReturn:
        raise ValueError(f"{constant} is not a JSON number")

    try:
        # Some programs put a byte order mark in front, which RFC 8259 lets a reader ignore.
        document = json.loads(path.read_text(encoding="utf-8-sig"), parse_constant=refuse)
    except (ValueError, RecursionError) as error:
        raise InvalidInput(f"{path}: not valid JSON ({error}); export it again") from None
    if not isinstance(document, dict) or not isinstance(document.get("type"), str):
        raise InvalidInput(f"{path}: not GeoJSON (no object with a 'type'); export it as GeoJSON")
    crs = document.get("crs")
    if crs is not None and not any(name in json.dumps(crs) for name in _WGS84_NAMES):
        raise InvalidInput(
            f"{path}: crs is {json.dumps(crs)}, but GeoJSON is in WGS84 degrees (RFC 7946); "
            f"convert it: ogr2ogr -t_srs EPSG:4326 -lco RFC7946=YES wgs84.geojson {path.name}"
        )
    return document


def features_of(document: dict[str, Any], where: str) -> list[dict[str, Any]]:
    """Return the features of a FeatureCollection or Feature; a bare geometry becomes a feature.

    Raises
    ------
    InvalidInput
        If a feature is not an object with an object as its geometry.
    """
    if document["type"] == "FeatureCollection":
        features = document.get("features")
    elif document["type"] == "Feature":
        features = [document]
    else:
        features = [{"type": "Feature", "geometry": document, "properties": {}}]
    if not isinstance(features, list):
        raise InvalidInput(f"{where}: features must be a list of GeoJSON features")
    for i, feature in enumerate(features):
        if not (isinstance(feature, dict) and isinstance(feature.get("geometry"), dict)):
            raise InvalidInput(f"{where}: features[{i}] must be a feature with a geometry")
        if not isinstance(feature.setdefault("properties", {}) or {}, dict):
            raise InvalidInput(f"{where}: features[{i}].properties must be an object")
    return features


def role_of(feature: dict[str, Any], where: str) -> str | None:
    """Return what a feature says it is for: its property ``role`` or, without one, ``kind``.

    Raises
    ------
    InvalidInput
        If either, or its name, says that it is a zone that must not be flown over.
    """
    properties = feature["properties"] or {}
    given = [properties.get(name) for name in ("role", "kind")]
    texts = [text for text in given if isinstance(text, str)]
    name = properties.get("name")
    named = isinstance(name, str) and _FORBIDDEN_NAME.search(name)
    if named or any(_FORBIDDEN.search(text) for text in texts):
        # To ignore it would be to fly where someone forbade it.
        raise InvalidInput(
            f"{where}: keep_out zones are not supported; "
            "cut the zone out of the search_area polygon (a hole) and remove the feature"
        )
    return "_".join(re.split(r"[\s_-]+", texts[0].lower())) if texts else None


def polygons_in(geometry: dict[str, Any], where: str) -> Iterator[tuple[dict[str, Any], str]]:
    """Yield each Polygon and MultiPolygon geometry, those in collections too, and its place.

    Raises
    ------
    InvalidInput
        If a GeometryCollection is malformed or nested too deeply.
    """
    kind = geometry.get("type")
    if kind in ("Polygon", "MultiPolygon"):
        yield geometry, where
    elif kind == "GeometryCollection":
        members = geometry.get("geometries")
        if not isinstance(members, list) or not all(isinstance(m, dict) for m in members):
            raise InvalidInput(f"{where}.geometries must be a list of geometries")
        for i, member in enumerate(members):
            if member.get("type") == "GeometryCollection":
                # RFC 7946 advises against it, and no GIS writes it.
                raise InvalidInput(f"{where}.geometries[{i}] is a collection in a collection")
            yield from polygons_in(member, f"{where}.geometries[{i}]")


def position(value: Any, where: str) -> tuple[float, float]:
    """Read a GeoJSON position as (latitude, longitude) in degrees; an altitude is dropped.

    Raises
    ------
    InvalidInput
        If it is not two or three numbers within the range of degrees.
    """
    numbers = isinstance(value, list) and all(
        isinstance(v, int | float) and not isinstance(v, bool) for v in value
    )
    if not numbers or len(value) not in (2, 3):
        raise InvalidInput(f"{where} must be [longitude, latitude] in degrees, not {shown(value)}")
    longitude, latitude = as_float(value[0]), as_float(value[1])
    if not (abs(longitude) <= 180.0 and abs(latitude) <= 90.0):
        raise InvalidInput(
            f"{where} is {shown(value)}, which is no [longitude, latitude] in degrees; "
            "check the order, and that the file is in WGS84 and not in metres"
        )
    return latitude, longitude


def polygon_from_geometry(geometry: dict[str, Any], frame: LocalFrame, where: str) -> Area:
    """Project a GeoJSON Polygon or MultiPolygon into a local frame.

    Its edges are straight in degrees (RFC 7946, 3.1.1); where they are curved in metres they get
    points between. Parts that touch, as where the antimeridian cuts a polygon, become one.

    Raises
    ------
    InvalidInput
        If the geometry is of another type, or is no valid polygon with an area.
    """
    kind, coordinates = geometry.get("type"), geometry.get("coordinates")
    if kind not in ("Polygon", "MultiPolygon"):
        raise InvalidInput(f"{where}.type must be Polygon or MultiPolygon, not {kind!r}")
    parts = [coordinates] if kind == "Polygon" else coordinates
    if not isinstance(parts, list) or not parts:
        raise InvalidInput(f"{where}.coordinates must hold at least one polygon")
    polygons = []
    for part in parts:
        if not isinstance(part, list) or not part:
            raise InvalidInput(f"{where}.coordinates must be lists of rings")
        rings = [_local_ring(ring, frame, f"{where}.coordinates") for ring in part]
        polygons.append(checked_polygon(Polygon(rings[0], rings[1:]), where))
    return union_of(polygons, where)


def checked_polygon(polygon: Any, where: str) -> Area:
    """Return a polygon as it is.

    Raises
    ------
    InvalidInput
        If it is not a valid polygon or multipolygon with an area.
    """
    if not isinstance(polygon, Polygon | MultiPolygon) or polygon.is_empty:
        raise InvalidInput(f"{where} must be a polygon with an area")
    if not polygon.is_valid:
        raise InvalidInput(
            f"{where} is no valid polygon ({shapely.is_valid_reason(polygon)}, in local metres); "
            "repair it, for instance with 'Fix geometries' of QGIS"
        )
    if not polygon.area > 0.0:
        raise InvalidInput(f"{where} must be a polygon with an area, not a line or a point")
    return polygon


def polygon_to_geometry(polygon: Area, frame: LocalFrame) -> dict[str, Any]:
    """Return a polygon of a local frame as a GeoJSON geometry, wound as RFC 7946 wants it."""
    parts = [orient(part) for part in getattr(polygon, "geoms", [polygon])]
    wound = parts[0] if len(parts) == 1 else MultiPolygon(parts)
    return geometry_of(shapely.transform(wound, lambda points: frame.to_geodetic(points)[:, ::-1]))


def geometry_of(polygon: Area) -> dict[str, Any]:
    """Return a polygon as a GeoJSON geometry, coordinates as they are, in lists."""
    geometry: dict[str, Any] = json.loads(json.dumps(mapping(polygon)))  # tuples become lists
    return geometry


def union_of(polygons: Sequence[Area], where: str) -> Area:
    """Return the union of polygons, which must have an area; hairlines between them are closed.

    Where parts share a border but not its vertices, rounding leaves a gap. Nobody meant it, and no
    planner would cross it.
    """
    union = checked_polygon(shapely.union_all(list(polygons)), where)
    closed = union.buffer(_BEND, join_style="mitre").buffer(-_BEND, join_style="mitre")
    # Holes that somebody drew stay, however small: something may stand there.
    drawn = [Polygon(ring) for part in shapely.get_parts(polygons) for ring in part.interiors]
    joined = shapely.difference(closed, shapely.difference(shapely.union_all(drawn), union))
    # Where nothing is joined it stays as it was drawn, to the last digit.
    return checked_polygon(joined, where) if _rings(joined) < _rings(union) else union


def _rings(area: Area) -> int:
    return int(shapely.get_num_interior_rings(shapely.get_parts(area)).sum()) + len(
        shapely.get_parts(area)
    )


def load_area(path: Path, frame: LocalFrame) -> tuple[Area, tuple[str, ...]]:
    """Read a search area: the polygons of a GeoJSON file, joined.

    If any feature has the role ``search_area``, these features alone; every polygon otherwise.

    Parameters
    ----------
    path : Path
        GeoJSON geometry, Feature or FeatureCollection, in WGS84 degrees (RFC 7946).
    frame : LocalFrame
        Where the result's metres are measured.

    Returns
    -------
    area : shapely.Polygon or shapely.MultiPolygon
        The search area in local metres.
    notes : tuple of str
        Which polygons are left out, for the operator.

    Raises
    ------
    InvalidInput
        If the file is wrong, has no polygon, or has a zone that must not be flown over or a
        polygon with another role.
    OSError
        If it cannot be read.
    """
    marked, found, others = [], [], []
    for i, feature in enumerate(features_of(read_geojson(path), str(path))):
        where = f"{path}: features[{i}]"
        polygons = list(polygons_in(feature["geometry"], f"{where}.geometry"))
        if role_of(feature, where) == SEARCH_AREA:
            # What is no polygon is refused there: a search area must not shrink in silence.
            marked.extend(polygons or [(feature["geometry"], f"{where}.geometry")])
        elif polygons and (role := (feature["properties"] or {}).get("role")) not in (None, ""):
            # It may be a ban in words that this code does not know.
            raise InvalidInput(
                f"{where}: a polygon with the role {shown(role)} is neither searched nor kept out "
                f"of; give it the role {SEARCH_AREA}, or cut it out of the {SEARCH_AREA} polygon "
                "(a hole) and remove the feature"
            )
        elif polygons:
            name = (feature["properties"] or {}).get("name")
            others.append(f"features[{i}]" + ("" if name is None else f" ({shown(name)})"))
        found.extend(polygons)
    chosen = marked or found
    if not chosen:
        raise InvalidInput(f"{path}: no Polygon in it; draw the search area as a polygon")
    parts = [polygon_from_geometry(geometry, frame, where) for geometry, where in chosen]
    area = union_of(parts, f"{path}: the area")
    if not (marked and others):
        return area, ()
    named = ", ".join(others[:_MOST_NAMED]) + (", ..." if len(others) > _MOST_NAMED else "")
    return area, (
        f"{path}: {len(others)} polygons without the role {SEARCH_AREA} are left out: {named}",
    )


def _local_ring(ring: Any, frame: LocalFrame, where: str) -> FloatArray:
    """Return a ring of GeoJSON positions in local metres, with points between on curved edges."""
    if not isinstance(ring, list) or len(ring) < 4:
        raise InvalidInput(f"{where} must be closed rings of at least four positions")
    places = np.array([position(value, f"{where}[{i}]") for i, value in enumerate(ring)])
    corners = frame.to_local(*places.T)
    along = np.diff(places, axis=0)
    along[:, 1] = wrapped_degrees(along[:, 1])  # the short way, as over the antimeridian

    def between(edges: IntArray, share: FloatArray) -> FloatArray:
        latitude, longitude = (places[edges] + share[:, None] * along[edges]).T
        return frame.to_local(latitude, wrapped_degrees(longitude))

    edges = np.arange(len(along))
    middle = between(edges, np.full(len(edges), 0.5))
    bend = np.hypot(*(middle - 0.5 * (corners[:-1] + corners[1:])).T)
    # A piece of 1/n of an edge is bent by 1/n^2 of it.
    needed = np.sqrt(np.nan_to_num(bend, posinf=0.0) / _BEND)
    pieces = np.clip(np.ceil(needed), 1, _MOST_PIECES).astype(np.int64)
    first = np.cumsum(pieces) - pieces
    edges = np.repeat(edges, pieces)
    share = (np.arange(len(edges)) - first[edges]) / pieces[edges]
    points = between(edges, share)
    points[first] = corners[:-1]
    return np.concatenate([points, corners[-1:]])


def wrapped_degrees(degrees: FloatArray) -> FloatArray:
    """Return longitudes as their equals from -180 to below 180."""
    return (degrees + 180.0) % 360.0 - 180.0
