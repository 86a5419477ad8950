"""KML 2.2 (https://docs.ogc.org/is/12-007r2/12-007r2.html), a drawing of the mission."""

from __future__ import annotations

from collections.abc import Iterable
from xml.etree import ElementTree as Xml

from pymavlink.dialects.v20 import common as mav

from wisar_planner.mavlink.mission import Mission, plain_frame
from wisar_planner.mavlink.rings import fence_rings

_NAMESPACE = "http://www.opengis.net/kml/2.2"
# KML colours are alpha, blue, green, red.
_STYLES = {"path": "ff00a5ff", "inclusion": "ff00ff00", "exclusion": "ff0000ff"}


def render(mission: Mission, name: str) -> str:
    """Return the text of a .kml file: path, fence and rally points."""
    Xml.register_namespace("", _NAMESPACE)
    root = Xml.Element(f"{{{_NAMESPACE}}}kml")
    document = _add(root, "Document")
    _add(document, "name", name)
    for style, colour in _STYLES.items():
        line = _add(_add(document, "Style", id=style), "LineStyle")
        _add(line, "color", colour)
        _add(line, "width", "3")
    first = next(i for i in mission.items if i.is_waypoint)
    absolute = plain_frame(first.frame) == mav.MAV_FRAME_GLOBAL
    path = _add(_placemark(document, "Search path", "path"), "LineString")
    _add(path, "tessellate", "1")
    # Heights above launch or ground are drawn above ground, the nearest that KML can say.
    _add(path, "altitudeMode", "absolute" if absolute else "relativeToGround")
    _add(path, "coordinates", _coordinates(mission.waypoints))
    for ring in fence_rings(mission.fence):
        kind = "inclusion" if ring.inclusion else "exclusion"
        title = "Fence" if ring.inclusion else "Keep out"
        boundary = _add(_add(_placemark(document, title, kind), "Polygon"), "outerBoundaryIs")
        closed = [*ring.corners, ring.corners[0]]
        _add(_add(boundary, "LinearRing"), "coordinates", _coordinates((*c, 0.0) for c in closed))
    for item in mission.rally:
        point = _add(_placemark(document, "Rally point"), "Point")
        _add(point, "coordinates", _coordinates([(item.latitude, item.longitude, item.z)]))
    Xml.indent(root)
    return Xml.tostring(root, encoding="utf-8", xml_declaration=True).decode() + "\n"


def _add(parent: Xml.Element, tag: str, text: str | None = None, **attributes: str) -> Xml.Element:
    child = Xml.SubElement(parent, f"{{{_NAMESPACE}}}{tag}", attributes)
    child.text = text
    return child


def _placemark(document: Xml.Element, name: str, style: str | None = None) -> Xml.Element:
    placemark = _add(document, "Placemark")
    _add(placemark, "name", name)
    if style is not None:
        _add(placemark, "styleUrl", f"#{style}")
    return placemark


def _coordinates(places: Iterable[Iterable[float]]) -> str:
    return " ".join(f"{lon:.7f},{lat:.7f},{alt:.2f}" for lat, lon, alt in places)
