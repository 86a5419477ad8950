import pytest
import torch

from wisar_planner.training.paper.environment import PaperEnvironment, TaskSettings
from wisar_planner.training.paper.replay import Replay

TASK = TaskSettings(waypoints=3, gaussians=2)
SEARCHES = 4


def fly(replay, environment, rounds, generator, last=None):
    """Fly rounds, the last one only in part; return all transitions, newest last."""
    transitions = []
    for i in range(rounds):
        environment.begin()
        replay.begin(environment.means, environment.position)
        for step in range(last if last is not None and i == rounds - 1 else TASK.waypoints):
            now = environment.observe()
            action = 2.0 * torch.rand(SEARCHES, generator=generator) - 1.0
            reward = environment.step(action)
            replay.add(action, reward, environment.position)
            over = torch.full((SEARCHES,), step + 1 == TASK.waypoints)
            transitions.append((now, action, reward, environment.observe(), over))
    return transitions


@pytest.mark.parametrize(
    ("rounds", "last", "kept"),
    [
        (1, 1, 1),  # begun
        (2, 2, 5),  # not full
        (2, 3, 6),  # just full
        (5, 3, 6),  # the oldest rounds are forgotten
        (5, 1, 4),  # as is the round that the current one is written over
    ],
)
def test_samples_are_the_transitions_that_were_flown(rounds, last, kept):
    generator = torch.Generator().manual_seed(0)
    environment = PaperEnvironment(SEARCHES, TASK, generator)
    # 20 steps are rounded up to two rounds.
    replay = Replay(20, SEARCHES, TASK, torch.device("cpu"))
    flown = fly(replay, environment, rounds, generator, last)[-kept:]
    assert len(replay) == kept * SEARCHES
    wanted = [torch.cat([t[i] for t in flown]) for i in range(5)]
    batch = replay.sample(400, generator)
    # Actions are unlike each other, so they tell which transition a sample is.
    found = (batch.action[:, None] == wanted[1]).int()
    assert torch.equal(found.sum(dim=1), torch.ones(400, dtype=torch.int64))
    index = found.argmax(dim=1)
    assert len(index.unique()) == kept * SEARCHES
    for part, values in zip(batch, wanted, strict=True):
        torch.testing.assert_close(part, values[index])


def test_it_takes_no_more_memory_than_positions_actions_and_rewards():
    replay = Replay(64 * 32 * 10, 32, TaskSettings(), torch.device("cpu"))
    used = sum(each.numel() * each.element_size() for each in replay.tensors().values())
    assert used / (64 * 32 * 10) < 17.0
