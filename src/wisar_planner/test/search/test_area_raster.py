"""The area on a raster, against shapely."""

import numpy as np
import shapely
from hypothesis import given
from hypothesis import strategies as st

from wisar_planner import Grid, SearchArea
from wisar_planner.search.area_raster import AreaRaster, inside, leg_inside


def test_points_are_inside_where_the_polygon_holds_them():
    angles, radii = np.linspace(0, 2 * np.pi, 30)[:-1], [45, 20, 33] * 10
    star = shapely.Polygon(
        [(50 + r * np.cos(t), 50 + r * np.sin(t)) for t, r in zip(angles, radii, strict=False)]
    ).difference(shapely.box(45, 40, 58, 47))
    grid = Grid(-3.0, -2.0, 1.3, 90, 80)
    area = AreaRaster.of(star, grid)
    points = np.random.default_rng(3).uniform(-10, 120, (6000, 2))
    cells = (points - (grid.x0, grid.y0)) / grid.cell - 0.5
    ours = [inside(area, x, y) for x, y in cells]
    np.testing.assert_array_equal(ours, shapely.contains_xy(star, points))


@given(
    corners=st.lists(
        st.tuples(st.floats(-20.0, 120.0), st.floats(-20.0, 90.0)), min_size=3, max_size=9
    ),
    hole=st.booleans(),
)
def test_cells_are_inside_whose_centre_is(corners, hole):
    polygon = shapely.MultiPoint(corners).convex_hull.buffer(3.0)
    if hole:
        polygon = polygon.difference(polygon.centroid.buffer(7.0))
    grid = Grid(-5.3, 2.1, 1.7, 64, 48)
    expected = shapely.contains_xy(polygon, *np.moveaxis(grid.centres(), -1, 0))
    np.testing.assert_array_equal(AreaRaster.of(polygon, grid).centres_inside(), expected)


@given(
    ends=st.lists(
        st.tuples(st.floats(0.0, 100.0), st.floats(0.0, 70.0)).map(
            lambda p: (round(p[0], 3) + 1e-4, round(p[1], 3) + 2e-4)
        ),
        min_size=2,
        max_size=12,
    ),
    shape=st.sampled_from(["wall", "L", "parts", "box"]),
)
def test_legs_are_inside_that_the_area_covers(ends, shape):
    """Compiled, by shapely's cover, and by the area itself; walls may be thinner than a cell."""
    box = shapely.box(0.0, 0.0, 100.0, 70.0)
    polygon = {
        "wall": box.difference(shapely.box(40.0, 10.0, 40.4, 60.0)),
        "L": box.difference(shapely.box(50.0, 30.0, 101.0, 71.0)),
        "parts": box.difference(shapely.box(30.0, -1.0, 31.0, 71.0)),
        "box": box,
    }[shape]
    area, grid = SearchArea.from_polygon(polygon), Grid(-5.3, -4.1, 1.7, 64, 48)
    raster = AreaRaster.of(polygon, grid)
    assert raster.convex == area.convex == (shape == "box")
    points = np.array(ends)[area.contains(ends)]
    cells = (points - (grid.x0, grid.y0)) / grid.cell - 0.5
    for start, cell in zip(points, cells, strict=True):
        legs = shapely.linestrings([[start, end] for end in points])
        expected = shapely.covers(polygon, legs)
        ours = [leg_inside(raster, *cell, *end) for end in cells]
        np.testing.assert_array_equal(ours, expected)
        np.testing.assert_array_equal(area.contains_legs(start, points), expected)


def test_a_leg_may_begin_on_the_border():
    box = shapely.box(0.0, 0.0, 100.0, 70.0).difference(shapely.box(40.0, 10.0, 60.0, 60.0))
    shrunk = AreaRaster.of(box.buffer(-1e-6), Grid(-5.5, -5.5, 1.0, 112, 82))
    # In the cells of this grid, x and y are those in metres and 5.
    assert leg_inside(shrunk, 5.0, 40.0, 13.0, 40.0)
    assert leg_inside(shrunk, 65.0, 40.0, 73.0, 43.0)
    assert not leg_inside(shrunk, 65.0, 40.0, 43.0, 40.0)
    area = SearchArea.from_polygon(box)
    assert area.contains_legs([60.0, 35.0], [[68.0, 35.0], [38.0, 35.0]]).tolist() == [True, False]
