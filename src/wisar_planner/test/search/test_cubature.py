import numpy as np
import pytest
import shapely
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.special import roots_jacobi

from wisar_planner.errors import InvalidInput
from wisar_planner.pdm import GaussianMixture, Grid, RasterMap
from wisar_planner.pdm.closed_form import mixture_in_polygon
from wisar_planner.search import SearchPath, SearchProblem
from wisar_planner.search.cubature import (
    gauss_jacobi,
    integrate_by_cubature,
    seen_probability_by_cubature,
)

MIXTURE = GaussianMixture(
    [0.3, 0.7], [[5, 5], [30, 10]], [[[40, 25], [25, 30]], [[200, -50], [-50, 90]]]
)


def random_path(seed, steps=64):
    problem = SearchProblem.paper(np.random.default_rng(seed))
    angles = np.random.default_rng(seed + 1).uniform(0, 2 * np.pi, steps)
    moves = 8.0 * np.column_stack([np.cos(angles), np.sin(angles)])
    points = np.concatenate([[problem.start], problem.start + np.cumsum(moves, axis=0)])
    return problem.pdm, SearchPath(points, 2.5)


@pytest.mark.parametrize("seed", range(4))
def test_cubature_closed_form_and_boundary_integral_agree_on_paths(seed):
    pdm, path = random_path(seed)
    polygon = path.seen_area()
    closed = mixture_in_polygon(pdm, polygon)
    result = integrate_by_cubature(pdm, polygon, 1e-10)
    assert result.error <= 1e-10
    assert result.value == pytest.approx(closed, abs=1e-11)
    assert pdm.integrate(polygon) == pytest.approx(closed, abs=1e-12)


@given(st.floats(-20, 60), st.floats(-20, 40), st.floats(0.5, 60), st.floats(0.5, 60))
@settings(max_examples=40)
@example(14.0, -3.0, 10.0, 31.0)  # Both rules once were wrong alike here.
def test_boxes_with_holes(x, y, width, height):
    box = shapely.box(x, y, x + width, y + height)
    hole = shapely.affinity.scale(box, 0.4, 0.3)
    parts = shapely.MultiPolygon([box.difference(hole), shapely.box(200, 200, 210, 220)])
    result = integrate_by_cubature(MIXTURE, parts, 1e-10)
    assert result.value == pytest.approx(mixture_in_polygon(MIXTURE, parts), abs=1e-10)


def test_a_coarse_tolerance_takes_fewer_triangles_and_holds():
    box = shapely.box(-20, -20, 60, 40)
    exact = mixture_in_polygon(MIXTURE, box)
    counts = []
    for tolerance in (1e-2, 1e-5, 1e-9):
        result = integrate_by_cubature(MIXTURE, box, tolerance)
        assert abs(result.value - exact) <= tolerance
        counts.append(result.triangles)
    assert counts[0] < counts[1] < counts[2]


def test_narrow_peaks_are_refined():
    pdm = GaussianMixture([1.0], [[51.3, 48.9]], [0.2 * np.eye(2)])
    box = shapely.box(0, 0, 150, 150)
    near = integrate_by_cubature(pdm, shapely.box(45, 45, 56, 56), 1e-9)
    assert near.value == pytest.approx(1.0, abs=1e-9)
    assert pdm.integrate(box) == pytest.approx(1.0, abs=1e-13)


def test_a_raster_is_integrated_exactly():
    raster = RasterMap([[0.1, 0.2], [0.3, 0.4]], Grid(0, 0, 10.0, 2, 2))
    path = SearchPath([[2, 2], [15, 15]], 2.0)
    assert seen_probability_by_cubature(path, raster) == raster.integrate(path.seen_area())


def test_seen_probability_by_cubature_is_that_of_the_true_arcs_but_for_the_polygon():
    pdm, path = random_path(7)
    assert seen_probability_by_cubature(path, pdm) == pytest.approx(
        path.seen_probability(pdm), rel=1.6e-3
    )
    fine = path.seen_area(quad_segs=200)
    assert seen_probability_by_cubature(fine, pdm, 1e-9) == pytest.approx(
        path.seen_probability(pdm), rel=1e-5
    )


def test_bad_input_is_named():
    box = shapely.box(0, 0, 50, 50)
    with pytest.raises(InvalidInput, match="tolerance"):
        integrate_by_cubature(MIXTURE, box, 0.0)
    with pytest.raises(InvalidInput, match="tolerance"):
        integrate_by_cubature(MIXTURE, box, 1e-14, max_triangles=50)
    with pytest.raises(InvalidInput, match="polygon"):
        integrate_by_cubature(MIXTURE, shapely.LineString([(0, 0), (1, 1)]))
    assert integrate_by_cubature(MIXTURE, shapely.Polygon()).value == 0.0


@pytest.mark.parametrize("n", [2, 3, 5, 8])
def test_the_rule_with_a_shrinking_width_is_scipys(n):
    for ours, theirs in zip(gauss_jacobi(n), roots_jacobi(n, 1.0, 0.0), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-13)
