"""Messages and domain objects: what goes in comes out."""

from __future__ import annotations

import math

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message, serialize_message
from shapely import MultiPolygon, Polygon

from wisar_msgs.msg import ProbabilityMap, SearchPlan
from wisar_planner.errors import InvalidInput
from wisar_planner.nodes import conversions
from wisar_planner.nodes.conversions import LocatedMap, Plan
from wisar_planner.pdm import GaussianMixture, Grid, RasterMap
from wisar_planner.pdm.geodesy import GeoOrigin
from wisar_planner.search import SearchArea, SearchPath

metres = st.floats(-5000.0, 5000.0, allow_nan=False)
AREA = SearchArea.rectangle(-6000.0, -6000.0, 6000.0, 6000.0)


@st.composite
def mixtures(draw: st.DrawFn) -> GaussianMixture:
    count = draw(st.integers(1, 6))
    weights = np.array(draw(st.lists(st.floats(0.05, 1.0), min_size=count, max_size=count)))
    means = draw(st.lists(st.tuples(metres, metres), min_size=count, max_size=count))
    covariances = []
    for _ in range(count):
        a, b = draw(st.floats(5.0, 500.0)), draw(st.floats(5.0, 500.0))
        angle = draw(st.floats(0.0, math.pi))
        turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
        covariances.append(turn @ np.diag([a * a, b * b]) @ turn.T)
    return GaussianMixture(weights / weights.sum(), means, covariances)


def over_the_wire(message):
    """Serialise as the middleware does."""
    return deserialize_message(serialize_message(message), type(message))


@settings(deadline=None, max_examples=50)
@given(mixtures(), st.floats(-90, 90), st.floats(-180, 180), st.integers(0, 2**62))
def test_a_map_round_trips(mixture, latitude: float, longitude: float, stamp: int) -> None:
    # The seconds of a ROS stamp are a signed 32-bit number.
    stamp %= (2**31 - 1) * 1_000_000_000
    located = LocatedMap("m", mixture, AREA, GeoOrigin(latitude, longitude), stamp, "map", "test")
    back = conversions.map_from_msg(over_the_wire(conversions.map_to_msg(located)))
    np.testing.assert_allclose(back.pdm.weights, mixture.weights, rtol=1e-15)
    np.testing.assert_array_equal(back.pdm.means, mixture.means)
    np.testing.assert_allclose(back.pdm.covariances, mixture.covariances, rtol=1e-15)
    assert back.area.polygon.equals(AREA.polygon)
    assert (back.map_id, back.origin, back.stamp_ns, back.frame_id, back.source) == (
        located.map_id,
        located.origin,
        stamp,
        "map",
        "test",
    )


@settings(deadline=None, max_examples=50)
@given(
    st.lists(st.tuples(metres, metres), min_size=2, max_size=40, unique=True),
    st.floats(0.1, 100.0),
)
def test_a_plan_round_trips(waypoints: list[tuple[float, float]], radius: float) -> None:
    path = SearchPath(np.array(waypoints), radius, planner="greedy")
    probability = np.linspace(0.0, 0.4, len(waypoints))
    plan = Plan(
        path,
        "m",
        GeoOrigin(56.8, -5.0),
        probability,
        np.array([1.0, 2.0]),
        8.0,
        512.0,
        0.9,
        0.4 / 0.9,
        0.6,
        1.5,
        12345678901,
    )
    back = conversions.plan_from_msg(over_the_wire(conversions.plan_to_msg(plan)))
    np.testing.assert_array_equal(back.path.waypoints, path.waypoints)
    np.testing.assert_array_equal(back.probability, probability)
    np.testing.assert_array_equal(back.start, plan.start)
    assert (back.path.planner, back.path.swath_radius) == ("greedy", radius)
    for name in (
        "map_id",
        "origin",
        "step_length",
        "budget",
        "probability_in_area",
        "probability_efficiency",
        "upper_bound",
        "planning_time",
        "stamp_ns",
    ):
        assert getattr(back, name) == getattr(plan, name), name


def test_an_area_with_holes_and_parts_round_trips() -> None:
    square = shapely.box(0, 0, 10, 10)
    with_hole = Polygon(square.exterior, [shapely.box(2, 2, 4, 4).exterior.coords])
    area = SearchArea(MultiPolygon([with_hole, shapely.box(20, 0, 30, 5)]))
    back = conversions.area_from_msg(over_the_wire(conversions.area_to_msg(area)))
    assert back.polygon.equals(area.polygon)


def test_nav_path_looks_along_its_legs() -> None:
    path = SearchPath(np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 0.0]]), 1.0)
    plan = Plan(path, "m", GeoOrigin(0, 0), np.zeros(4), np.zeros(2), 1, 4, 1, 0, 1, 0)
    poses = conversions.plan_to_nav_path(plan).poses
    headings = [2 * math.atan2(p.pose.orientation.z, p.pose.orientation.w) for p in poses]
    np.testing.assert_allclose(headings, [0.0, math.pi / 2, -3 * math.pi / 4, -3 * math.pi / 4])


def test_the_occupancy_grid_has_its_peak_where_the_map_has() -> None:
    mixture = GaussianMixture([1.0], [[30.0, -20.0]], [[[100.0, 0.0], [0.0, 100.0]]])
    area = SearchArea.from_polygon([[-100, -100], [100, -100], [100, 100]])
    grid = conversions.grid_to_msg(mixture, area, 5.0, conversions.header(0, "map"))
    cells = np.array(grid.data).reshape(grid.info.height, grid.info.width)
    row, column = np.unravel_index(cells.argmax(), cells.shape)
    x = grid.info.origin.position.x + (column + 0.5) * grid.info.resolution
    y = grid.info.origin.position.y + (row + 0.5) * grid.info.resolution
    assert (abs(x - 30.0), abs(y + 20.0)) <= (5.0, 5.0)
    assert cells.max() == 100
    assert cells[-1, 0] == -1  # the corner outside the triangle


def test_a_hole_over_the_peak_leaves_a_grid_that_shows_the_rest() -> None:
    mixture = GaussianMixture([1.0], [[0.0, 0.0]], [[[100.0, 0.0], [0.0, 100.0]]])
    around = shapely.box(-100, -100, 100, 100)
    area = SearchArea.from_polygon(around.difference(shapely.box(-40, -40, 40, 40)))
    grid = conversions.grid_to_msg(mixture, area, 5.0, conversions.header(0, "map"))
    cells = np.array(grid.data).reshape(grid.info.height, grid.info.width)
    hole = np.zeros(cells.shape, dtype=bool)
    hole[12:28, 12:28] = True
    assert (cells[hole] == -1).all()
    assert (cells[~hole].min(), cells[~hole].max()) == (0, 100)
    row, column = np.unravel_index(cells.argmax(), cells.shape)
    assert {int(row), int(column)} & {11, 28}  # beside the hole


@pytest.mark.parametrize("inside", [0.0, 5e-324, 1e-300])
def test_a_grid_takes_what_is_next_to_nothing(inside: float) -> None:
    values = np.full((4, 4), inside)
    values[:, 0] = 0.25
    raster = RasterMap(values, Grid(0.0, 0.0, 10.0, 4, 4))
    area = SearchArea.rectangle(10, 0, 40, 40)
    grid = conversions.grid_to_msg(raster, area, 10.0, conversions.header(0, "map"))
    assert set(grid.data) == {100 if inside else 0}


def test_a_raster_map_becomes_a_grid_too() -> None:
    raster = RasterMap(np.full((4, 4), 1 / 16), Grid(0.0, 0.0, 10.0, 4, 4))
    area = SearchArea.rectangle(0, 0, 40, 40)
    grid = conversions.grid_to_msg(raster, area, 10.0, conversions.header(0, "map"))
    assert set(grid.data) == {100}


@pytest.mark.parametrize("cell", [1e-300, 1e-3, 0.5])
def test_a_grid_of_too_many_cells_is_refused_with_a_cell_that_will_do(cell: float) -> None:
    raster = RasterMap(np.full((4, 4), 1 / 16), Grid(0.0, 0.0, 500.0, 4, 4))
    area = SearchArea.rectangle(0, 0, 2000, 1000)
    header = conversions.header(0, "map")
    with pytest.raises(InvalidInput, match=r"cells of at least 0\.708 m"):
        conversions.grid_to_msg(raster, area, cell, header)
    grid = conversions.grid_to_msg(raster, area, 0.7072, header)
    assert 3_990_000 < len(grid.data) < 4_010_000


@pytest.mark.parametrize(
    ("width", "height"), [(10469, 7777), (1, 2000), (113, 113), (0.5, 9e6), (1e7, 1e7), (1e-3, 1.0)]
)
def test_the_cell_that_a_refusal_tells_is_taken(width: float, height: float, monkeypatch) -> None:
    monkeypatch.setattr(conversions, "LARGEST_GRID", 10_000)  # quick, and rounded as any other
    raster = RasterMap(np.full((1, 1), 1.0), Grid(0.0, 0.0, max(width, height), 1, 1))
    area, header = SearchArea.rectangle(0, 0, width, height), conversions.header(0, "map")
    with pytest.raises(InvalidInput, match="at least") as refused:
        conversions.grid_to_msg(raster, area, 1e-9, header)
    cell = float(str(refused.value).split()[-2])
    assert len(conversions.grid_to_msg(raster, area, cell, header).data) > 9000


@pytest.mark.parametrize(
    ("deviations", "words"),
    [
        ((1e-6, 1e-6), "standard deviation of 1e-06 m, below 0.01 m"),
        ((0.009, 300.0), "standard deviation of 0.009 m, below 0.01 m"),
        ((2e5, 2e7), "standard deviation of 2e[+]07 m, above 1e[+]07 m"),
        ((0.011, 300.0), ""),
    ],
)
def test_a_component_must_have_a_width_that_can_be_searched(deviations, words: str) -> None:
    turn = np.array([[0.8, -0.6], [0.6, 0.8]])
    covariance = turn @ np.diag(np.square(deviations)) @ turn.T
    covariance = (covariance + covariance.T) / 2.0
    mixture = GaussianMixture(
        [0.5, 0.5], np.zeros((2, 2)), [[[400.0, 0.0], [0.0, 400.0]], covariance]
    )
    located = LocatedMap("m", mixture, AREA, GeoOrigin(56.8, -5.0))
    message = over_the_wire(conversions.map_to_msg(located))
    if words:
        with pytest.raises(InvalidInput, match=f"component 1 have a {words}"):
            conversions.map_from_msg(message)
    else:
        assert conversions.map_from_msg(message).map_id == "m"


@pytest.mark.parametrize(
    ("waypoints", "radius", "words"),
    [
        ([[0.0, 0.0], [10.0, 0.0]], 1e300, "swath_radius must be at most"),
        ([[0.0, 0.0], [1e300, 0.0]], 2.5, "waypoints must be metres"),
        ([[0.0, 0.0], [0.0, -1.1e7]], 2.5, "waypoints must be metres"),
    ],
)
def test_a_plan_must_lie_on_the_ground(waypoints, radius: float, words: str) -> None:
    (x, y) = np.transpose(waypoints).tolist()
    message = SearchPlan(x=x, y=y, probability=[0.0, 0.1], swath_radius=radius)
    message.step_length = message.budget = message.probability_in_area = 1.0
    with pytest.raises(InvalidInput, match=words):
        conversions.plan_from_msg(message)


@pytest.mark.parametrize("message", [ProbabilityMap(), ProbabilityMap(id="x"), SearchPlan()])
def test_an_empty_message_is_refused(message) -> None:
    read = (
        conversions.map_from_msg
        if isinstance(message, ProbabilityMap)
        else (conversions.plan_from_msg)
    )
    with pytest.raises(InvalidInput):
        read(message)
