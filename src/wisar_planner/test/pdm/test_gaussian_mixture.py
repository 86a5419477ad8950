import math

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st
from scipy import integrate, stats

from wisar_planner.errors import InvalidInput
from wisar_planner.pdm import GaussianMixture, Grid
from wisar_planner.pdm.closed_form import mixture_in_polygon


def one(mean=(0.0, 0.0), covariance=((1.0, 0.0), (0.0, 1.0))):
    return GaussianMixture([1.0], [mean], [covariance])


def skewed():
    return GaussianMixture(
        [0.2, 0.5, 0.3],
        [[0, 0], [40, 10], [15, 50]],
        [[[90, 40], [40, 60]], [[200, -150], [-150, 300]], [[25, 0], [0, 400]]],
    )


def arc_disc(x, y, radius):
    """The boundary of a disc as two arcs."""
    return np.array([[x, y, 0.3, 2.0, radius], [x, y, 2.0, 0.3 + 2.0 * math.pi, radius]])


def test_density_is_that_of_scipy():
    mixture = skewed()
    points = np.random.default_rng(1).uniform(-30, 80, (50, 2))
    expected = sum(
        w * stats.multivariate_normal(m, c).pdf(points)
        for w, m, c in zip(mixture.weights, mixture.means, mixture.covariances, strict=True)
    )
    np.testing.assert_allclose(mixture.density(points), expected, rtol=1e-12)


def test_a_polygon_around_everything_holds_all_the_mass():
    assert skewed().integrate(shapely.box(-1e3, -1e3, 1e3, 1e3)) == pytest.approx(1.0, abs=1e-13)


def test_box_against_double_quadrature():
    mixture = skewed()
    expected, _ = integrate.dblquad(
        lambda y, x: mixture.density([[x, y]])[0], 5, 30, -10, 25, epsabs=1e-11
    )
    assert mixture.integrate(shapely.box(5, -10, 30, 25)) == pytest.approx(expected, abs=1e-10)


def test_holes_and_several_parts_add_and_subtract():
    mixture = skewed()
    outer, hole, other = (
        shapely.box(*b) for b in ((0, 0, 40, 40), (10, 10, 20, 25), (50, 0, 60, 9))
    )
    both = shapely.MultiPolygon([outer.difference(hole), other])
    expected = mixture.integrate(outer) - mixture.integrate(hole) + mixture.integrate(other)
    assert mixture.integrate(both) == pytest.approx(expected, abs=1e-14)
    assert mixture_in_polygon(mixture, both) == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("distance", [0.0, 1.0, 5.0, 9.0])
@pytest.mark.parametrize("radius", [0.05, 0.7, 3.0])
def test_disc_follows_the_noncentral_chi_square_even_in_the_tail(distance, radius):
    angle = 0.77
    disc = arc_disc(distance * math.cos(angle), distance * math.sin(angle), radius)
    got = one().integrate_boundary(disc, np.zeros(2, np.int64), 1)[0]
    expected = (
        stats.ncx2.cdf(radius**2, 2, distance**2) if distance else -math.expm1(-(radius**2) / 2)
    )
    assert got == pytest.approx(expected, rel=1e-7, abs=1e-18)


def test_regions_are_told_apart_by_their_owner():
    mixture = skewed()
    discs = [arc_disc(0, 0, 3.0), arc_disc(40, 10, 8.0)]
    together = mixture.integrate_boundary(np.concatenate(discs), np.array([0, 0, 1, 1]), 2)
    apart = [mixture.integrate_boundary(d, np.zeros(2, np.int64), 1)[0] for d in discs]
    np.testing.assert_allclose(together, apart, rtol=1e-13)


@st.composite
def mixtures(draw):
    count = draw(st.integers(1, 3))
    number = st.floats(-20, 20)
    means, covariances = [], []
    for _ in range(count):
        means.append([draw(number), draw(number)])
        angle = draw(st.floats(0, math.pi))
        first, second = draw(st.floats(1.0, 30.0)), draw(st.floats(1.0, 30.0))
        turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
        covariance = turn @ np.diag([first**2, second**2]) @ turn.T
        covariances.append((covariance + covariance.T) / 2)
    weights = np.array([draw(st.floats(0.1, 1.0)) for _ in range(count)])
    return GaussianMixture(weights / weights.sum(), means, covariances)


@st.composite
def polygons(draw):
    points = draw(
        st.lists(st.tuples(st.floats(-60, 60), st.floats(-60, 60)), min_size=3, max_size=8)
    )
    shape = shapely.MultiPoint(points).convex_hull.buffer(draw(st.floats(0.01, 5.0)), quad_segs=3)
    inner = shape.buffer(-0.2 * math.sqrt(shape.area), quad_segs=2)
    return shape.difference(inner) if draw(st.booleans()) else shape


@given(mixtures(), polygons())
def test_boundary_integral_agrees_with_the_closed_form(mixture, polygon):
    assert mixture.integrate(polygon) == pytest.approx(
        mixture_in_polygon(mixture, polygon), abs=1e-12
    )


@given(mixtures(), polygons(), st.floats(0, 6), st.floats(-1e4, 1e4), st.floats(-1e4, 1e4))
def test_moving_map_and_polygon_together_changes_nothing(mixture, polygon, angle, dx, dy):
    shift = np.array([dx, dy])
    turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    covariances = turn @ mixture.covariances @ turn.T
    moved = GaussianMixture(
        mixture.weights,
        mixture.means @ turn.T + shift,
        (covariances + covariances.transpose(0, 2, 1)) / 2,
    )
    shape = shapely.transform(polygon, lambda xy: xy @ turn.T + shift)
    assert moved.integrate(shape) == pytest.approx(mixture.integrate(polygon), abs=1e-11)


@given(mixtures(), polygons(), st.floats(-40, 40))
def test_cutting_a_polygon_keeps_its_mass(mixture, polygon, x):
    left = shapely.intersection(polygon, shapely.box(-200, -200, x, 200))
    right = shapely.intersection(polygon, shapely.box(x, -200, 200, 200))
    parts = sum(mixture.integrate(p) for p in (left, right) if not p.is_empty and p.area > 0)
    assert parts == pytest.approx(mixture.integrate(polygon), abs=1e-10)


@pytest.mark.parametrize("mixture", [skewed(), one((3, 4), ((9, 0), (0, 4)))])
def test_rasterize_holds_each_cells_mass(mixture):
    grid = Grid(-10.0, -5.0, 7.0, 5, 4)
    raster = mixture.rasterize(grid)
    for row in range(grid.rows):
        for column in range(grid.columns):
            x, y = grid.x0 + 7 * column, grid.y0 + 7 * row
            expected = mixture.integrate(shapely.box(x, y, x + 7, y + 7))
            assert raster[row, column] == pytest.approx(expected, abs=1e-13)


def test_samples_follow_the_map():
    mixture = skewed()
    points = mixture.sample(40_000, np.random.default_rng(3))
    box = shapely.box(10, -5, 45, 30)
    share = shapely.contains_xy(box, points[:, 0], points[:, 1]).mean()
    assert share == pytest.approx(mixture.integrate(box), abs=0.01)
    assert np.allclose(points.mean(axis=0), mixture.weights @ mixture.means, atol=0.5)


def test_a_component_without_weight_is_never_drawn():
    mixture = GaussianMixture([1.0, 0.0], [[0, 0], [1e6, 0]], np.tile(np.eye(2), (2, 1, 1)))
    assert np.abs(mixture.sample(1000, np.random.default_rng(0))).max() < 100


def test_most_probable_mass_of_a_normal_is_that_of_the_disc_around_its_mean():
    sigma, area = 20.0, 2500.0
    mixture = one(covariance=((sigma**2, 0), (0, sigma**2)))
    exact = -math.expm1(-area / (2 * math.pi * sigma**2))
    bound = mixture.most_probable_mass(shapely.box(-120, -120, 120, 120), area)
    assert exact <= bound <= 1.001 * exact


def test_most_probable_mass_is_the_regions_mass_where_it_is_small():
    mixture, region = skewed(), shapely.box(0, 0, 9, 9)
    assert mixture.most_probable_mass(region, 200.0) == pytest.approx(mixture.integrate(region))
    assert mixture.most_probable_mass(region, 0.0) == 0.0


def test_random_is_the_papers_map():
    mixture = GaussianMixture.random(np.random.default_rng(0), (0, 0, 150, 150))
    np.testing.assert_allclose(mixture.weights, 0.25)
    np.testing.assert_allclose(mixture.covariances, np.tile(500 * np.eye(2), (4, 1, 1)))
    assert (mixture.means >= 0).all()
    assert (mixture.means <= 150).all()


@pytest.mark.parametrize(
    ("weights", "means", "covariances", "named"),
    [
        ([], np.empty((0, 2)), np.empty((0, 2, 2)), "weights"),
        ([0.5], [[0, 0]], [np.eye(2)], "weights"),
        ([-1.0, 2.0], [[0, 0], [1, 1]], [np.eye(2)] * 2, "weights"),
        ([math.nan], [[0, 0]], [np.eye(2)], "weights"),
        ([1.0], [[0, math.inf]], [np.eye(2)], "means"),
        ([1.0], [[0, 0, 0]], [np.eye(2)], "means"),
        ([1.0], [[0, 0]], [[[1, 1], [1, 1]]], "covariances"),
        ([1.0], [[0, 0]], [[[1, 0], [0, -1]]], "covariances"),
        ([1.0], [[0, 0]], [[[1, 0.5], [0.1, 1]]], "covariances"),
        ([1.0], [[0, 0]], [[[0, 0], [0, 0]]], "covariances"),
        ("one", [[0, 0]], [np.eye(2)], "weights"),
    ],
)
def test_bad_mixtures_are_named(weights, means, covariances, named):
    with pytest.raises(InvalidInput, match=named):
        GaussianMixture(weights, means, covariances)


def test_bad_polygons_are_named():
    bow_tie = shapely.Polygon([(0, 0), (1, 1), (1, 0), (0, 1)])
    for wrong in (bow_tie, shapely.Point(0, 0), None):
        with pytest.raises(InvalidInput, match="polygon"):
            one().integrate(wrong)
    assert one().integrate(shapely.Polygon()) == 0.0
