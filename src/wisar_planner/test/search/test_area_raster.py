"""The area on a raster, against shapely."""

import numpy as np
import shapely
from hypothesis import given
from hypothesis import strategies as st

from wisar_planner import Grid
from wisar_planner.search.area_raster import AreaRaster, inside


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
