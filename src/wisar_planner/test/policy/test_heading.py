import numpy as np
import pytest
import torch
from scipy.interpolate import CubicHermiteSpline

from wisar_planner.policy.heading import (
    ACTOR_OUTPUTS,
    DIRECTED,
    DISTRIBUTIONS,
    GAUSSIAN,
    actor_distribution,
    likeliest_turn,
    value_at,
    wrapped,
)
from wisar_planner.policy.observation import DIRECTIONS

RING = np.arange(DIRECTIONS)
EXTREMES = {
    "zero": np.zeros((ACTOR_OUTPUTS, 1, DIRECTIONS)),
    "huge": np.full((ACTOR_OUTPUTS, 1, DIRECTIONS), 1e30),
    "far below": np.full((ACTOR_OUTPUTS, 1, DIRECTIONS), -1e30),
    "straight back": np.stack([[1e4 * (RING == DIRECTIONS // 2)], [RING * 1e4]]),
    "two opposite": np.stack([[1e4 * (RING % (DIRECTIONS // 2) == 0)], [RING * -1e4]]),
}


def output(logits, certainty=0.0):
    certainties = np.broadcast_to(certainty, np.shape(logits))
    return np.array([[logits], [certainties]], dtype=np.float32)


@pytest.fixture
def values():
    return np.random.default_rng(1).normal(size=(3, DIRECTIONS)).astype(np.float32)


def test_values_at_the_directions_are_reproduced(values):
    turns = np.where(RING <= DIRECTIONS // 2, RING, RING - DIRECTIONS) * 2.0 / DIRECTIONS
    found = value_at(values, np.tile(turns.astype(np.float32), (3, 1)))
    np.testing.assert_allclose(found, values, atol=1e-6)


def test_values_are_periodic(values):
    action = np.random.default_rng(2).uniform(-1.0, 1.0, (3, 9))
    found = value_at(values, action)
    np.testing.assert_allclose(value_at(values, action + 2.0), found, atol=1e-6)
    ends = value_at(values, np.tile(np.float32([-1.0, 1.0]), (3, 1)))
    np.testing.assert_array_equal(ends[:, 0], ends[:, 1])


def test_values_between_are_those_of_a_cubic_hermite_spline(values):
    knots = np.arange(-DIRECTIONS, 2 * DIRECTIONS)
    tiled = np.tile(values.astype(np.float64), 3)
    slopes = 0.5 * (np.roll(tiled, -1, axis=1) - np.roll(tiled, 1, axis=1))
    spline = CubicHermiteSpline(knots, tiled, slopes, axis=1)
    action = np.linspace(-1.0, 1.0, 201)
    found = value_at(values, np.tile(action, (3, 1)))
    np.testing.assert_allclose(found, spline(action * DIRECTIONS / 2), atol=1e-5)


def test_values_of_twin_critics_are_read_at_the_same_turns(values):
    both = np.stack([values, 2.0 * values])
    action = np.random.default_rng(3).uniform(-1.0, 1.0, (3, 5)).astype(np.float32)
    found = value_at(both, np.stack([action, action]))
    np.testing.assert_allclose(found[1], 2.0 * found[0], rtol=1e-5)
    np.testing.assert_allclose(found[0], value_at(values, action), rtol=1e-5)


@pytest.mark.parametrize("direction", [0, 1, 8, 15, 17, 24, 31])
def test_the_mean_points_to_the_best_direction(direction):
    mean, _ = actor_distribution(output(50.0 * (direction == RING)))
    turn = direction if direction < DIRECTIONS / 2 else direction - DIRECTIONS
    assert np.tanh(mean[0]) == pytest.approx(2.0 * turn / DIRECTIONS, abs=1e-5)


def test_two_good_neighbours_are_split_between():
    mean, _ = actor_distribution(output(50.0 * ((RING == 3) | (RING == 4))))
    assert np.tanh(mean[0]) == pytest.approx(2.0 * 3.5 / DIRECTIONS, abs=1e-5)


def test_certainty_spans_its_range_monotonously():
    spread = [
        actor_distribution(output(RING * 1.0, certainty))[1][0] for certainty in (-9.0, 0.0, 9.0)
    ]
    assert spread == sorted(spread)
    assert spread[0] == pytest.approx(-5.0, abs=1e-3)
    assert spread[2] == pytest.approx(0.5, abs=1e-3)


@pytest.mark.parametrize("extreme", EXTREMES)
def test_extreme_outputs_give_a_finite_distribution_and_gradient(extreme):
    raw = EXTREMES[extreme].astype(np.float32)
    for found in actor_distribution(raw):
        assert np.isfinite(found).all()
    leaf = torch.tensor(raw, requires_grad=True)
    mean, log_std = actor_distribution(leaf)
    assert torch.isfinite(mean).all()
    (mean.sum() + log_std.sum()).backward()
    assert torch.isfinite(leaf.grad).all()


def test_numpy_and_torch_agree(values):
    raw = np.stack([values, values[::-1]])
    for ours, theirs in zip(
        actor_distribution(raw), actor_distribution(torch.tensor(raw)), strict=True
    ):
        np.testing.assert_allclose(theirs.numpy(), ours, rtol=1e-5, atol=1e-6)
    action = np.random.default_rng(4).uniform(-1.0, 1.0, (3, 7)).astype(np.float32)
    found = value_at(torch.tensor(values), torch.tensor(action))
    np.testing.assert_allclose(found.numpy(), value_at(values, action), atol=1e-6)


def directed(logits, offsets):
    return np.array([[logits], [offsets]], dtype=np.float32)


@pytest.mark.parametrize("direction", [0, 1, 15, 16, 17, 31])
@pytest.mark.parametrize("offset", [-3.0, 0.0, 0.4])
def test_the_likeliest_direction_is_taken_with_its_own_offset(direction, offset):
    offsets = np.where(direction == RING, offset, 9.0)
    turn = likeliest_turn(directed(1.0 * (direction == RING), offsets), DIRECTED)[0]
    expected = (direction + np.tanh(offset)) * 2.0 / DIRECTIONS
    assert -1.0 <= turn <= 1.0
    assert wrapped(turn - expected) == pytest.approx(0.0, abs=1e-6)


def test_two_good_ways_apart_are_not_averaged():
    """Left or right alike, a Gaussian goes between them; a choice among directions does not."""
    logits = 50.0 * ((RING == 4) | (RING == DIRECTIONS - 4))
    assert likeliest_turn(output(logits), GAUSSIAN)[0] == pytest.approx(0.0, abs=1e-5)
    assert abs(likeliest_turn(directed(logits, 0.0 * RING), DIRECTED)[0]) == pytest.approx(0.25)


@pytest.mark.parametrize("distribution", DISTRIBUTIONS)
def test_numpy_and_torch_turn_the_same(distribution):
    raw = np.random.default_rng(6).normal(size=(ACTOR_OUTPUTS, 9, DIRECTIONS)).astype(np.float32)
    found = likeliest_turn(torch.tensor(raw), distribution).numpy()
    np.testing.assert_allclose(found, likeliest_turn(raw, distribution), atol=1e-6)
