"""GeoTIFF maps: the warp against independent geometry, and what is refused."""

import json
import logging
import re
from pathlib import Path

import numpy as np
import pyproj
import pytest
import rasterio
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from rasterio.enums import ColorInterp
from rasterio.transform import Affine, from_origin

from wisar_planner.errors import InvalidInput
from wisar_planner.pdm import GaussianMixture, RasterMap
from wisar_planner.pdm.geodesy import GeoOrigin, LocalFrame
from wisar_planner.pdm.gis import load_map

SARENV = Path(__file__).parents[5] / "shared" / "data" / "sarenv"
PLACE = GeoOrigin(56.77, -5.0)


def write_tif(path, values, crs="EPSG:32630", transform=None, mask=None, **profile):
    values = np.atleast_2d(values)
    transform = from_origin(377_000, 6_293_000, 10, 10) if transform is None else transform
    rows, columns = values.shape
    with rasterio.open(
        path,
        "w",
        driver="GTiff",
        count=1,
        dtype=profile.pop("dtype", values.dtype),
        width=columns,
        height=rows,
        crs=crs,
        transform=transform,
        **profile,
    ) as dataset:
        dataset.write(values, 1)
        if mask is not None:
            dataset.write_mask(mask)
    return path


def around(crs, cell, columns, rows, turn=0.0):
    """A geotransform whose raster has PLACE near its centre."""
    x, y = pyproj.Transformer.from_crs(4326, crs, always_xy=True).transform(
        PLACE.longitude, PLACE.latitude
    )
    width, height = cell if isinstance(cell, tuple) else (cell, cell)
    sin, cos = np.sin(np.radians(turn)), np.cos(np.radians(turn))
    a, b, d, e = cos * width, sin * height, sin * width, -cos * height
    x0, y0 = x - a * columns / 2 - b * rows / 2, y - d * columns / 2 - e * rows / 2
    return Affine(a, b, x0, d, e, y0)


def corners_in_local(crs, transform, rows, columns, frame):
    """Local positions of the corners of all cells, (rows + 1, columns + 1, 2)."""
    u, v = np.meshgrid(np.arange(columns + 1), np.arange(rows + 1))
    x, y = np.array(transform).reshape(3, 3)[:2] @ (u.ravel(), v.ravel(), np.ones(u.size))
    lon, lat = pyproj.Transformer.from_crs(crs, 4326, always_xy=True).transform(x, y)
    return frame.to_local(lat, lon).reshape(rows + 1, columns + 1, 2)


PLACES = [
    pytest.param("EPSG:32630", 10.0, 0.0, id="utm"),
    pytest.param("EPSG:27700", 10.0, 0.0, id="british-grid"),
    pytest.param("EPSG:4326", (16e-5, 9e-5), 0.0, id="degrees"),
    pytest.param("EPSG:32630", 10.0, 30.0, id="rotated"),
    pytest.param("EPSG:3857", 18.0, 0.0, id="web-mercator"),
]


@pytest.mark.parametrize(("crs", "cell", "turn"), PLACES)
def test_a_known_mixture_survives_the_warp(tmp_path, crs, cell, turn):
    mixture = GaussianMixture(
        [0.6, 0.4],
        [[-150.0, 80.0], [120.0, -60.0]],
        [[[4000.0, 1500.0], [1500.0, 3000.0]], [[2500.0, 0.0], [0.0, 5000.0]]],
    )
    rows, columns = 101, 120
    transform = around(crs, cell, columns, rows, turn)
    corners = corners_in_local(crs, transform, rows, columns, LocalFrame(PLACE))
    quads = shapely.polygons(
        np.stack(
            (corners[:-1, :-1], corners[:-1, 1:], corners[1:, 1:], corners[1:, :-1]), axis=2
        ).reshape(-1, 4, 2)
    )
    centres = (corners[:-1, :-1] + corners[:-1, 1:] + corners[1:, 1:] + corners[1:, :-1]) / 4.0
    masses = mixture.density(centres.reshape(-1, 2)) * shapely.area(quads)
    path = write_tif(tmp_path / "map.tif", masses.reshape(rows, columns), crs, transform)

    loaded = load_map(path, origin=PLACE)

    raster = loaded.pdm
    assert isinstance(raster, RasterMap)
    assert raster.probability.sum() == pytest.approx(1.0, abs=1e-12)
    expected = mixture.rasterize(raster.grid)
    # Splitting cells smears the map by about half a cell of its 50 to 70 m spread.
    assert 0.5 * np.abs(raster.probability - expected).sum() < 0.01
    mean = np.einsum("ij,ijk->k", raster.probability, raster.grid.centres())
    assert mean == pytest.approx(mixture.weights @ mixture.means, abs=0.2)
    assert loaded.area.area == pytest.approx(shapely.area(quads).sum(), rel=1e-3)
    assert raster.grid.cell == pytest.approx(np.sqrt(shapely.area(quads).mean()), rel=1e-4)


@settings(max_examples=25, deadline=None)
@given(
    st.integers(1, 4),
    st.integers(1, 4),
    st.floats(-180.0, 180.0),
    st.floats(10.0, 40.0),
    st.integers(0, 2**32 - 1),
)
def test_the_warp_splits_each_cell_by_area(tmp_path_factory, rows, columns, turn, cell, seed):
    masses = np.random.default_rng(seed).random((rows, columns)) + 0.1
    transform = around("EPSG:27700", 20.0, columns, rows, turn)
    path = tmp_path_factory.mktemp("warp") / "map.tif"
    loaded = load_map(write_tif(path, masses, "EPSG:27700", transform), cell=cell)

    corners = corners_in_local("EPSG:27700", transform, rows, columns, loaded.frame)
    quads = shapely.polygons(
        np.stack(
            (corners[:-1, :-1], corners[:-1, 1:], corners[1:, 1:], corners[1:, :-1]), axis=2
        ).reshape(-1, 4, 2)
    )
    grid = loaded.pdm.grid
    x, y = np.meshgrid(grid.x_edges[:-1], grid.y_edges[:-1])
    boxes = shapely.box(x, y, x + grid.cell, y + grid.cell)
    share = shapely.area(shapely.intersection(boxes[..., None], quads)) / shapely.area(quads)
    expected = share @ (masses.ravel() / masses.sum())
    assert loaded.pdm.probability == pytest.approx(expected, abs=1e-9)


def test_the_origin_is_the_centre_and_north_is_up(tmp_path):
    values = np.zeros((5, 7))
    values[0, 6] = 1.0  # the north-east corner of a north-up file
    loaded = load_map(write_tif(tmp_path / "map.tif", values))
    raster = loaded.pdm
    east, north = np.einsum("ij,ijk->k", raster.probability, raster.grid.centres())
    assert (east, north) == pytest.approx((30.0, 20.0), abs=1.5)
    assert loaded.area.centroid.coords[0] == pytest.approx((0.0, 0.0), abs=0.1)
    assert loaded.source.endswith("map.tif")


@pytest.mark.parametrize("dtype", ["uint8", "int16", "uint32", "float32", "float64"])
def test_weights_of_any_type_are_normalised_with_a_note(tmp_path, dtype):
    values = np.array([[1, 2], [3, 4]], dtype=dtype)
    loaded = load_map(write_tif(tmp_path / "map.tif", values))
    assert loaded.pdm.probability.sum() == pytest.approx(1.0, abs=1e-12)
    assert any("sum to 10" in note for note in loaded.notes)


def test_scale_and_offset_of_the_band_are_applied(tmp_path):
    path = write_tif(tmp_path / "map.tif", np.array([[0, 20]], dtype="int16"))
    with rasterio.open(path, "r+") as dataset:
        dataset.scales, dataset.offsets = (0.1,), (2.0,)
    notes = load_map(path).notes
    assert any("sum to 6" in note for note in notes)  # 2 + (20 / 10 + 2)


@pytest.mark.parametrize(
    ("marked", "options"),
    [
        (-9999.0, {"nodata": -9999.0}),
        (np.nan, {"nodata": np.nan}),
        (np.nan, {}),
        (7.0, {"mask": np.array([[0, 255, 255]], dtype="uint8")}),
    ],
    ids=["nodata", "declared-nan", "undeclared-nan", "mask"],
)
def test_cells_without_data_weigh_nothing(tmp_path, marked, options):
    loaded = load_map(write_tif(tmp_path / "map.tif", np.array([[marked, 0.25, 0.75]]), **options))
    xmin, ymin, _, ymax = loaded.area.bounds
    assert loaded.pdm.integrate(shapely.box(xmin, ymin, xmin + 9.0, ymax)) < 0.01
    assert any(note.startswith("1 cells without data (33.3%)") for note in loaded.notes)
    assert loaded.pdm.probability.sum() == pytest.approx(1.0, abs=1e-12)


def test_a_band_and_a_cell_size_can_be_chosen(tmp_path):
    path = tmp_path / "bands.tif"
    with rasterio.open(
        path, "w", driver="GTiff", count=2, dtype="float32", width=4, height=4,
        crs="EPSG:32630", transform=from_origin(377_000, 6_293_000, 10, 10),
    ) as dataset:  # fmt: skip
        dataset.write(np.zeros((4, 4), dtype="float32"), 1)
        dataset.write(np.ones((4, 4), dtype="float32"), 2)
    loaded = load_map(path, band=2, cell=2.5)
    assert loaded.pdm.grid.cell == 2.5
    with pytest.raises(InvalidInput, match="all values are 0"):
        load_map(path, band=1)
    with pytest.raises(InvalidInput, match="has no band 3; choose one of 1 to 2"):
        load_map(path, band=3)
    with pytest.raises(InvalidInput, match="cell"):
        load_map(path, band=2, cell=1e-6)
    with pytest.raises(InvalidInput, match="cell"):
        load_map(path, band=2, cell=-1.0)


@pytest.mark.parametrize(
    ("dtype", "value"), [("float64", -1234567.5), ("int32", -2147483648), ("float32", -3.4e38)]
)
def test_the_remedy_for_undeclared_missing_data_works(tmp_path, dtype, value):
    path = tmp_path / "map.tif"
    write_tif(path, np.array([[3, value, 1]], dtype=dtype))
    with pytest.raises(InvalidInput) as caught:
        load_map(path)
    (marker,) = re.findall(r"-a_nodata (\S+)", str(caught.value))
    with rasterio.open(path, "r+") as dataset:
        dataset.nodata = float(marker)
    assert load_map(path).pdm.probability.sum() == pytest.approx(1.0)


def test_the_remedy_for_undeclared_missing_data_is_before_scale_and_offset(tmp_path):
    path = tmp_path / "map.tif"
    write_tif(path, np.array([[3, -9999, 1]], dtype="int16"))
    with rasterio.open(path, "r+") as dataset:
        dataset.scales, dataset.offsets = (0.5,), (1.0,)
    with pytest.raises(InvalidInput, match=r"-a_nodata -9999 "):
        load_map(path)


def test_a_raster_without_a_datum_is_not_moved_by_a_guess(tmp_path):
    """The British grid by its parameters; without its datum it would lie 77 m off."""
    grid = "+proj=tmerc +lat_0=49 +lon_0=-2 +k=0.9996012717 +x_0=400000 +y_0=-100000 +units=m"
    values, transform = np.ones((4, 4)), from_origin(216_000, 771_000, 10, 10)
    write_tif(tmp_path / "guessed.tif", values, crs=f"{grid} +ellps=airy", transform=transform)
    with pytest.raises(InvalidInput, match=r"names no datum.*gdal_edit.py -a_srs"):
        load_map(tmp_path / "guessed.tif")
    write_tif(tmp_path / "named.tif", values, crs=f"{grid} +datum=WGS84", transform=transform)
    assert "EPSG" not in " ".join(load_map(tmp_path / "named.tif").notes)


@pytest.mark.parametrize(
    ("values", "options", "message"),
    [
        (np.array([[1.0, -9999.0]]), {}, "1 values are negative.*gdal_edit.py -a_nodata -9999"),
        (np.array([[1.0, np.inf]]), {}, "1 values are infinite"),
        (np.zeros((2, 2)), {}, "all values are 0"),
        (np.full((2, 2), np.nan), {}, "all values are 0"),
        (np.ones((2, 2)), {"crs": None}, "no coordinate reference system.*gdal_edit.py -a_srs"),
        (np.ones((2, 2)), {"transform": Affine.identity()}, "no geotransform.*-a_ullr"),
        (np.ones((2, 2), dtype="complex64"), {}, "complex"),
        (
            np.ones((2, 2)),
            {"crs": "EPSG:4326", "transform": from_origin(-60.0, 60.0, 30.0, 30.0)},
            "km from its origin.*crop",
        ),
        (
            np.ones((2, 2)),
            {"crs": "EPSG:4326", "transform": from_origin(0.0, 400.0, 1.0, 1.0)},
            "check its CRS and geotransform",
        ),
    ],
    ids=["negative", "inf", "zero", "nan", "crs", "transform", "complex", "planet", "beyond"],
)
@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
def test_wrong_values_and_places_are_refused(tmp_path, values, options, message):
    path = write_tif(tmp_path / "wrong.tif", values, **options)
    with pytest.raises(InvalidInput, match=rf"wrong\.tif: (?s:.)*{message}"):
        load_map(path)


@pytest.mark.parametrize("column", [None, 0, 15], ids=["rim", "west", "east"])
@pytest.mark.parametrize(
    ("crs", "cell", "turn"),
    [
        pytest.param("EPSG:4326", (3e-3, 2e-3), 0.0, id="degrees"),
        pytest.param("EPSG:27700", 200.0, 25.0, id="turned"),
        pytest.param("EPSG:32630", 200.0, 0.0, id="utm"),
    ],
)
def test_coarse_cells_keep_their_mass_within_the_border(tmp_path, crs, cell, turn, column):
    rows, columns = 12, 16
    values = np.zeros((rows, columns))
    if column is None:
        values[0], values[:, 0] = 1.0, 1.0
    else:
        values[:, column] = np.arange(rows)
    transform = around(crs, cell, columns, rows, turn)
    loaded = load_map(write_tif(tmp_path / "map.tif", values, crs, transform))
    assert loaded.pdm.probability.sum() == pytest.approx(1.0, abs=1e-9)
    assert not any("border" in note for note in loaded.notes)
    corners = corners_in_local(crs, transform, rows, columns, loaded.frame)
    # The raster's outline and its northern half, from pyproj and shapely alone.
    for last in (rows, rows // 2):
        part = corners[: last + 1]
        outline = shapely.Polygon(
            np.concatenate((part[0], part[1:, -1], part[-1, -2::-1], part[-2:0:-1, 0]))
        )
        expected = values[:last].sum() / values.sum()
        assert loaded.pdm.integrate(outline) == pytest.approx(expected, abs=0.01)


@pytest.mark.parametrize(
    ("crs", "cell", "turn"),
    [("EPSG:4326", (3e-3, 2e-3), 0.0), ("EPSG:27700", 200.0, 45.0)],
    ids=["degrees", "turned"],
)
def test_a_coarse_cell_keeps_its_place(tmp_path, crs, cell, turn):
    values = np.zeros((12, 16))
    values[5, 4] = 1.0
    transform = around(crs, cell, 16, 12, turn)
    loaded = load_map(write_tif(tmp_path / "map.tif", values, crs, transform))
    corners = corners_in_local(crs, transform, 12, 16, loaded.frame)
    hot = shapely.Polygon(corners[[5, 5, 6, 6], [4, 5, 5, 4]])
    # In local cells as coarse as its own, about half of it would lie beside it.
    assert loaded.pdm.integrate(hot) == pytest.approx(1.0, abs=0.1)


def test_probability_smeared_over_the_border_is_said(tmp_path):
    path = write_tif(
        tmp_path / "map.tif", np.ones((12, 16)), "EPSG:27700",
        around("EPSG:27700", 200.0, 16, 12, 25.0),
    )  # fmt: skip
    loaded = load_map(path, cell=200.0)
    inside = loaded.pdm.integrate(loaded.area)
    assert 0.9 < inside < 0.99
    note = f"{inside:.3f} of the probability lies in the raster's footprint"
    assert any(found.startswith(note) for found in loaded.notes)


@pytest.mark.parametrize(
    ("values", "total"),
    [
        (np.full((3, 4), 1.5e308), "more than 1e308"),
        (np.full((3, 4), 5e-324), "5.92879e-323"),
    ],
    ids=["huge", "tiny"],
)
def test_values_whose_sum_is_no_number_are_normalised(tmp_path, values, total):
    loaded = load_map(write_tif(tmp_path / "map.tif", values))
    assert loaded.pdm.probability.sum() == pytest.approx(1.0, abs=1e-12)
    assert any(f"sum to {total}: divided" in note for note in loaded.notes)


def write_bands(path, values, **profile):
    with rasterio.open(
        path, "w", driver="GTiff", count=len(values), dtype=values.dtype,
        height=values.shape[1], width=values.shape[2],
        crs="EPSG:32630", transform=from_origin(377_000, 6_293_000, 10, 10), **profile,
    ) as dataset:  # fmt: skip
        dataset.write(values)
    return path


def test_a_picture_of_a_map_is_refused(tmp_path):
    path = write_bands(tmp_path / "rgb.tif", np.full((4, 4, 4), 200, "uint8"))
    for band, name in enumerate(("red", "green", "blue", "alpha"), 1):
        with pytest.raises(InvalidInput, match=f"band {band} holds the {name} channel, .* picture"):
            load_map(path, band=band)
    with rasterio.open(path, "r+") as dataset:
        dataset.colorinterp = [ColorInterp.undefined] * 4  # as the message says
    assert "band 2 of 4" in load_map(path, band=2).notes
    palette = write_bands(tmp_path / "palette.tif", np.ones((1, 4, 4), "uint8"))
    with rasterio.open(palette, "r+") as dataset:
        dataset.write_colormap(1, {1: (255, 0, 0, 255)})
    with pytest.raises(InvalidInput, match=r"band 1 holds a palette of colours.*raw values"):
        load_map(palette)


def test_which_of_several_bands_was_read_is_said(tmp_path):
    path = write_bands(tmp_path / "bands.tif", np.ones((3, 4, 4), "float32"))
    assert "band 1 of 3" in load_map(path).notes
    assert "band 3 of 3" in load_map(path, band=3).notes
    one = write_bands(tmp_path / "one.tif", np.ones((1, 4, 4), "float32"))
    assert not any("band" in note for note in load_map(one).notes)


def test_an_area_without_probability_is_refused(tmp_path):
    values = np.zeros((20, 20))
    values[:, 15:] = 1.0
    path = write_tif(tmp_path / "map.tif", values)
    ((lat0, lon0), (lat1, lon1)) = load_map(path).frame.to_geodetic([(-60.0, -60.0), (0.0, 60.0)])
    ring = [[lon0, lat0], [lon1, lat0], [lon1, lat1], [lon0, lat1], [lon0, lat0]]
    area = tmp_path / "area.geojson"
    area.write_text(json.dumps({"type": "Polygon", "coordinates": [ring]}))
    with pytest.raises(InvalidInput, match=r"area\.geojson: holds no probability of .*map\.tif"):
        load_map(path, area=area)


def test_broken_files_are_refused_in_one_line(tmp_path, capfd, caplog):
    caplog.set_level(logging.CRITICAL)
    whole = write_tif(tmp_path / "map.tif", np.random.default_rng(0).random((200, 200)))
    text, cut = tmp_path / "text.tif", tmp_path / "cut.tif"
    text.write_text("not a raster")
    cut.write_bytes(whole.read_bytes()[:10_000])
    for path in (text, cut):
        with pytest.raises(InvalidInput, match="not a readable GeoTIFF"):
            load_map(path)
    with pytest.raises(FileNotFoundError, match="no such file"):
        load_map(tmp_path / "none.tif")
    with pytest.raises(InvalidInput, match=r"suffix '\.shp' is not one of \.tif"):
        load_map(tmp_path / "map.shp")
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize("name", ["01", "06"])
def test_real_maps_load_with_all_their_mass(name):
    path = SARENV / f"{name}.tif"
    if not path.exists():
        pytest.skip("the SAREnv maps are not here")
    loaded = load_map(path)
    assert loaded.pdm.probability.sum() == pytest.approx(1.0, abs=1e-9)
    assert loaded.pdm.grid.cell == pytest.approx(30.0, rel=1e-3)
    with rasterio.open(path) as dataset:
        values, bounds = dataset.read(1).astype(float), dataset.bounds
    # The mass of the quarter nearest the last known position, by the file and by us.
    rows, columns = values.shape
    middle = values[rows // 4 : -(rows // 4), columns // 4 : -(columns // 4)].sum()
    lon, lat = pyproj.Transformer.from_crs(dataset.crs.to_wkt(), 4326, always_xy=True).transform(
        bounds.left + np.array([columns // 4, columns - columns // 4]) * 30.0,
        bounds.bottom + np.array([rows // 4, rows - rows // 4]) * 30.0,
    )
    (x0, y0), (x1, y1) = loaded.frame.to_local(lat, lon)
    assert loaded.pdm.integrate(shapely.box(x0, y0, x1, y1)) == pytest.approx(middle, abs=0.01)
