"""GPX 1.1 (https://www.topografix.com/GPX/1/1/), a drawing of the mission for GPS receivers."""

from __future__ import annotations

from xml.etree import ElementTree as Xml

from wisar_planner.mavlink.mission import Mission

_NAMESPACE = "http://www.topografix.com/GPX/1/1"


def render(mission: Mission, name: str) -> str:
    """Return the text of a .gpx file: rally points and the path as a route.

    Heights are left out: GPX wants them above sea level, and the mission has them above ground.
    """
    Xml.register_namespace("", _NAMESPACE)
    root = Xml.Element(f"{{{_NAMESPACE}}}gpx", version="1.1", creator="wisar")
    _add(_add(root, "metadata"), "name", name)
    for number, item in enumerate(mission.rally, start=1):
        point = _add(root, "wpt", lat=f"{item.latitude:.7f}", lon=f"{item.longitude:.7f}")
        _add(point, "name", f"R{number}")
    route = _add(root, "rte")
    _add(route, "name", name)
    for number, (latitude, longitude, _) in enumerate(mission.waypoints, start=1):
        point = _add(route, "rtept", lat=f"{latitude:.7f}", lon=f"{longitude:.7f}")
        _add(point, "name", f"W{number}")
    Xml.indent(root)
    return Xml.tostring(root, encoding="utf-8", xml_declaration=True).decode() + "\n"


def _add(parent: Xml.Element, tag: str, text: str | None = None, **attributes: str) -> Xml.Element:
    child = Xml.SubElement(parent, f"{{{_NAMESPACE}}}{tag}", attributes)
    child.text = text
    return child
