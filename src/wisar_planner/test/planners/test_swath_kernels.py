import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from numba.core.errors import TypingError

from wisar_planner import GaussianMixture, SearchArea, SearchProblem
from wisar_planner.planners.cell_vectors import PERIODS
from wisar_planner.planners.search_raster import COARSE, FINE, SearchRaster
from wisar_planner.planners.swath_kernels import (
    ADD,
    MEASURE,
    REMOVE,
    Canvas,
    count_path,
    most_weight,
    paint,
    paint_path,
    path_value,
)

COORDINATE = st.floats(-5.0, 35.0, allow_subnormal=False).map(lambda x: round(x, 6))


def covered(ends, radius, shape):
    """Return which cells lie within the radius of a segment; None where one is on the very edge."""
    y, x = np.mgrid[: shape[0], : shape[1]]
    segment = shapely.LineString([ends[:2], ends[2:]])
    distance = shapely.distance(segment, shapely.points(x, y))
    return None if (np.abs(distance - radius) < 1e-6).any() else distance < radius


@settings(max_examples=150, deadline=None)
@given(
    ends=st.tuples(COORDINATE, COORDINATE, COORDINATE, COORDINATE),
    radius=st.floats(0.3, 9.0),
    period=st.integers(0, PERIODS - 1),
    seed=st.integers(0, 1000),
)
def test_paint_agrees_with_the_distance_to_the_segment(ends, radius, period, seed):
    rng = np.random.default_rng(seed)
    weights = rng.integers(0, 1 << 20, (30, 27)).astype(np.int32)
    seen = rng.random((PERIODS, 30, 27)) < 0.2
    canvas = Canvas.of(weights)
    counts = canvas.counts
    for period_seen, shift in zip(seen, range(0, 32, 8), strict=True):
        counts += period_seen.astype(np.uint32) << shift
    before = counts.copy()
    swath = covered(ends, radius, counts.shape)
    if swath is None:
        return
    until = np.logical_or.accumulate(seen, axis=0)  # seen until the end of each period
    gains = [int(weights[swath & ~until[p]].sum()) if p >= period else 0 for p in range(PERIODS)]
    tally = np.zeros(PERIODS, np.int64)
    args = (canvas, *ends, radius, period)
    assert paint(*args, MEASURE, tally) == gains[-1]
    assert not tally.any()
    np.testing.assert_array_equal(counts, before)
    assert paint(*args, ADD, tally) == gains[-1]
    np.testing.assert_array_equal(tally, gains)
    assert paint(*args, REMOVE, tally) == -gains[-1]
    np.testing.assert_array_equal(tally, 0)
    np.testing.assert_array_equal(counts, before)


def test_tally_of_a_path_is_what_its_beginnings_see():
    rng = np.random.default_rng(4)
    weights = rng.integers(0, 1 << 20, (60, 60)).astype(np.int32)
    points = rng.uniform(10, 50, (17, 2))
    canvas, tally = Canvas.of(weights), np.zeros(PERIODS, np.int64)
    paint_path(canvas, points, 0, 16, 2.3, ADD, tally)
    for steps, total in zip((2, 6, 12, 16), tally, strict=True):
        seen = np.zeros((60, 60), bool)
        for i in range(steps):
            seen |= covered((*points[i], *points[i + 1]), 2.3, seen.shape)
        assert total == weights[seen].sum()
    assert path_value(tally, 0.3) == tally[3] + 0.1 * tally[:3].sum()
    painted = canvas.counts.copy()
    count_path(canvas, points, 3, 12, 2.3, REMOVE)
    assert (canvas.counts != painted).any()
    count_path(canvas, points, 3, 12, 2.3, ADD)
    np.testing.assert_array_equal(canvas.counts, painted)
    paint_path(canvas, points, 0, 16, 2.3, REMOVE, tally)
    assert not canvas.counts.any()
    assert not tally.any()


def test_sums_hold_the_heaviest_swaths():
    # The weights of all cells are the greatest allowed; swaths as `SearchRaster` foresees them.
    for step, radius in ((11.2, 6.99), (9.6, 12.0), (3.0, 60.0), (40.0, 2.0)):
        side = 2 * int(step + 2.0 * radius + 2.0)
        canvas = Canvas.of(np.full((side, side), most_weight(step, radius), np.int32))
        middle = 0.5 * side
        for turn in np.linspace(0.0, np.pi, 7):
            end = middle + step * np.cos(turn), middle + step * np.sin(turn)
            gain = paint(canvas, middle, middle, *end, radius, 0, MEASURE, np.zeros(4, np.int64))
            swath = covered((middle, middle, *end), radius, canvas.counts.shape)
            if swath is not None:
                assert gain == canvas.weights[swath].sum(dtype=np.int64)


def test_a_canvas_that_the_kernels_would_misread_is_refused():
    with pytest.raises(ValueError, match="8 cells at least"):
        Canvas.of(np.ones((1, 7), np.int32))
    wide = Canvas.of(np.ones((9, 9), np.int32))._replace(weights=np.ones((9, 9), np.int64))
    with pytest.raises(TypingError, match="contiguous array of int32"):
        paint(wide, 2.0, 2.0, 5.0, 5.0, 1.0, 0, ADD, np.zeros(PERIODS, np.int64))


def problem(polygon):
    centre = polygon.representative_point()
    return SearchProblem(
        pdm=GaussianMixture(np.ones(1), [[centre.x, centre.y]], 400.0 * np.eye(2)[None]),
        area=SearchArea.from_polygon(polygon),
        start=np.array([centre.x, centre.y]),
        step_length=8.0,
        swath_radius=2.5,
        max_distance=200.0,
    )


def test_raster_holds_the_map_with_a_margin_for_the_swath():
    rectangle = problem(shapely.box(0, 0, 100, 60))
    for fineness in (COARSE, FINE):
        raster = SearchRaster(rectangle, fineness)
        assert raster.radius == np.float64(fineness)
        xmin, ymin, xmax, ymax = raster.grid.bounds
        assert xmin <= -2.5
        assert ymin <= -2.5
        assert xmax >= 102.5
        assert ymax >= 62.5
        mass = rectangle.pdm.rasterize(raster.grid)
        np.testing.assert_allclose(raster.canvas.weights * raster.unit, mass, atol=raster.unit)


def test_wide_worlds_get_coarser_cells_and_only_what_is_in_reach():
    wide = SearchProblem(
        pdm=GaussianMixture(np.ones(1), np.array([[0.0, 0.0]]), 1e6 * np.eye(2)[None]),
        area=SearchArea.rectangle(-1e5, -1e5, 1e5, 1e5),
        start=np.zeros(2),
        step_length=8.0,
        swath_radius=2.5,
        max_distance=500.0,
    )
    near = SearchRaster(wide, COARSE)
    assert near.grid.bounds[2] < 510.0
    far = SearchRaster(SearchProblem(wide.pdm, wide.area, wide.start, 8.0, 2.5, 5e4), COARSE)
    assert far.canvas.weights.size < 1.01 * (1 << 22)
    assert far.radius < COARSE
