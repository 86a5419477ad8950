import math

import numpy as np
import pytest

from wisar_planner.errors import InvalidInput
from wisar_planner.pdm import GaussianMixture, Grid, RasterMap
from wisar_planner.search import SearchArea, SearchPath, SearchProblem
from wisar_planner.search.path import walking_distances

PDM = GaussianMixture([1.0], [[10.0, 5.0]], [[[60.0, 20.0], [20.0, 40.0]]])
PATH = SearchPath([[0, 0], [8, 0], [8, 6], [0, 6], [4, -3]], 2.0, planner="drawn")


def test_lengths_and_positions():
    assert PATH.length == pytest.approx(8 + 6 + 8 + math.hypot(4, 9))
    np.testing.assert_allclose(PATH.distances[:4], [0, 8, 14, 22])
    np.testing.assert_allclose(PATH.point_at([-1, 4, 11, 1e6]), [[0, 0], [4, 0], [8, 3], [4, -3]])
    assert PATH.waypoints.dtype == np.float64
    with pytest.raises(ValueError, match="read-only"):
        PATH.waypoints[0, 0] = 1.0


def test_truncated_keeps_the_first_metres():
    cut = PATH.truncated(11.0)
    np.testing.assert_allclose(cut.waypoints, [[0, 0], [8, 0], [8, 3]])
    assert (cut.length, cut.planner) == (11.0, "drawn")
    np.testing.assert_allclose(PATH.truncated(8.0).waypoints, [[0, 0], [8, 0]])
    assert PATH.truncated(1e3) is PATH
    assert len(PATH.truncated(0.0).waypoints) == 1


def test_probability_at_waypoints_accumulates_to_the_whole():
    seen = PATH.probability_at_waypoints(PDM)
    assert seen.shape == (5,)
    assert (np.diff(seen) >= 0).all()
    for i in range(5):
        part = SearchPath(PATH.waypoints[: i + 1], PATH.swath_radius)
        assert seen[i] == pytest.approx(part.seen_probability(PDM), abs=1e-11)


def test_probability_over_distance_is_that_of_the_truncated_path():
    distances = [31.7, 0.0, 8.0, 3.3, 26.0, 500.0]
    seen = PATH.probability_over_distance(PDM, distances)
    for d, p in zip(distances, seen, strict=True):
        assert p == pytest.approx(PATH.truncated(d).seen_probability(PDM), abs=1e-10)


def test_walking_distances_are_the_papers():
    np.testing.assert_allclose(walking_distances(512.0), np.arange(51) * 10.24)
    with pytest.raises(InvalidInput, match="steps"):
        walking_distances(512.0, 0)


def test_efficiency_divides_by_the_mass_in_the_area():
    problem = SearchProblem(PDM, SearchArea.rectangle(0, 0, 12, 10), (1, 1), 8.0, 2.0, 50.0)
    assert problem.steps == 6
    assert PATH.probability_efficiency(problem) == pytest.approx(
        PATH.seen_probability(PDM) / PDM.integrate(problem.area.polygon)
    )


def test_a_raster_of_one_cell_measures_the_area():
    raster = RasterMap([[1.0]], Grid(-50, -50, 100.0, 1, 1))
    path = SearchPath([[0, 0], [10, 0]], 2.0)
    assert path.seen_probability(raster) * 1e4 == pytest.approx(40 + 4 * math.pi, rel=1e-11)
    assert SearchPath([[3, 3]], 2.0).seen_probability(raster) * 1e4 == pytest.approx(4 * math.pi)
    assert path.seen_area().area == pytest.approx(40 + 4 * math.pi, rel=1e-3)


@pytest.mark.parametrize(
    ("waypoints", "radius", "named"),
    [
        ([], 1.0, "waypoints"),
        ([[0, 0, 0]], 1.0, "waypoints"),
        ([[0, 0], [math.nan, 1]], 1.0, "waypoints"),
        ([[0, 0], [1, 1], [1, 1]], 1.0, r"waypoints\[2\]"),
        ([[0, 0], [1, 1]], 0.0, "swath_radius"),
        ([[0, 0], [1, 1]], math.inf, "swath_radius"),
    ],
)
def test_bad_paths_are_named(waypoints, radius, named):
    with pytest.raises(InvalidInput, match=named):
        SearchPath(waypoints, radius)


def test_other_bad_arguments_are_named():
    with pytest.raises(InvalidInput, match="transit_length"):
        SearchPath([[0, 0]], 1.0, transit_length=-1.0)
    with pytest.raises(InvalidInput, match="max_distance"):
        PATH.truncated(-1.0)
    with pytest.raises(InvalidInput, match="distances"):
        PATH.probability_over_distance(PDM, [math.nan])
