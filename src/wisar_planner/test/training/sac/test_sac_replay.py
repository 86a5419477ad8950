import numpy as np
import pytest
import torch

from wisar_planner.policy.observation import DIRECTIONS, NUMBERS, VIEW_WIDTH, Observation
from wisar_planner.training.sac.replay import Replay

SEARCHES, ROWS, GAMMA = 3, 10, 0.9


def flown(steps, n_step):
    """A replay of random steps that are told apart, and those steps as plain arrays."""
    rng = np.random.default_rng(1)
    replay = Replay(ROWS * SEARCHES + 1, SEARCHES, n_step, GAMMA, torch.device("cpu"))
    action = rng.uniform(-1.0, 1.0, (steps, SEARCHES))
    reward = rng.random((steps, SEARCHES))
    done = rng.random((steps, SEARCHES)) < 0.25
    view = rng.random((steps, SEARCHES, DIRECTIONS, VIEW_WIDTH)).astype(np.float16)
    for t in range(steps):
        numbers = np.zeros((SEARCHES, NUMBERS))
        numbers[:, 0], numbers[:, 1] = t, np.arange(SEARCHES)
        observation = Observation(torch.tensor(view[t]), torch.tensor(numbers).float())
        replay.add(
            observation,
            torch.tensor(action[t]).float(),
            torch.tensor(reward[t]).float(),
            torch.tensor(done[t]),
        )
    return replay, action, reward, done, view.astype(np.float32)


@pytest.mark.parametrize("n_step", [1, 3])
@pytest.mark.parametrize("steps", [7, 10, 10 + 4, 3 * 10 + 5])
def test_transitions_are_those_of_a_plain_loop(n_step, steps):
    replay, action, reward, done, view = flown(steps, n_step)
    batch = replay.sample(500, torch.Generator().manual_seed(2))
    assert len(replay) == min(steps, ROWS) * SEARCHES
    met, mirrored = set(), 0
    for i in range(500):
        t, s = (int(x) for x in batch.now.numbers[i, :2])
        met.add((t, s))
        expected, discount = 0.0, 1.0
        for k in range(n_step):
            expected += discount * reward[t + k, s]
            discount *= GAMMA
            if done[t + k, s]:
                discount = 0.0
                break
        assert float(batch.reward[i]) == pytest.approx(expected, rel=1e-5)
        assert float(batch.discount[i]) == pytest.approx(discount, rel=1e-5)
        assert tuple(int(x) for x in batch.later.numbers[i, :2]) == (t + n_step, s)
        # A mirrored transition turns the other way, before and after.
        sign = 1 if float(batch.action[i]) == pytest.approx(action[t, s], abs=1e-6) else -1
        mirrored += sign < 0
        assert float(batch.action[i]) == pytest.approx(sign * action[t, s], abs=1e-6)
        order = sign * np.arange(DIRECTIONS) % DIRECTIONS
        np.testing.assert_array_equal(batch.now.view[i], view[t, s, order])
        np.testing.assert_array_equal(batch.later.view[i], view[t + n_step, s, order])
    oldest = max(0, steps - ROWS)
    assert met == {(t, s) for t in range(oldest, steps - n_step) for s in range(SEARCHES)}
    assert 0.4 < mirrored / 500 < 0.6


def test_samples_repeat_with_the_seed():
    replay, *_ = flown(9, 2)
    first, again, other = (
        replay.sample(20, torch.Generator().manual_seed(seed)).action for seed in (1, 1, 2)
    )
    torch.testing.assert_close(first, again)
    assert (first != other).any()
