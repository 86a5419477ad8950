"""GeoJSON (RFC 7946), a drawing of the mission for GIS programs."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from wisar_planner.mavlink.mission import Mission
from wisar_planner.mavlink.rings import fence_rings


def render(mission: Mission, name: str) -> str:
    """Return the text of a .geojson file: the path, each waypoint, fence and rally points.

    Heights stand in the properties: RFC 7946 wants those of coordinates above the ellipsoid.
    """
    waypoints = mission.waypoints
    corners = _longitude_first(waypoints)
    path = shapely.LineString(corners) if len(corners) > 1 else shapely.Point(corners[0])
    features = [_feature(path, kind="path", name=name)]
    features.extend(
        _feature(shapely.Point(place), kind="waypoint", number=number, altitude_m=altitude)
        for number, (place, altitude) in enumerate(zip(corners, waypoints[:, 2], strict=True))
    )
    for ring in fence_rings(mission.fence):
        kind = "fence" if ring.inclusion else "keep_out"
        # RFC 7946, section 3.1.6: outer rings run counterclockwise.
        polygon = shapely.geometry.polygon.orient(shapely.Polygon(_longitude_first(ring.corners)))
        features.append(_feature(polygon, kind=kind))
    features.extend(
        _feature(shapely.Point(item.longitude, item.latitude), kind="rally", altitude_m=item.z)
        for item in mission.rally
    )
    collection = {"type": "FeatureCollection", "features": features}
    return json.dumps(collection, indent=1, allow_nan=False) + "\n"


def _longitude_first(places: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.round(places[:, 1::-1], 7)


def _feature(geometry: shapely.Geometry, **properties: Any) -> dict[str, Any]:
    return {
        "type": "Feature",
        "geometry": json.loads(shapely.to_geojson(geometry)),
        "properties": properties,
    }
