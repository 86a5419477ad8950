"""Mixture files: round trips, hand-written ones, and messages that name the field."""

import copy
import json

import numpy as np
import pytest
import shapely
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from wisar_planner.errors import InvalidInput
from wisar_planner.pdm import GaussianMixture
from wisar_planner.pdm.geodesy import GeoOrigin, LocalFrame
from wisar_planner.pdm.gis import load_map, save_mixture

coordinates = st.floats(-5_000.0, 5_000.0)


@st.composite
def mixtures(draw):
    count = draw(st.integers(1, 5))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    roots = rng.normal(scale=30.0, size=(count, 2, 2))
    return GaussianMixture(
        rng.dirichlet(np.ones(count)),
        rng.uniform(-3_000.0, 3_000.0, (count, 2)),
        roots @ roots.swapaxes(1, 2) + 25.0 * np.eye(2),
    )


@st.composite
def areas(draw):
    x, y = draw(coordinates), draw(coordinates)
    square = shapely.box(x, y, x + draw(st.floats(1.0, 3_000.0)), y + 500.0)
    kind = draw(st.sampled_from(["plain", "hole", "parts"]))
    if kind == "hole":
        return square.difference(square.centroid.buffer(0.2))
    if kind == "parts":
        return shapely.union_all([square, shapely.box(x + 4_000.0, y, x + 4_100.0, y + 80.0)])
    return square


origins = st.builds(
    GeoOrigin, st.floats(-80.0, 80.0), st.floats(-180.0, 180.0), st.floats(-100.0, 5_000.0)
)


@pytest.mark.parametrize("suffix", [".geojson", ".yaml"])
def test_a_byte_order_mark_does_not_matter(tmp_path, suffix):
    path = tmp_path / f"map{suffix}"
    mixture = GaussianMixture([1.0], [[0.0, 0.0]], [100.0 * np.eye(2)])
    save_mixture(path, mixture, shapely.box(-50.0, -50.0, 50.0, 50.0), GeoOrigin(56.7, -5.0))
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes())
    assert load_map(path).origin.latitude == 56.7


@settings(max_examples=40, deadline=None)
@given(mixtures(), areas(), origins, st.sampled_from([".geojson", ".json", ".yaml", ".yml"]))
def test_what_is_saved_is_loaded_again(tmp_path_factory, mixture, area, origin, suffix):
    path = tmp_path_factory.mktemp("mixture") / f"map{suffix}"
    save_mixture(path, mixture, area, origin)
    loaded = load_map(path)
    assert loaded.origin == origin
    assert loaded.notes == ()
    np.testing.assert_allclose(loaded.pdm.weights, mixture.weights, rtol=0, atol=1e-12)
    np.testing.assert_allclose(loaded.pdm.means, mixture.means, rtol=0, atol=1e-4)
    np.testing.assert_allclose(loaded.pdm.covariances, mixture.covariances, rtol=1e-12)
    assert loaded.area.symmetric_difference(area).area < 1e-4 * area.length


def point(longitude, latitude, **properties):
    return {
        "type": "Feature",
        "geometry": {"type": "Point", "coordinates": [longitude, latitude]},
        "properties": properties,
    }


def collection(*features, **members):
    return {"type": "FeatureCollection", "features": list(features), **members}


SQUARE = {
    "type": "Polygon",
    "coordinates": [[[-5.0, 56.7], [-4.98, 56.7], [-4.98, 56.71], [-5.0, 56.71], [-5.0, 56.7]]],
}


def write(path, document):
    text = document if isinstance(document, str) else json.dumps(document)
    path.write_text(text, encoding="utf-8")
    return path


def test_a_hand_drawn_mixture_with_ellipses(tmp_path):
    path = write(
        tmp_path / "map.geojson",
        collection(
            point(-5.0, 56.7, weight=0.5, sigma_m=30),
            point(-4.98, 56.7, weight=0.3, semi_major_m=60, semi_minor_m=20, bearing_deg=90),
            point(-4.99, 56.71, weight=0.2, semi_major_m=60, semi_minor_m=20, bearing_deg=45),
        ),
    )
    loaded = load_map(path)
    assert loaded.origin.latitude == pytest.approx(56.7 + 0.01 / 3)
    assert loaded.origin.longitude == pytest.approx(-4.99)
    expected = [
        [[900, 0], [0, 900]],
        [[3600, 0], [0, 400]],  # a long axis that points east
        [[2000, 1600], [1600, 2000]],
    ]
    np.testing.assert_allclose(loaded.pdm.covariances, expected, atol=1e-9)
    # A minute of longitude is 1.0188 km at 56.7 degrees north.
    assert loaded.pdm.means[1, 0] - loaded.pdm.means[0, 0] == pytest.approx(1225.5, abs=1.0)
    assert loaded.area.bounds[0] == pytest.approx(loaded.pdm.means[0, 0] - 90.0, abs=1e-9)
    assert "3 standard deviations" in loaded.notes[0]


def test_points_astride_the_antimeridian_have_their_origin_between_them(tmp_path):
    document = collection(
        point(179.999, -17.0, weight=0.5, sigma_m=30),
        point(-179.999, -17.0, weight=0.5, sigma_m=30),
    )
    loaded = load_map(write(tmp_path / "map.geojson", document))
    assert abs(loaded.origin.longitude) == pytest.approx(180.0, abs=1e-9)
    assert np.abs(loaded.pdm.means[:, 0]) == pytest.approx([106.5, 106.5], abs=0.5)


def test_an_area_file_replaces_the_area(tmp_path):
    path = write(tmp_path / "map.geojson", collection(point(-4.99, 56.705, weight=1, sigma_m=30)))
    area = write(tmp_path / "area.geojson", SQUARE)
    loaded = load_map(path, area=area)
    assert loaded.area.area == pytest.approx(1225.5 * 1113.5, rel=1e-3)
    with pytest.raises(InvalidInput, match=r"map\.geojson: no Polygon"):
        load_map(path, area=path)


def square(x0, y0, x1, y1, **properties):
    """A feature with a rectangle in degrees."""
    ring = [[x0, y0], [x1, y0], [x1, y1], [x0, y1], [x0, y0]]
    geometry = {"type": "Polygon", "coordinates": [ring]}
    return {"type": "Feature", "geometry": geometry, "properties": properties}


AREA = square(-5.0, 56.7, -4.98, 56.71, role="search_area")


@pytest.mark.parametrize(
    "properties",
    [
        {"role": "keep_out"},
        {"kind": "keep_out"},
        {"role": "Keep-Out"},
        {"kind": "no fly zone"},
        {"role": "search_area", "kind": "NFZ"},
        {"role": "Restricted airspace"},
        {"kind": "exclusion_zone"},
        {"role": "danger area"},
        {"kind": "avoid"},
        {"kind": "do_not_fly"},
        {"kind": "Do not overfly"},
        {"kind": "military"},
        {"kind": "off-limits"},
        {"kind": "TFR"},
        {"name": "No-fly zone"},
        {"name": "shooting range, DO NOT FLY"},
        {"name": "no overflight"},
        {"name": "Don't fly"},
        {"kind": "no_drone_zone"},
        {"name": "Prohibited area P-40"},
        {"name": "exclusion zone"},
    ],
    ids=str,
)
@pytest.mark.parametrize("others", [[], [AREA]], ids=["alone", "beside-an-area"])
def test_a_zone_to_keep_out_of_is_never_searched(tmp_path, properties, others):
    path = write(tmp_path / "map.geojson", collection(point(-4.99, 56.705, weight=1, sigma_m=30)))
    zone = square(-4.98, 56.7, -4.97, 56.71, **properties)
    area = write(tmp_path / "area.geojson", collection(*others, zone))
    message = rf"area\.geojson: features\[{len(others)}\]: keep_out zones are not supported; cut"
    with pytest.raises(InvalidInput, match=message):
        load_map(path, area=area)


@pytest.mark.parametrize(
    "name", ["Danger Hill", "Military Road wood", "Closed canopy", "Nofield", "Keep Outlook"]
)
def test_a_place_of_whatever_name_is_searched(tmp_path, name):
    path = write(tmp_path / "map.geojson", collection(point(-4.99, 56.705, weight=1, sigma_m=30)))
    place = square(-5.0, 56.7, -4.98, 56.71, name=name, role="")
    assert load_map(path, area=write(tmp_path / "area.geojson", collection(place))).area.area > 0.0


@pytest.mark.parametrize("others", [[], [AREA]], ids=["alone", "beside-an-area"])
def test_a_polygon_of_another_role_is_refused(tmp_path, others):
    """It may be a ban in words that nobody thought of."""
    path = write(tmp_path / "map.geojson", collection(point(-4.99, 56.705, weight=1, sigma_m=30)))
    other = square(-4.98, 56.7, -4.97, 56.71, role="shooting range")
    area = write(tmp_path / "area.geojson", collection(*others, other))
    with pytest.raises(InvalidInput, match="'shooting range' is neither searched nor kept out of"):
        load_map(path, area=area)


@pytest.mark.parametrize(("name", "value"), [("band", 2), ("cell", 5.0)])
def test_what_only_rasters_have_is_refused_of_a_mixture(tmp_path, name, value):
    path = write(tmp_path / "map.geojson", collection(point(-4.99, 56.705, weight=1, sigma_m=30)))
    with pytest.raises(InvalidInput, match=f"{name}: .*map.geojson is a mixture"):
        load_map(path, **{name: value})


def test_of_an_area_file_the_search_areas_count_if_it_names_any(tmp_path):
    path = write(tmp_path / "map.geojson", collection(point(-4.99, 56.705, weight=1, sigma_m=30)))
    lake = square(-4.98, 56.7, -4.97, 56.71, name="lake")
    alone, both, neither = (
        load_map(path, area=write(tmp_path / "area.geojson", collection(*features))).area
        for features in ([AREA], [lake, AREA], [lake, {**AREA, "properties": None}])
    )
    assert both.equals(alone)
    assert neither.area == pytest.approx(1.5 * alone.area, rel=1e-3)
    area = write(tmp_path / "area.geojson", collection(lake, AREA))
    assert load_map(path, area=area).notes[-1].endswith("left out: features[0] ('lake')")
    assert "left out" not in " ".join(load_map(path, area=write(area, AREA)).notes)
    line = {"type": "LineString", "coordinates": [[-5.0, 56.7], [-4.98, 56.7]]}
    wrong = {"type": "Feature", "geometry": line, "properties": {"role": "search_area"}}
    with pytest.raises(InvalidInput, match=r"features\[1\]\.geometry\.type must be Polygon"):
        load_map(path, area=write(tmp_path / "area.geojson", collection(lake, wrong)))


def test_polygons_in_a_geometry_collection_count(tmp_path):
    far = square(-4.98, 56.7, -4.97, 56.71)
    line = {"type": "LineString", "coordinates": [[-5.0, 56.7], [-4.98, 56.7]]}
    both = {"type": "GeometryCollection", "geometries": [far["geometry"], line, AREA["geometry"]]}
    plain = write(tmp_path / "map.geojson", collection(point(-4.99, 56.705, weight=1, sigma_m=30)))
    marked = {"type": "Feature", "geometry": both, "properties": {"role": "search_area"}}
    full = write(
        tmp_path / "full.geojson", collection(point(-4.99, 56.705, weight=1, sigma_m=30), marked)
    )
    one = load_map(plain, area=write(tmp_path / "one.geojson", AREA)).area.area
    for area in (both, collection(AREA, {**marked, "properties": {"role": "search_area"}})):
        wide = load_map(plain, area=write(tmp_path / "area.geojson", area)).area
        assert wide.area == pytest.approx(1.5 * one, rel=1e-3)
    assert load_map(full).area.area == pytest.approx(1.5 * one, rel=1e-3)
    for members, message in ((None, "must be a list"), ([both], "a collection in a collection")):
        area = {"type": "GeometryCollection", "geometries": members}
        with pytest.raises(InvalidInput, match=message):
            load_map(plain, area=write(tmp_path / "area.geojson", area))


def test_an_area_cut_by_the_antimeridian_becomes_one(tmp_path):
    def strip(x0, x1):
        return [[[x0, -17.0], [x1, -17.0], [x1, -16.99], [x0, -16.99], [x0, -17.0]]]

    document = collection(
        point(180.0, -16.995, weight=1, sigma_m=30),
        {
            "type": "Feature",
            "geometry": {
                "type": "MultiPolygon",
                "coordinates": [strip(179.99, 180.0), strip(-180.0, -179.99)],
            },
            "properties": {"role": "search_area"},
        },
    )
    area = load_map(write(tmp_path / "map.geojson", document)).area
    assert area.geom_type == "Polygon"
    assert area.bounds[2] - area.bounds[0] == pytest.approx(2 * 1065, abs=5)


def test_sectors_that_share_a_border_but_not_its_vertices_are_one_area(tmp_path):
    """In metres, the long edge of the northern sector runs 12 cm south of the middle vertex."""
    plain = write(tmp_path / "map.geojson", collection(point(-4.98, 57.0, weight=1, sigma_m=90)))
    sectors = [
        square(-5.0, 57.0, -4.96, 57.01),
        square(-5.0, 56.99, -4.98, 57.0),
        square(-4.98, 56.99, -4.96, 57.0),
    ]
    area = load_map(plain, area=write(tmp_path / "area.geojson", collection(*sectors))).area
    assert area.geom_type == "Polygon"
    assert not area.interiors
    apart = [sectors[0], square(-5.0, 56.98, -4.96, 56.9999)]  # 11 m between them
    area = load_map(plain, area=write(tmp_path / "area.geojson", collection(*apart))).area
    assert len(area.geoms) == 2


def test_a_hole_stays_where_a_hairline_is_closed(tmp_path):
    plain = write(tmp_path / "map.geojson", collection(point(-4.98, 57.0, weight=1, sigma_m=90)))
    mast = [[-4.98, 57.005], [-4.98, 57.005002], [-4.979997, 57.005002], [-4.98, 57.005]]
    north = square(-5.0, 57.0, -4.96, 57.01)
    north["geometry"]["coordinates"].append(mast)
    sectors = [
        north,
        square(-5.0, 56.99, -4.98, 57.0),
        square(-4.98, 56.99, -4.96, 57.0),
    ]
    area = load_map(plain, area=write(tmp_path / "area.geojson", collection(*sectors))).area
    assert area.geom_type == "Polygon"
    assert len(area.interiors) == 1


def test_an_island_in_a_hole_stays(tmp_path):
    plain = write(tmp_path / "map.geojson", collection(point(-4.98, 57.0, weight=1, sigma_m=90)))
    ring = square(-5.0, 56.99, -4.96, 57.01)
    lake = square(-4.99, 56.995, -4.97, 57.005)["geometry"]["coordinates"][0]
    ring["geometry"]["coordinates"].append(lake)
    island = square(-4.985, 56.998, -4.975, 57.002)
    area = load_map(plain, area=write(tmp_path / "area.geojson", collection(ring, island))).area
    assert len(area.geoms) == 2
    frame = LocalFrame(GeoOrigin(57.0, -4.98))
    assert shapely.contains(area, shapely.Point(frame.to_local(57.0, -4.98)[0]))


@pytest.mark.parametrize("kind", ["unrestricted", "volcano gorge", "sector"])
def test_other_kinds_of_polygons_are_searched(tmp_path, kind):
    plain = write(tmp_path / "map.geojson", collection(point(-4.99, 56.705, weight=1, sigma_m=30)))
    part = square(-5.0, 56.7, -4.98, 56.71, kind=kind)
    assert load_map(plain, area=write(tmp_path / "area.geojson", part)).area.area > 0.0


def test_edges_are_straight_in_degrees(tmp_path):
    """A parallel of 20 km is curved in metres: by L^2 tan(latitude) / (8 R), 12 m at 57 degrees."""
    plain = write(tmp_path / "map.geojson", collection(point(-5.0, 57.0, weight=1, sigma_m=900)))
    wide = square(-5.165, 56.99, -4.835, 57.01)
    area = load_map(plain, area=write(tmp_path / "area.geojson", wide)).area
    frame = LocalFrame(GeoOrigin(57.0, -5.0))
    for latitude in (56.99, 57.01):
        on_it = frame.to_local(np.full(99, latitude), np.linspace(-5.165, -4.835, 99))
        distance = shapely.distance(shapely.points(on_it), area.boundary)
        assert distance.max() < 0.25
    # Straight in metres, the middle of the northern edge would lie 12 m outside.
    west, middle, east = frame.to_local([57.01] * 3, [-5.165, -5.0, -4.835])
    assert 0.5 * (west + east)[1] - middle[1] == pytest.approx(12.1, abs=0.3)


def test_a_mixture_far_from_its_origin_is_refused(tmp_path):
    one = point(-5.0, 56.8, weight=1, sigma_m=100)
    swapped = write(tmp_path / "map.geojson", collection(one, origin=[56.8, -5.0]))
    message = r"up to [\d,]+ km from its origin -5\.00000,56\.80000.*\[longitude, latitude\]"
    with pytest.raises(InvalidInput, match=message):
        load_map(swapped)
    load_map(write(tmp_path / "map.geojson", collection(one, origin=[-5.0, 56.8])))
    path = tmp_path / "map.yaml"
    for east, north in ((400_800, 6_289_400), (4e8, 0)):
        path.write_text(yaml.safe_dump({**YAML, "means": [[east, north], [40, 60]]}))
        with pytest.raises(InvalidInput, match=r"map\.yaml: its components .* means are metres"):
            load_map(path)
    path.write_text(yaml.safe_dump({**YAML, "area": {"rectangle": [0, 0, 150, 600_000]}}))
    with pytest.raises(InvalidInput, match="its search area reaches up to 600 km"):
        load_map(path)
    path.write_text(yaml.safe_dump({**YAML, "means": [[90_000, 0], [40, 60]]}))
    assert "components lie up to 90 km from the origin 56.78" in " ".join(load_map(path).notes)


def test_an_area_apart_from_its_map_is_named_with_both_places(tmp_path):
    path = write(tmp_path / "map.geojson", collection(point(-4.99, 56.705, weight=1, sigma_m=30)))
    elsewhere = write(tmp_path / "else.geojson", square(10.0, 50.0, 10.02, 50.02))
    both = r"else\.geojson: lies around 50\.0100\d,10\.0100\d, but the map .*map\.geojson around "
    with pytest.raises(InvalidInput, match=both + r"56\.70500,-4\.99000 \(LAT,LON\); check"):
        load_map(path, area=elsewhere)
    swapped = write(tmp_path / "swapped.geojson", square(56.7, -5.0, 56.71, -4.98))
    with pytest.raises(InvalidInput, match="with longitude and latitude swapped it lies on the"):
        load_map(path, area=swapped)
    nation = write(tmp_path / "nation.geojson", square(-12.0, 50.0, 2.0, 60.0))
    with pytest.raises(
        InvalidInput, match=r"nation\.geojson: reaches .* draw the search area clos"
    ):
        load_map(path, area=nation)


GOOD = collection(
    point(-5.0, 56.7, weight=0.5, sigma_m=30), point(-4.99, 56.7, weight=0.5, sigma_m=30)
)


def changed(*keys, to):
    """GOOD with the value at a path of keys replaced, or removed for None."""
    document = copy.deepcopy(GOOD)
    target = document
    for key in keys[:-1]:
        target = target[key]
    if to is None:
        del target[keys[-1]]
    else:
        target[keys[-1]] = to
    return document


@pytest.mark.parametrize(
    ("document", "message"),
    [
        ("{", "not valid JSON"),
        ("[" * 100_000, "not valid JSON"),
        ("[]", "not GeoJSON"),
        ('{"type": "FeatureCollection", "features": [NaN]}', "NaN is not a JSON number"),
        (collection(), "no Point with a weight"),
        (collection(crs={"properties": {"name": "urn:ogc:def:crs:EPSG::27700"}}), "ogr2ogr -t_srs"),
        (changed("features", to={}), "features must be a list"),
        (changed("features", 1, "geometry", to=None), r"features\[1\] must be .* geometry"),
        (
            changed("features", 0, "geometry", "coordinates", to=[217_000, 768_500]),
            r"features\[0\]\.geometry\.coordinates .*no \[longitude, latitude\]",
        ),
        (changed("features", 0, "geometry", "coordinates", to=["5", 6]), "in degrees, not"),
        (
            changed("features", 1, "properties", "weight", to=None),
            r"features\[1\]\.properties\.weight is missing",
        ),
        (changed("features", 1, "properties", "weight", to="half"), "weight is 'half'"),
        (changed("features", 1, "properties", "weight", to=0.4), "sum to 0.9 and not to 1"),
        (changed("features", 1, "properties", "sigma_m", to=0), "sigma_m is 0; give a length"),
        (changed("features", 1, "properties", "sigma_m", to=None), "exactly one of covariance_m2"),
        (
            changed("features", 1, "properties", to={"weight": 0.5, "covariance_m2": [[1, 0]]}),
            r"covariance_m2 is \[\[1, 0\]\]",
        ),
        (
            changed(
                "features", 1, "properties", to={"weight": 0.5, "covariance_m2": [[1, 2], [2, 1]]}
            ),
            "covariance",
        ),
        (changed("features", 0, "properties", "weight", to=-0.5), "weight"),
        (
            collection(
                *GOOD["features"],
                {"type": "Feature", "geometry": SQUARE, "properties": {"role": "keep_out"}},
            ),
            "keep_out zones are not supported",
        ),
        (
            collection(
                *GOOD["features"], {"type": "Feature", "geometry": SQUARE, "properties": None}
            ),
            "Polygon with role None",
        ),
        (
            changed("features", 0, "geometry", "coordinates", to=[10**400, 56]),
            r"coordinates is \[1000+\.\.\., which is no \[longitude",
        ),
        (
            changed("features", 1, "properties", "sigma_m", to=10**400),
            r"sigma_m is 10+\.\.\.; give",
        ),
        (changed("features", 1, "properties", "sigma_m", to=1e200), "covariances must be finite"),
        (changed("features", 1, "properties", "weight", to=-(10**400)), r"weight is -10+\.\.\."),
        ({**GOOD, "origin": [0]}, r"origin must be \[longitude, latitude\]"),
    ],
)
def test_wrong_geojson_is_refused_by_its_field(tmp_path, document, message):
    path = write(tmp_path / "wrong.geojson", document)
    with pytest.raises(InvalidInput, match=rf"wrong\.geojson: (?s:.)*{message}"):
        load_map(path)


@pytest.mark.parametrize(
    ("geometry", "message"),
    [
        ({"type": "LineString", "coordinates": []}, "must be Polygon or MultiPolygon"),
        ({"type": "Polygon", "coordinates": []}, "lists of rings"),
        ({"type": "Polygon", "coordinates": [[[0, 0], [1, 1]]]}, "at least four positions"),
        (
            {"type": "Polygon", "coordinates": [[[0, 0], [1, 1], [1, 0], [0, 1], [0, 0]]]},
            "Self-intersection.*repair",
        ),
        (
            {"type": "Polygon", "coordinates": [[[0, 0], [0, 0], [0, 0], [0, 0]]]},
            "valid polygon|with an area",
        ),
    ],
    ids=["line", "empty", "short", "bow", "flat"],
)
def test_a_wrong_search_area_is_refused(tmp_path, geometry, message):
    area = {"type": "Feature", "geometry": geometry, "properties": {"role": "search_area"}}
    path = write(tmp_path / "map.geojson", collection(point(0.5, 0.5, weight=1, sigma_m=30), area))
    with pytest.raises(InvalidInput, match=rf"features\[1\]\.geometry(?s:.)*({message})"):
        load_map(path)


def test_a_yaml_mixture_in_local_metres(tmp_path):
    path = tmp_path / "map.yaml"
    path.write_text(
        """
        origin: {latitude: 56.78, longitude: -4.98}
        weights: [0.6, 0.4]
        means: [[40, 60], [110, 90]]
        covariances: [[[500, 0], [0, 500]], [[900, 200], [200, 400]]]
        area: {rectangle: [0, 0, 150, 150]}
        """
    )
    loaded = load_map(path)
    assert loaded.origin == GeoOrigin(56.78, -4.98)
    assert loaded.area.equals(shapely.box(0, 0, 150, 150))
    np.testing.assert_array_equal(loaded.pdm.means, [[40, 60], [110, 90]])
    with pytest.raises(InvalidInput, match="origin"):
        load_map(path, origin=GeoOrigin(0.0, 0.0))


def test_numbers_as_people_write_them_are_read_from_yaml(tmp_path):
    path = tmp_path / "map.yaml"
    path.write_text(
        """
        origin: {latitude: 5678e-2, longitude: -4.98E+0, altitude: 1e4}
        weights: [2.5e-1, .5, +2.5E-1]
        means: [[4e1, 6.e1], [-.5, -1E+3], [+110, 0.9e2]]
        covariances: [[[5e2, 0], [0, 5E2]], [[9e+02, 2e2], [2e2, .4e3]], [[5.0e+2, 0], [0, 500]]]
        area: {polygon: [[-2E+3, -2e3], [1.5e3, -2e3], [1.5e3, 1.5e3]]}
        """
    )
    loaded = load_map(path)
    assert loaded.origin == GeoOrigin(56.78, -4.98, 10_000.0)
    np.testing.assert_array_equal(loaded.pdm.weights, [0.25, 0.5, 0.25])
    np.testing.assert_array_equal(loaded.pdm.means, [[40, 60], [-0.5, -1000], [110, 90]])
    np.testing.assert_array_equal(
        loaded.pdm.covariances,
        [[[500, 0], [0, 500]], [[900, 200], [200, 400]], [[500, 0], [0, 500]]],
    )
    corners = [[-2000, -2000], [1500, -2000], [1500, 1500]]
    assert loaded.area.equals(shapely.Polygon(corners))


@pytest.mark.parametrize(
    "word", ["many", "e4", "1e", "1e4m", "'1e4'", "1e4.5", "-e4", ".", "1e400"]
)
def test_a_word_is_no_number_in_yaml(tmp_path, word):
    path = tmp_path / "wrong.yaml"
    path.write_text(yaml.safe_dump(YAML).replace("latitude: 56.78", f"latitude: {word}"))
    with pytest.raises(InvalidInput, match=r"wrong\.yaml: origin\.latitude is .*; give a finite"):
        load_map(path)


ENDLESS = []
ENDLESS.append(ENDLESS)

YAML = {
    "origin": {"latitude": 56.78, "longitude": -4.98},
    "weights": [0.5, 0.5],
    "means": [[40, 60], [110, 90]],
    "covariances": [[[500, 0], [0, 500]]] * 2,
    "area": {"rectangle": [0, 0, 150, 150]},
}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"origin": None}, "origin is missing; add origin"),
        ({"origin": {"latitude": 95, "longitude": 0}}, "origin: latitude must lie between"),
        ({"origin": {"latitude": 5}}, "origin.longitude is missing"),
        ({"origin": {"lat": 5}}, "unknown field 'lat'"),
        ({"weights": [0.5, float("nan")]}, r"weights\[1\] is nan"),
        ({"weights": [0.5, 0.6]}, "sum to 1.1"),
        ({"weights": [1.0]}, "equally long, not 1, 2 and 2"),
        ({"weights": []}, "one entry for each component"),
        ({"means": [[1, 2, 3], [4, 5]]}, r"means\[0\] is \[1, 2, 3\]; give a list of 2"),
        ({"covariances": [[[1, 2], [2, 1]]] * 2}, "covariance"),
        ({"covarianses": []}, "unknown field 'covarianses'"),
        ({"area": {"rectangle": [0, 0, 0, 1]}}, "with an area"),
        ({"area": {"rectangle": [0, 0, 1]}}, "list of 4 numbers"),
        ({"area": {"polygon": [[0, 0], [1, 0], [1, float("inf")]]}}, "finite corners"),
        ({"area": {"polygon": [[0, 0], [1, 1], [1, 0], [0, 1]]}}, "Self-intersection"),
        ({"area": {"polygon": [1, 2]}}, r"corners \[\[x, y\]"),
        ({"area": {"polygon": [[0, "a"], [1, 1], [1, 0]]}}, r"corners \[\[x, y\]"),
        ({"area": {"polygon": [[0, 0], [1, 1]]}}, r"corners \[\[x, y\]"),
        ({"area": {}}, "one of rectangle and polygon"),
        ({"means": [[10**400, 60], [110, 90]]}, r"means\[0\]\[0\] is 10+\.\.\.; give a finite"),
        ({"origin": {"latitude": 10**400, "longitude": 0}}, "origin.latitude is 10"),
        ({"weights": [1e308, 1e308]}, "weights sum to inf and not to 1"),
        ({"covariances": [[[10**400, 0], [0, 1]]] * 2}, r"covariances\[0\]\[0\]\[0\] is 10"),
        ({"area": {"polygon": [[0, 0], [10**400, 0], [0, 1]]}}, r"corners \[\[x, y\]"),
        ({"area": {"polygon": ENDLESS}}, r"corners \[\[x, y\]"),
    ],
)
def test_wrong_yaml_is_refused_by_its_field(tmp_path, changes, message):
    path = tmp_path / "wrong.yaml"
    path.write_text(yaml.safe_dump({**YAML, **changes}))
    with pytest.raises(InvalidInput, match=rf"wrong\.yaml: (?s:.)*{message}"):
        load_map(path)


@pytest.mark.parametrize("text", ["a: [", "- 1", "", "!!python/object/apply:os.getcwd []"], ids=str)
def test_what_is_no_yaml_mapping_is_refused(tmp_path, text):
    path = tmp_path / "wrong.yaml"
    path.write_text(text)
    with pytest.raises(InvalidInput, match=r"wrong\.yaml: "):
        load_map(path)


def test_an_unknown_suffix_cannot_be_saved(tmp_path):
    mixture = GaussianMixture([1.0], [[0.0, 0.0]], [np.eye(2)])
    with pytest.raises(InvalidInput, match=r"suffix '\.kml'"):
        save_mixture(tmp_path / "map.kml", mixture, shapely.box(0, 0, 1, 1), GeoOrigin(0.0, 0.0))


def test_a_number_too_long_to_print_is_refused(tmp_path):
    path = tmp_path / "wrong.yaml"
    for value in ("0x" + "f" * 5000, "-0x" + "f" * 5000, "1" * 5000):
        path.write_text(yaml.safe_dump(YAML).replace("56.78", value))
        with pytest.raises(InvalidInput, match=r"wrong\.yaml: "):
            load_map(path)
