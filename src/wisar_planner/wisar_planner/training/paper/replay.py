"""Replay memory of whole searches; observations are made when they are sampled.

A search is its positions, its map, its actions and rewards: 17 bytes per step at the paper's
settings instead of the 1,250 of two observations.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from wisar_planner.training.paper.environment import VARIANCE, TaskSettings
from wisar_planner.training.paper.observation import observe


class Batch(NamedTuple):
    """Transitions.

    Attributes
    ----------
    now, later : (B, layout.size) float32
        Observations before and after the step.
    action, reward : (B,) float32
        Action and its reward.
    over : (B,) bool
        Whether the search ended with the step.
    """

    now: Tensor
    action: Tensor
    reward: Tensor
    later: Tensor
    over: Tensor


class Replay:
    """A ring of the last rounds; in a round every search flies from its start to its end.

    Parameters
    ----------
    capacity : int
        Steps kept, of all searches together; rounded up to whole rounds.
    searches : int
        Searches side by side.
    task : TaskSettings
        The task.
    device : torch.device
        Where to keep it.
    """

    def __init__(
        self, capacity: int, searches: int, task: TaskSettings, device: torch.device
    ) -> None:
        self._task, self._searches = task, searches
        n = task.waypoints
        self._rounds = math.ceil(capacity / (n * searches))
        shape = (self._rounds, searches)
        self._path = torch.zeros(*shape, n + 1, 2, device=device)
        self._means = torch.zeros(*shape, task.gaussians, 2, device=device)
        self._action = torch.zeros(*shape, n, device=device)
        self._reward = torch.zeros(*shape, n, device=device)
        #: Rounds begun, and steps flown of the last one.
        self.begun, self.flown = 0, 0

    def __len__(self) -> int:
        whole = min(max(self.begun - 1, 0), self._rounds - 1)
        return (whole * self._task.waypoints + self.flown) * self._searches

    def tensors(self) -> dict[str, Tensor]:
        """Return its memory by name, for checkpoints."""
        return {
            "path": self._path,
            "means": self._means,
            "action": self._action,
            "reward": self._reward,
        }

    def begin(self, means: Tensor, start: Tensor) -> None:
        """Begin a round; once the memory is full, the oldest one is forgotten."""
        self.begun, self.flown = self.begun + 1, 0
        slot = (self.begun - 1) % self._rounds
        self._means[slot] = means
        self._path[slot, :, 0] = start

    def add(self, action: Tensor, reward: Tensor, position: Tensor) -> None:
        """Add one step of every search and where it ended."""
        slot = (self.begun - 1) % self._rounds
        self._action[slot, :, self.flown] = action
        self._reward[slot, :, self.flown] = reward
        self.flown += 1
        self._path[slot, :, self.flown] = position

    def sample(self, size: int, generator: torch.Generator) -> Batch:
        """Return random transitions."""
        task, n = self._task, self._task.waypoints
        device = self._path.device
        pick = torch.randint(len(self), (size,), generator=generator, device=device)
        # Counted from the oldest round on, step by step; the last round may not be over.
        search, pick = pick % self._searches, pick // self._searches
        step, age = pick % n, pick // n
        whole = min(self.begun - 1, self._rounds - 1)
        slot = (self.begun - 1 - whole + age) % self._rounds
        path, means = self._path[slot, search], self._means[slot, search]
        return Batch(
            observe(task.layout, path, step, means, VARIANCE),
            self._action[slot, search, step],
            self._reward[slot, search, step],
            observe(task.layout, path, step + 1, means, VARIANCE),
            step + 1 == n,
        )
