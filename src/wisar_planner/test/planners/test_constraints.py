"""What holds for every planner on every legal problem."""

import threading
import time

import numpy as np
import pytest
import shapely
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

from wisar_planner import (
    GaussianMixture,
    Grid,
    RasterMap,
    SearchArea,
    SearchProblem,
    make_planner,
    planner_names,
)

# Planners that take steps of one length from the start; the others set waypoints along lines.
STEPPERS = ("greedy", "lookahead")
QUICK = {"lookahead": {"max_iterations": 200}}
UNTRAINED = tuple(n for n in planner_names() if not n.startswith("sac"))


def quick(name):
    return make_planner(name, **QUICK.get(name, {}))


def check(name, problem, path):
    assert path.planner == name
    assert path.swath_radius == problem.swath_radius
    assert np.isfinite(path.waypoints).all()
    assert path.length <= problem.max_distance * (1 + 1e-9)
    inside = shapely.distance(problem.area.polygon, shapely.points(path.waypoints))
    assert inside.max() <= 1e-7 * problem.step_length
    if name in STEPPERS:
        np.testing.assert_array_equal(path.waypoints[0], problem.start)
        assert problem.area.contains(path.waypoints).all()
        assert len(path.waypoints) <= problem.steps + 1
        check_legs(problem, path)


def check_legs(problem, path):
    """No leg crosses a hole or cuts a corner of the area."""
    if len(path.waypoints) > 1:
        flown = shapely.LineString(path.waypoints)
        outside = flown.difference(problem.area.polygon.buffer(1e-6 * problem.step_length))
        assert outside.length <= 1e-3 * problem.step_length


@st.composite
def areas(draw):
    size = draw(st.sampled_from([3.0, 20.0, 60.0, 150.0]))
    kind = draw(st.sampled_from(["rectangle", "triangle", "hole", "parts", "L"]))
    width, height = size, size * draw(st.floats(0.3, 1.0))
    box = shapely.box(0.0, 0.0, width, height)
    if kind == "triangle":
        return shapely.Polygon([(0, 0), (width, 0.2 * height), (0.3 * width, height)])
    if kind == "hole":
        return box.difference(shapely.box(0.3 * width, 0.3 * height, 0.7 * width, 0.6 * height))
    if kind == "parts":
        return box.difference(shapely.box(0.45 * width, -1.0, 0.55 * width, height + 1.0))
    if kind == "L":
        return box.difference(shapely.box(0.5 * width, 0.5 * height, 2 * width, 2 * height))
    return box


@st.composite
def problems(draw):
    polygon = draw(areas())
    xmin, ymin, xmax, ymax = polygon.bounds
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    if draw(st.booleans()):
        components = draw(st.integers(1, 6))
        pdm = GaussianMixture.random(
            rng, polygon.bounds, components=components, variance=draw(st.sampled_from([1.0, 500.0]))
        )
    else:
        grid = Grid.covering(polygon.bounds, max(xmax - xmin, ymax - ymin) / 7.0)
        mass = rng.random((grid.rows, grid.columns)) ** 4
        pdm = RasterMap(mass / mass.sum(), grid)
    if draw(st.booleans()):  # on the border
        start = shapely.line_interpolate_point(
            polygon.boundary, draw(st.floats(0.0, 1.0)), normalized=True
        )
    else:
        start = polygon.representative_point()
    assume(polygon.intersects(start))
    area = SearchArea.from_polygon(polygon)
    assume(pdm.integrate(polygon) > 1e-9)
    step = draw(st.sampled_from([1.0, 8.0]))
    return SearchProblem(
        pdm=pdm,
        area=area,
        start=np.array([start.x, start.y]),
        step_length=step,
        swath_radius=draw(st.sampled_from([0.5, 2.5, 10.0])),
        max_distance=step * draw(st.floats(0.4, 20.0)),
    )


@pytest.mark.parametrize("name", UNTRAINED)
@settings(
    max_examples=25,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.filter_too_much],
)
@given(problem=problems())
def test_paths_stay_inside_area_and_budget(name, problem):
    check(name, problem, quick(name).plan(problem))


@pytest.mark.parametrize("name", UNTRAINED)
def test_paths_stay_inside_an_area_with_a_hole(name, holed_problem):
    path = quick(name).plan(holed_problem)
    check(name, holed_problem, path)
    assert path.length > 0.9 * holed_problem.max_distance


@pytest.mark.parametrize("name", [*UNTRAINED, "sac", "sac_search"])
def test_no_leg_crosses_a_wall_thinner_than_a_step(name):
    """A strip where nobody may fly, cut out of the area's middle; the map's peak lies behind it."""
    wall = shapely.box(48.0, 15.0, 50.0, 85.0)
    problem = SearchProblem(
        pdm=GaussianMixture(np.ones(1), np.array([[60.0, 50.0]]), 200.0 * np.eye(2)[None]),
        area=SearchArea.from_polygon(shapely.box(0.0, 0.0, 100.0, 100.0).difference(wall)),
        start=np.array([30.0, 50.0]),
        step_length=8.0,
        swath_radius=2.5,
        max_distance=400.0,
    )
    options = {"sac_search": {"max_iterations": 2000}, "lookahead": {"max_iterations": 2000}}
    path = make_planner(name, **options.get(name, {})).plan(problem)
    assert path.length > 0.9 * problem.max_distance
    check_legs(problem, path)


@pytest.mark.parametrize("name", UNTRAINED)
def test_one_step_is_planned(name, paper_problem):
    whole = paper_problem(3)
    problem = SearchProblem(
        whole.pdm, whole.area, whole.start, whole.step_length, whole.swath_radius, 8.0
    )
    path = quick(name).plan(problem)
    check(name, problem, path)
    assert path.length == pytest.approx(8.0)


@pytest.mark.parametrize("name", UNTRAINED)
def test_area_smaller_than_the_swath_is_planned(name):
    problem = SearchProblem(
        pdm=GaussianMixture(np.ones(1), np.array([[0.5, 0.5]]), np.eye(2)[None]),
        area=SearchArea.rectangle(0.0, 0.0, 1.0, 1.0),
        start=np.array([0.0, 0.0]),
        step_length=8.0,
        swath_radius=2.5,
        max_distance=64.0,
    )
    path = quick(name).plan(problem)
    check(name, problem, path)
    assert path.probability_efficiency(problem) > 0.99


@pytest.mark.parametrize("name", UNTRAINED)
def test_same_problem_and_options_give_the_same_path(name, paper_problem):
    first = quick(name).plan(paper_problem(11))
    again = quick(name).plan(paper_problem(11))
    np.testing.assert_array_equal(first.waypoints, again.waypoints)


@pytest.mark.parametrize("name", UNTRAINED)
def test_lengths_scale(name, paper_problem):
    """A world a thousand times as wide has the same path, a thousand times as long."""
    small = paper_problem(12)
    pdm = small.pdm
    wide = SearchProblem(
        pdm=GaussianMixture(pdm.weights, pdm.means * 1000.0, pdm.covariances * 1e6),
        area=SearchArea.rectangle(0.0, 0.0, 150e3, 150e3),
        start=small.start * 1000.0,
        step_length=8e3,
        swath_radius=2.5e3,
        max_distance=512e3,
    )
    path, wide_path = quick(name).plan(small), quick(name).plan(wide)
    assert wide_path.probability_efficiency(wide) == pytest.approx(
        path.probability_efficiency(small), rel=0.02
    )


@pytest.mark.parametrize("name", UNTRAINED)
def test_stop_at_once_gives_a_legal_path(name, paper_problem):
    problem = paper_problem(13)
    check(name, problem, make_planner(name).plan(problem, should_stop=lambda: True))


def test_stop_is_heeded_soon_and_nothing_is_told_afterwards(paper_problem):
    problem = paper_problem(14)
    planner = make_planner("lookahead", time_budget_s=30.0)
    planner.plan(problem, should_stop=lambda: True)  # compile
    stop, told = threading.Event(), []
    threading.Timer(0.6, stop.set).start()
    path = planner.plan(problem, on_progress=told.append, should_stop=stop.is_set)
    late = len(told)
    stopped = time.monotonic()
    check("lookahead", problem, path)
    assert told
    assert told[-1].elapsed_s < 1.5
    assert [p.efficiency for p in told] == sorted(p.efficiency for p in told)
    assert [p.fraction for p in told] == sorted(p.fraction for p in told)
    assert all(0.0 <= p.fraction <= 1.0 for p in told)
    assert told[-1].efficiency == pytest.approx(path.probability_efficiency(problem), rel=0.03)
    time.sleep(0.1)
    assert len(told) == late
    assert time.monotonic() - stopped < 1.0
