"""Plan files, read back by readers that know nothing of the writers."""

import json
import math

import numpy as np
import pytest
import shapely
from lxml import etree
from pymavlink import mavwp
from pymavlink.dialects.v20 import common as mav

from wisar_planner.errors import InvalidInput
from wisar_planner.mavlink.files import plan_file_suffixes, write_plan_file
from wisar_planner.mavlink.mission import Mission, build_mission, plain_frame

PLAN = np.array([[57.1234567, -4.7654321], [57.1244567, -4.7654321], [57.1244567, -4.7634321]])
FENCE = [(57.12, -4.77), (57.13, -4.77), (57.13, -4.76), (57.12, -4.76)]
HOLE = [(57.121, -4.769), (57.122, -4.769), (57.122, -4.768)]
MISSION = build_mission(
    PLAN,
    altitude_m=42.5,
    speed=6.0,
    camera_trigger_m=9.0,
    inclusions=[FENCE],
    exclusions=[HOLE],
    rally=[(57.125, -4.765)],
)
KML = "{http://www.opengis.net/kml/2.2}"
GPX = "{http://www.topografix.com/GPX/1/1}"


@pytest.fixture
def write(tmp_path):
    def write(suffix):
        path = tmp_path / f"search{suffix}"
        write_plan_file(path, MISSION, name="Glen & <strath>")
        return path

    return write


def test_waypoints_by_pymavlinks_loader(write):
    loader = mavwp.MAVWPLoader()
    assert loader.load(str(write(".waypoints"))) == len(MISSION.items) + 1
    home, *rows = (loader.wp(n) for n in range(loader.count()))
    assert (home.command, home.frame) == (mav.MAV_CMD_NAV_WAYPOINT, mav.MAV_FRAME_GLOBAL)
    for row, item in zip(rows, MISSION.items, strict=True):
        assert (row.command, row.frame) == (item.command, plain_frame(item.frame))
        assert (row.param1, row.param2, row.param3) == item.params[:3]
        assert row.z == item.z
        assert row.autocontinue == 1
        if item.is_global:
            assert abs(row.x - item.latitude) < 1e-8
            assert abs(row.y - item.longitude) < 1e-8


def test_plan_by_the_documented_rules(write):
    plan = json.loads(write(".plan").read_text())
    assert (plan["fileType"], plan["version"]) == ("Plan", 1)
    items = plan["mission"]["items"]
    assert [i["doJumpId"] for i in items] == list(range(1, len(items) + 1))
    for row, item in zip(items, MISSION.items, strict=True):
        assert row["type"] == "SimpleItem"
        assert (row["command"], row["frame"]) == (item.command, plain_frame(item.frame))
        assert len(row["params"]) == 7
        if item.is_global:
            assert row["params"][4:] == pytest.approx([item.latitude, item.longitude, item.z])
            assert row["AltitudeMode"] == 1
    assert items[0]["params"][3] is None  # JSON knows no NaN
    assert plan["mission"]["hoverSpeed"] == 6.0
    home = plan["mission"]["plannedHomePosition"]
    assert home[:2] == pytest.approx(PLAN[0], abs=1e-7)
    inclusion, exclusion = plan["geoFence"]["polygons"]
    assert inclusion["inclusion"] is True
    assert exclusion["inclusion"] is False
    np.testing.assert_allclose(inclusion["polygon"], FENCE, atol=1e-7)
    np.testing.assert_allclose(plan["rallyPoints"]["points"], [[57.125, -4.765, 42.5]], atol=1e-7)


def coordinates(element):
    text = element.find(f".//{KML}coordinates").text
    return np.array([[float(v) for v in place.split(",")] for place in text.split()])


def test_kml_by_its_schemas_rules(write):
    root = etree.parse(str(write(".kml"))).getroot()
    assert root.tag == f"{KML}kml"
    document = root.find(f"{KML}Document")
    assert document.findtext(f"{KML}name") == "Glen & <strath>"
    path = document.find(f".//{KML}LineString")
    # The schema fixes the order of these children.
    order = [child.tag.removeprefix(KML) for child in path]
    assert order == ["tessellate", "altitudeMode", "coordinates"]
    assert path.findtext(f"{KML}altitudeMode") == "relativeToGround"
    np.testing.assert_allclose(coordinates(path)[:, 1::-1], PLAN, atol=1e-7)
    rings = [coordinates(ring) for ring in document.iter(f"{KML}LinearRing")]
    assert [len(ring) for ring in rings] == [5, 4]
    assert all((ring[0] == ring[-1]).all() for ring in rings)
    styles = {f"#{style.get('id')}" for style in document.iter(f"{KML}Style")}
    assert {url.text for url in document.iter(f"{KML}styleUrl")} <= styles


def test_gpx_by_its_schemas_rules(write):
    root = etree.parse(str(write(".gpx"))).getroot()
    assert root.tag == f"{GPX}gpx"
    assert root.get("version") == "1.1"
    assert root.get("creator")
    assert [child.tag.removeprefix(GPX) for child in root] == ["metadata", "wpt", "rte"]
    route = [(float(p.get("lat")), float(p.get("lon"))) for p in root.iter(f"{GPX}rtept")]
    np.testing.assert_allclose(route, PLAN, atol=1e-7)


def test_geojson_by_shapely(write):
    text = write(".geojson").read_text()
    collection = shapely.from_geojson(text)
    assert collection.is_valid
    features = json.loads(text)["features"]
    by_kind = {}
    for feature in features:
        geometry = shapely.from_geojson(json.dumps(feature["geometry"]))
        by_kind.setdefault(feature["properties"]["kind"], []).append(geometry)
    (path,) = by_kind["path"]
    np.testing.assert_allclose(shapely.get_coordinates(path)[:, ::-1], PLAN, atol=1e-7)
    assert len(by_kind["waypoint"]) == 3
    (fence,), (keep_out,) = by_kind["fence"], by_kind["keep_out"]
    assert fence.exterior.is_ccw
    assert keep_out.exterior.is_ccw
    assert fence.contains(keep_out)
    assert len(by_kind["rally"]) == 1


@pytest.mark.parametrize("suffix", plan_file_suffixes())
def test_a_single_waypoint_is_enough(tmp_path, suffix):
    path = tmp_path / f"one{suffix.upper()}"
    write_plan_file(path, build_mission(PLAN[:1], altitude_m=10.0))
    assert path.stat().st_size > 50


def test_terrain_altitudes_are_marked(tmp_path):
    path = tmp_path / "t.plan"
    write_plan_file(path, build_mission(PLAN, altitude_m=10.0, altitude_frame="terrain"))
    mission = json.loads(path.read_text())["mission"]
    assert mission["globalPlanAltitudeMode"] == 4
    assert mission["items"][1]["frame"] == mav.MAV_FRAME_GLOBAL_TERRAIN_ALT


def test_unknown_endings_and_empty_missions_are_refused(tmp_path):
    with pytest.raises(InvalidInput, match=r"\.plan"):
        write_plan_file(tmp_path / "search.txt", MISSION)
    with pytest.raises(InvalidInput, match="no waypoint"):
        write_plan_file(tmp_path / "search.kml", Mission())
    with pytest.raises(OSError, match="No such file"):
        write_plan_file(tmp_path / "none" / "search.kml", MISSION)
    assert math.isnan(MISSION.items[0].params[3])
