import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from wisar_planner.pdm import GaussianMixture, Grid, RasterMap
from wisar_planner.search.gradient import seen_with_gradient
from wisar_planner.search.seen_area import probability_seen

RADIUS = 2.5
MIXTURE = GaussianMixture(
    [0.6, 0.4],
    [[8.0, 5.0], [-6.0, 12.0]],
    [[[120.0, 40.0], [40.0, 60.0]], [[50.0, -10.0], [-10.0, 90.0]]],
)
GRID = Grid(-60.0, -60.0, 3.0, 40, 40)
RASTER = RasterMap(MIXTURE.rasterize(GRID), GRID)


@st.composite
def paths(draw):
    """Paths that turn, cross and overlap themselves, in general position."""
    count = draw(st.integers(1, 30))
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    turn = draw(st.sampled_from([0.3, 1.0, 3.0]))
    headings = np.cumsum(rng.normal(0.0, turn, count))
    steps = rng.uniform(1.0, 9.0, (count, 1)) * np.column_stack(
        [np.cos(headings), np.sin(headings)]
    )
    return np.concatenate([rng.normal(0.0, 8.0, (1, 2)), steps]).cumsum(axis=0)


def differences(value, points, by=1e-4):
    """The gradient by central differences."""
    found = np.empty_like(points)
    for i, axis in itertools.product(range(len(points)), range(2)):
        moved = np.zeros_like(points)
        moved[i, axis] = by
        found[i, axis] = (value(points + moved) - value(points - moved)) / (2.0 * by)
    return found


@given(points=paths())
@settings(max_examples=60)
def test_is_what_differences_of_the_exact_integral_say(points):
    value, gradient = seen_with_gradient(MIXTURE, points, RADIUS, [len(points) - 1], [1.0])
    assert value == pytest.approx(probability_seen(MIXTURE, points, RADIUS), abs=1e-14)
    expected = differences(lambda moved: probability_seen(MIXTURE, moved, RADIUS), points)
    # Where parts of the boundary appear or vanish, the differences are off by their length.
    np.testing.assert_allclose(gradient, expected, atol=2e-4 * np.abs(expected).max())


@given(points=paths(), seed=st.integers(0, 2**32))
@settings(max_examples=40)
def test_parts_of_a_path_add_up(points, seed):
    rng, steps = np.random.default_rng(seed), len(points) - 1
    prefixes = sorted(rng.integers(1, steps + 1, 3).tolist())
    weights = rng.uniform(0.0, 2.0, 3).tolist()
    value, gradient = seen_with_gradient(MIXTURE, points, RADIUS, prefixes, weights)
    expected, slope = 0.0, np.zeros_like(points)
    for prefix, weight in zip(prefixes, weights, strict=True):
        alone = seen_with_gradient(MIXTURE, points[: prefix + 1], RADIUS, [prefix], [1.0])
        expected += weight * alone[0]
        slope[: prefix + 1] += weight * alone[1]
    assert value == pytest.approx(expected, abs=1e-14)
    np.testing.assert_allclose(gradient, slope, atol=1e-14)


@pytest.mark.parametrize(
    ("pdm", "tolerance"), [(MIXTURE, 0.005), (RASTER, 0.1)], ids=["mixture", "raster"]
)
@given(points=paths(), seed=st.integers(0, 2**32))
@settings(max_examples=20)
def test_adds_up_to_the_change_along_a_way(pdm, tolerance, points, seed):
    """Of a raster, too, whose cells are sampled a few times each."""
    steps = len(points) - 1
    way = np.random.default_rng(seed).normal(0.0, 0.5, points.shape)
    shares = (np.arange(64) + 0.5) / 64
    slopes = [
        (seen_with_gradient(pdm, points + share * way, RADIUS, [steps], [1.0])[1] * way).sum()
        for share in shares
    ]
    change = probability_seen(pdm, points + way, RADIUS) - probability_seen(pdm, points, RADIUS)
    largest = np.abs(seen_with_gradient(pdm, points, RADIUS, [steps], [1.0])[1] * way).sum()
    assert np.mean(slopes) == pytest.approx(change, abs=tolerance * largest)


def test_a_step_that_adds_nothing_does_not_shift_the_others():
    """The third step flies back over the second, which sees all of it already."""
    points = np.array([[0.0, 0.0], [8.0, 0.0], [14.0, 5.0], [11.0, 2.5], [9.0, 9.0]])
    _, gradient = seen_with_gradient(MIXTURE, points, RADIUS, [4], [1.0])
    expected = differences(lambda moved: probability_seen(MIXTURE, moved, RADIUS), points)
    ends = [0, 4]  # The others are where boundaries coincide, and the sum has a kink.
    np.testing.assert_allclose(gradient[ends], expected[ends], atol=1e-6)
