import math
import tracemalloc

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from wisar_planner.errors import InvalidInput
from wisar_planner.pdm import Grid, RasterMap, raster_map


def example(seed=0, rows=7, columns=9, cell=3.0):
    probability = np.random.default_rng(seed).random((rows, columns))
    return RasterMap(0.9 * probability / probability.sum(), Grid(-4.0, 2.0, cell, columns, rows))


def by_cells(raster, polygon):
    """The integral as Shapely sees it: every cell by the share of it in the polygon."""
    grid = raster.grid
    x, y = np.meshgrid(grid.x_edges[:-1], grid.y_edges[:-1])
    cells = shapely.box(x, y, x + grid.cell, y + grid.cell)
    shares = shapely.area(shapely.intersection(cells, polygon)) / grid.cell**2
    return float((shares * raster.probability).sum())


@st.composite
def polygons(draw):
    number = st.one_of(st.floats(-15, 40), st.integers(-5, 10).map(lambda k: 3.0 * k - 4.0))
    points = draw(st.lists(st.tuples(number, number), min_size=3, max_size=7))
    shape = shapely.MultiPoint(points).convex_hull
    if shape.area < 1e-6:
        shape = shapely.box(*shape.bounds).buffer(1.0, join_style="mitre")
    inner = shape.buffer(-0.2 * math.sqrt(shape.area))
    return shape.difference(inner) if draw(st.booleans()) else shape


@given(polygons())
def test_integral_agrees_with_the_intersection_of_cells(polygon):
    raster = example()
    assert raster.integrate(polygon) == pytest.approx(by_cells(raster, polygon), abs=1e-12)


@given(st.floats(-10, 30), st.floats(-10, 30), st.floats(0.1, 20), st.floats(0, 6))
def test_disc_of_arcs_agrees_with_a_fine_polygon(x, y, radius, turn):
    raster = example()
    arcs = np.array(
        [[x, y, turn, turn + 4.0, radius], [x, y, turn + 4.0, turn + 2 * math.pi, radius]]
    )
    got = raster.integrate_boundary(arcs, np.zeros(2, np.int64), 1)[0]
    # The polygon lacks (pi / 2 / 512)^2 / 6 of the disc's area.
    missing = raster.probability.max() / 9.0 * math.pi * radius**2 * 1.6e-6
    expected = by_cells(raster, shapely.Point(x, y).buffer(radius, quad_segs=512))
    assert expected - 1e-12 <= got <= expected + missing + 1e-12


def test_an_arc_reversed_is_the_negative():
    raster = example()
    arc = np.array([[3.0, 9.0, 0.2, 3.9, 5.0]])
    back = np.array([[3.0, 9.0, 3.9, 0.2, 5.0]])
    owner = np.zeros(1, np.int64)
    assert raster.integrate_boundary(arc, owner, 1) == -raster.integrate_boundary(back, owner, 1)


def test_discs_tangent_to_cell_borders():
    raster = example()
    for x, y, radius in ((-4.0, 2.0, 3.0), (2.0, 8.0, 6.0), (3.5, 9.5, 1.5), (-4.0, 23.0, 3.0)):
        arcs = np.array(
            [[x, y, -math.pi / 2, math.pi / 2, radius], [x, y, math.pi / 2, 1.5 * math.pi, radius]]
        )
        got = raster.integrate_boundary(arcs, np.zeros(2, np.int64), 1)[0]
        expected = by_cells(raster, shapely.Point(x, y).buffer(radius, quad_segs=512))
        assert got == pytest.approx(expected, rel=2e-6)


def test_everything_holds_the_total_as_given():
    raster = example()
    assert raster.integrate(shapely.box(-99, -99, 99, 99)) == pytest.approx(0.9, abs=1e-14)


def test_density_is_probability_over_area_and_zero_outside():
    raster = example()
    points = [[-3.9, 2.1], [-4.0, 2.0], [22.9, 22.9], [23.0, 23.0], [-4.1, 5.0], [0.0, 99.0]]
    expected = (
        np.array([raster.probability[0, 0]] * 2 + [raster.probability[6, 8]] * 2 + [0, 0]) / 9.0
    )
    np.testing.assert_allclose(raster.density(points), expected)


@given(st.floats(0.4, 20.0), st.floats(-3, 3), st.floats(-3, 3))
def test_rasterize_keeps_mass_at_any_resolution(cell, dx, dy):
    raster = example()
    xmin, ymin, xmax, ymax = raster.bounds
    grid = Grid.covering((xmin - 4 + dx, ymin - 4 + dy, xmax + 4, ymax + 4), cell)
    new = raster.rasterize(grid)
    assert new.shape == (grid.rows, grid.columns)
    assert new.sum() == pytest.approx(0.9, abs=1e-12)
    row, column = grid.rows // 2, grid.columns // 2
    box = shapely.box(
        grid.x_edges[column], grid.y_edges[row], grid.x_edges[column + 1], grid.y_edges[row + 1]
    )
    assert new[row, column] == pytest.approx(by_cells(raster, box), abs=1e-12)


@pytest.mark.parametrize("cell", [0.7, 4.1])
def test_a_grid_that_hangs_over_gets_what_its_cells_cover(cell):
    raster = example()
    grid = Grid(1.5, -6.0, cell, 9, 12)
    x, y = np.meshgrid(grid.x_edges[:-1], grid.y_edges[:-1])
    cells = shapely.box(x, y, x + cell, y + cell).ravel()
    expected = np.reshape([by_cells(raster, each) for each in cells], x.shape)
    np.testing.assert_allclose(raster.rasterize(grid), expected, rtol=0, atol=1e-13)


@pytest.mark.parametrize("x0", [-50.0, 50.0])
def test_a_grid_apart_from_the_map_gets_nothing(x0):
    assert not example().rasterize(Grid(x0, 2.0, 3.0, 4, 3)).any()


def test_rasterize_on_its_own_grid_is_the_map():
    raster = example()
    np.testing.assert_allclose(raster.rasterize(raster.grid), raster.probability, atol=1e-15)


def test_samples_follow_the_cells():
    raster = example(rows=3, columns=4)
    count = 60_000
    points = raster.sample(count, np.random.default_rng(5))
    cells = np.floor((points - (-4.0, 2.0)) / 3.0).astype(int)
    drawn = np.zeros((3, 4))
    np.add.at(drawn, (cells[:, 1], cells[:, 0]), 1.0 / count)
    np.testing.assert_allclose(drawn, raster.probability / 0.9, atol=0.01)
    inside = (points - (-4.0, 2.0)) / 3.0 - cells
    np.testing.assert_allclose(inside.mean(axis=0), 0.5, atol=0.01)


def drawn_at_once(raster, count, rng):
    """The draws with all their noise in memory."""
    rows = np.log(raster.probability.sum(axis=1)) + rng.gumbel(size=(count, raster.grid.rows))
    rows = rows.argmax(axis=1)
    noise = rng.gumbel(size=(count, raster.grid.columns))
    columns = (np.log(raster.probability)[rows] + noise).argmax(axis=1)
    cells = np.column_stack([columns, rows]) + rng.random((count, 2))
    return (raster.grid.x0, raster.grid.y0) + cells * raster.grid.cell


@pytest.mark.parametrize("most", [1, 40, 700, 10**7])
@pytest.mark.parametrize("count", [0, 1, 333])
def test_draws_in_pieces_are_the_draws_at_once(monkeypatch, most, count):
    monkeypatch.setattr(raster_map, "_MOST_NOISE", most)
    raster, first, second = example(), np.random.default_rng(8), np.random.default_rng(8)
    np.testing.assert_array_equal(raster.sample(count, first), drawn_at_once(raster, count, second))
    assert first.random() == second.random()


def test_many_draws_on_a_large_raster_take_little_memory(monkeypatch):
    monkeypatch.setattr(raster_map, "_MOST_NOISE", 10_000)
    raster = example(rows=500, columns=400)
    tracemalloc.start()
    raster.sample(5000, np.random.default_rng(0))
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    # All the noise of the rows would be 20 MB; the logarithms of the cells are 1.6.
    assert peak < 4e6


def test_empty_cells_are_never_drawn():
    probability = np.zeros((5, 6))
    probability[3, 2] = 1.0
    points = RasterMap(probability, Grid(0, 0, 1.0, 6, 5)).sample(500, np.random.default_rng(0))
    assert (np.floor(points) == (2, 3)).all()


def test_most_probable_mass_takes_the_densest_cells():
    raster = RasterMap([[0.1, 0.2], [0.3, 0.4]], Grid(0, 0, 2.0, 2, 2))
    everywhere = shapely.box(-1, -1, 9, 9)
    assert raster.most_probable_mass(everywhere, 6.0) == pytest.approx(0.4 + 0.15)
    assert raster.most_probable_mass(everywhere, 100.0) == pytest.approx(1.0)
    half = shapely.box(0, 0, 4, 3)  # Half of the upper row.
    assert raster.most_probable_mass(half, 4.0) == pytest.approx(0.2 + 0.15)


@pytest.mark.parametrize(
    ("probability", "named"),
    [
        ([[0.5, -0.1]], "probability"),
        ([[math.nan, 0.1]], "probability"),
        ([[0.0, 0.0]], "probability"),
        ([[0.9, 0.9]], "probability"),
        ([[0.5], [0.5]], "probability"),
    ],
)
def test_bad_rasters_are_named(probability, named):
    with pytest.raises(InvalidInput, match=named):
        RasterMap(probability, Grid(0, 0, 1.0, 2, 1))


def test_bad_grids_are_named():
    with pytest.raises(InvalidInput, match="cell"):
        Grid(0, 0, 0.0, 1, 1)
    with pytest.raises(InvalidInput, match="columns"):
        Grid(0, 0, 1.0, 0, 1)
    with pytest.raises(InvalidInput, match="x0"):
        Grid(math.nan, 0, 1.0, 1, 1)
    with pytest.raises(InvalidInput, match="bounds"):
        Grid.covering((1, 0, 0, 1), 1.0)


def test_grid_covers_and_knows_its_centres():
    grid = Grid.covering((0, 0, 10, 4.5), 2.0)
    assert (grid.columns, grid.rows) == (5, 3)
    assert grid.bounds == (0, 0, 10, 6)
    np.testing.assert_allclose(grid.centres()[2, 1], (3.0, 5.0))
    assert Grid.covering((0, 0, 0.3, 0.1 * 3), 0.1).rows == 3
