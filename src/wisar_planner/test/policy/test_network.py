import numpy as np
import pytest
import torch

from wisar_planner.policy.network import forward, initial_parameters
from wisar_planner.policy.observation import DIRECTIONS, NUMBERS, VIEW_WIDTH
from wisar_planner.policy.ring_kernels import RingWeights, ring_network


@pytest.fixture
def parameters():
    """Two networks side by side, no parameter of them zero."""
    rng = np.random.default_rng(1)
    made = initial_parameters(rng, networks=2, outputs=3, channels=12, blocks=2)
    noise = {name: rng.normal(0.0, 0.1, value.shape) for name, value in made.items()}
    return {name: (value + noise[name]).astype(np.float32) for name, value in made.items()}


@pytest.fixture
def observed():
    rng = np.random.default_rng(2)
    view = rng.normal(size=(5, DIRECTIONS, VIEW_WIDTH)).astype(np.float32)
    return view, rng.normal(size=(5, NUMBERS)).astype(np.float32)


def test_numpy_and_torch_agree(parameters, observed):
    expected = forward(parameters, *observed)
    in_torch = {name: torch.tensor(value) for name, value in parameters.items()}
    found = forward(in_torch, *map(torch.tensor, observed))
    assert expected.shape == (2, 3, 5, DIRECTIONS)
    assert expected.dtype == np.float32
    assert np.std(expected) > 0.1
    np.testing.assert_allclose(found.numpy(), expected, atol=1e-5, rtol=1e-5)


def test_it_is_the_network_that_its_description_says(parameters, observed):
    """Layer by layer, one search, network and direction at a time, in float64."""
    view, numbers = observed
    found = forward(parameters, view, numbers)
    for n in range(2):
        p = {name: value[n].astype(np.float64) for name, value in parameters.items()}
        for b in range(len(view)):
            row = p["numbers"] @ numbers[b] + p["bias"][:, 0]
            hidden = np.array(
                [np.maximum(p["view"] @ view[b, d] + row, 0.0) for d in range(DIRECTIONS)]
            )
            for block in range(2):
                ring = p[f"ring{block}"]
                turned = sum(ring[:, k] * np.roll(hidden, k, axis=0) for k in range(DIRECTIONS))
                mixed = turned @ p[f"mix{block}"].T + p[f"bias{block}"][:, 0]
                hidden = hidden + np.maximum(mixed, 0.0)
            output = hidden @ p["output"].T + p["output_bias"][:, 0]
            np.testing.assert_allclose(found[n, :, b], output.T, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize(("channels", "outputs"), [(12, 3), (5, 2), (1, 1), (8, 5)])
def test_the_compiled_network_says_the_same(observed, channels, outputs):
    """Also where channels and outputs are no multiple of those that it sums side by side."""
    rng = np.random.default_rng(channels)
    made = initial_parameters(rng, networks=1, outputs=outputs, channels=channels, blocks=2)
    noisy = {k: (v + rng.normal(0.0, 0.1, v.shape)).astype(np.float32) for k, v in made.items()}
    expected = forward(noisy, *observed)[0]
    assert np.std(expected) > 0.01
    found = np.full_like(expected, np.nan)
    ring_network(RingWeights.of(noisy), *observed, found)
    np.testing.assert_allclose(found, expected, atol=1e-5, rtol=1e-5)


@pytest.mark.parametrize("turn", [1, 7, 16])
def test_turning_the_ring_turns_the_output(parameters, observed, turn):
    view, numbers = observed
    straight = forward(parameters, view, numbers)
    turned = forward(parameters, np.roll(view, turn, axis=1), numbers)
    np.testing.assert_allclose(turned, np.roll(straight, turn, axis=-1), atol=1e-5, rtol=1e-5)
    assert np.abs(turned - straight).max() > 0.1


def test_every_direction_sees_the_whole_ring(parameters, observed):
    view, numbers = observed
    before = forward(parameters, view, numbers)
    changed = view.copy()
    changed[:, DIRECTIONS // 2] += 1.0
    assert (np.abs(forward(parameters, changed, numbers) - before) > 0.0).any(axis=1).all()


def test_searches_do_not_touch_each_other(parameters, observed):
    view, numbers = observed
    together = forward(parameters, view, numbers)
    alone = forward(parameters, view[3:4], numbers[3:4])
    np.testing.assert_allclose(together[:, :, 3:4], alone, atol=1e-5, rtol=1e-5)


def test_parameters_repeat_with_the_seed_and_start_small():
    first, again, other = (
        initial_parameters(
            np.random.default_rng(seed), networks=1, outputs=2, channels=16, blocks=3
        )
        for seed in (1, 1, 2)
    )
    for name, value in first.items():
        assert value.dtype == np.float32
        np.testing.assert_array_equal(value, again[name])
    assert (first["view"] != other["view"]).any()
    rng = np.random.default_rng(3)
    view = rng.random((20, DIRECTIONS, VIEW_WIDTH), dtype=np.float32)
    output = forward(first, view, rng.random((20, NUMBERS), dtype=np.float32))
    assert 0.0 < np.std(output) < 1.0
