import numpy as np
import pytest

from wisar_planner import GaussianMixture, SearchArea, SearchProblem, make_planner


@pytest.fixture
def peak():
    """One peak in the middle of a wide area; the start to its south-west."""
    return SearchProblem(
        pdm=GaussianMixture(np.ones(1), np.array([[500.0, 500.0]]), 2500.0 * np.eye(2)[None]),
        area=SearchArea.rectangle(0.0, 0.0, 1000.0, 1000.0),
        start=np.array([100.0, 100.0]),
        step_length=20.0,
        swath_radius=5.0,
        max_distance=1200.0,
    )


def corners(path):
    legs = np.diff(path.waypoints, axis=0)
    turn = legs[:-1, 0] * legs[1:, 1] - legs[:-1, 1] * legs[1:, 0]
    at = np.flatnonzero(np.abs(turn) > 1e-6 * np.hypot(*legs[:-1].T))
    return np.concatenate([path.waypoints[:1], path.waypoints[at + 1], path.waypoints[-1:]])


def test_expanding_square_by_hand(peak):
    path = make_planner("expanding_square", track_spacing=30.0).plan(peak)
    vertices = corners(path)
    np.testing.assert_allclose(vertices[0], (500, 500), atol=5.0)
    steps = np.diff(vertices, axis=0)[:6]
    # North 1, east 1, south 2, west 2, north 3, east 3 spacings: right turns throughout.
    expected = [(0, 30), (30, 0), (0, -60), (-60, 0), (0, 90), (90, 0)]
    np.testing.assert_allclose(steps, expected, atol=1e-9)
    assert path.length == pytest.approx(1200.0)


def test_expanding_square_takes_a_heading(peak):
    vertices = corners(make_planner("expanding_square", heading=0.0).plan(peak))
    np.testing.assert_allclose(np.diff(vertices, axis=0)[:2], [(10, 0), (0, -10)], atol=1e-9)


def test_sector_by_hand(peak):
    path = make_planner("sector", radius=60.0).plan(peak)
    datum = path.waypoints[0]
    # Every second and third corner lies on the circle; the legs through the datum are straight.
    vertices = corners(path)
    r = np.hypot(*(vertices - datum).T)
    np.testing.assert_allclose(r[:8], [0, 60, 60, 60, 60, 60, 60, 0], atol=1e-6)
    np.testing.assert_allclose(vertices[1] - datum, (0, 60), atol=1e-9)
    np.testing.assert_allclose(
        vertices[2] - datum, (60 * np.sqrt(0.75), 30), atol=1e-9
    )  # right turn of 120 degrees
    # The second pattern sets out 30 degrees to the right of the first.
    out = vertices[8] - datum
    assert np.degrees(np.arctan2(out[1], out[0])) == pytest.approx(60.0)


def test_one_sector_pattern_takes_the_whole_budget_by_default(peak):
    path = make_planner("sector").plan(peak)
    assert path.length == pytest.approx(1200.0)
    np.testing.assert_allclose(path.waypoints[-1], path.waypoints[0], atol=1e-6)


def test_creeping_line_creeps_over_the_heavier_side(peak):
    pdm = GaussianMixture(
        np.array([0.5, 0.5]),
        np.array([[500.0, 500.0], [500.0, 570.0]]),
        np.array([900.0 * np.eye(2), 1200.0 * np.eye(2)]),
    )
    problem = SearchProblem(pdm, peak.area, peak.start, 20.0, 5.0, 1200.0)
    path = make_planner("creeping_line", track_spacing=20.0, leg_length=100.0).plan(problem)
    vertices = corners(path)
    # From the western end, nearer to the start, of a leg through the datum; then northward.
    datum = 0.5 * (vertices[0] + vertices[1])
    np.testing.assert_allclose(vertices[1] - vertices[0], (100, 0), atol=1e-9)
    np.testing.assert_allclose(datum, (500, 500), atol=15.0)
    steps = np.diff(vertices, axis=0)[1:4]
    np.testing.assert_allclose(steps, [(0, 20), (-100, 0), (0, 20)], atol=1e-9)


@pytest.mark.parametrize("name", ["expanding_square", "sector", "creeping_line"])
def test_from_start_counts_the_transit(name, peak):
    path = make_planner(name, from_start=True).plan(peak)
    np.testing.assert_array_equal(path.waypoints[0], peak.start)
    assert path.transit_length == pytest.approx(np.hypot(400, 400), abs=100.0)
    assert path.length <= 1200.0 * (1 + 1e-12)


def test_datum_stays_in_the_area(holed_problem):
    path = make_planner("expanding_square").plan(holed_problem)
    assert holed_problem.area.contains(path.waypoints[:1]).all()
