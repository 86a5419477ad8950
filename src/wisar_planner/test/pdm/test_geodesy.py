"""The local frame against geodesics, and its refusals."""

import numpy as np
import pyproj
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wisar_planner.errors import InvalidInput
from wisar_planner.pdm.geodesy import GeoOrigin, LocalFrame

latitudes = st.floats(-85.0, 85.0)
longitudes = st.floats(-180.0, 180.0)
# Whole centimetres: PROJ moves what is within half a millimetre of the origin onto it.
offsets = st.integers(-5_000_000, 5_000_000).map(lambda centimetres: centimetres / 100.0)
WGS84 = pyproj.Geod(ellps="WGS84")


@given(latitudes, longitudes, offsets, offsets)
def test_local_to_geodetic_and_back(latitude, longitude, east, north):
    frame = LocalFrame(GeoOrigin(latitude, longitude))
    geodetic = frame.to_geodetic([(east, north)])
    local = frame.to_local(geodetic[:, 0], geodetic[:, 1])
    assert local == pytest.approx(np.array([[east, north]]), abs=1e-5)
    again = frame.to_geodetic(local)
    difference = np.abs(again - geodetic)
    difference[:, 1] = np.minimum(difference[:, 1], 360.0 - difference[:, 1])
    assert difference.max() < 1e-9


@given(latitudes, longitudes, st.floats(0.0, 360.0), st.floats(1.0, 50_000.0))
def test_distance_and_bearing_from_the_origin_are_geodesic(latitude, longitude, bearing, distance):
    lon, lat, _ = WGS84.fwd(longitude, latitude, bearing, distance)
    (point,) = LocalFrame(GeoOrigin(latitude, longitude)).to_local([lat], [lon])
    angle = np.radians(bearing)
    expected = distance * np.array([np.sin(angle), np.cos(angle)])
    # PROJ rounds an origin within a nanodegree of a meridian to it: a tenth of a millimetre.
    assert point == pytest.approx(expected, abs=2e-4)


def test_lengths_away_from_the_origin_are_off_by_less_than_a_millionth():
    frame = LocalFrame(GeoOrigin(57.0, -5.0))
    ends = np.array([[10_000.0, -50.0], [10_000.0, 50.0]])
    geodetic = frame.to_geodetic(ends)
    _, _, length = WGS84.inv(*geodetic[0, ::-1], *geodetic[1, ::-1])
    assert length == pytest.approx(100.0, rel=1e-6)


def test_the_origin_is_zero_and_scalars_count_as_one_point():
    frame = LocalFrame(GeoOrigin(57.0, -5.0, 300.0))
    assert frame.to_local(57.0, -5.0) == pytest.approx(np.zeros((1, 2)), abs=1e-9)
    assert frame.to_geodetic((0.0, 0.0)) == pytest.approx(np.array([[57.0, -5.0]]), abs=1e-12)
    assert frame.to_local([], []).shape == (0, 2)
    assert frame.to_geodetic(np.empty((0, 2))).shape == (0, 2)


def test_a_frame_works_across_the_antimeridian():
    points = LocalFrame(GeoOrigin(-17.0, 179.999)).to_local([-17.0, -17.0], [179.998, -179.999])
    assert points[:, 0] == pytest.approx([-106.5, 213.0], abs=0.5)


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        ((91.0, 0.0), "latitude"),
        ((0.0, 181.0), "longitude"),
        ((float("nan"), 0.0), "latitude"),
        ((0.0, float("inf")), "longitude"),
        ((0.0, 0.0, float("nan")), "altitude"),
    ],
)
def test_an_origin_that_is_no_place_is_refused(arguments, named):
    with pytest.raises(InvalidInput, match=named):
        GeoOrigin(*arguments)


@pytest.mark.parametrize(
    ("latitude", "longitude", "named"),
    [
        ([57.0, np.nan], [0.0, 0.0], "latitude"),
        ([57.0], [200.0], "longitude"),
        ([57.0, 57.0], [0.0], "equally long"),
    ],
)
def test_wrong_geodetic_coordinates_are_refused(latitude, longitude, named):
    with pytest.raises(InvalidInput, match=named):
        LocalFrame(GeoOrigin(57.0, -5.0)).to_local(latitude, longitude)


@pytest.mark.parametrize(
    "points", [[[np.nan, 0.0]], [[1.0, 2.0, 3.0]], [[1e9, 0.0]]], ids=["nan", "three", "far"]
)
def test_wrong_local_points_are_refused(points):
    with pytest.raises(InvalidInput, match="points"):
        LocalFrame(GeoOrigin(57.0, -5.0)).to_geodetic(points)
