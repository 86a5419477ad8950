"""Stable-Baselines3's soft actor-critic in our environment: a peer to measure against."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from gymnasium.spaces import Box
from stable_baselines3 import SAC
from stable_baselines3.common.vec_env import VecEnv

from wisar_planner.policy.observation import DIRECTIONS, NUMBERS, VIEW_WIDTH, Observation
from wisar_planner.training.environment import SearchEnvironment

_WIDTH = DIRECTIONS * VIEW_WIDTH + NUMBERS


class FlatSearches(VecEnv):
    """Our environment as Stable-Baselines3 wants it: the observation laid flat.

    Parameters
    ----------
    environment : SearchEnvironment
        The searches.
    reward_scale : float
        Factor of the reward.
    """

    def __init__(self, environment: SearchEnvironment, reward_scale: float = 0.2) -> None:
        self.searches = environment
        self._scale = reward_scale
        self._action = torch.zeros(0)
        super().__init__(
            len(environment.heading),
            Box(-np.inf, np.inf, (_WIDTH,), np.float32),
            Box(-1.0, 1.0, (1,), np.float32),
        )

    def reset(self) -> np.ndarray[Any, Any]:
        """Return what the searches show; each starts anew by itself."""
        return flat(self.searches.observe()).numpy()

    def step_async(self, actions: np.ndarray[Any, Any]) -> None:
        """Keep the actions, turns in units of pi."""
        self._action = torch.as_tensor(actions[:, 0])

    def step_wait(self) -> Any:
        """Fly one step of each."""
        reward, done = self.searches.step(self._action)
        shown = self.reset()
        # The value of what follows a search's end is never asked for.
        infos = [
            {"terminal_observation": row} if end else {}
            for row, end in zip(shown, done, strict=True)
        ]
        return shown, (self._scale * reward).numpy(), done.numpy(), infos

    def close(self) -> None:
        """Nothing is open."""

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Return an attribute for each search."""
        return [getattr(self, attr_name, None)] * self.num_envs

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Refuse: searches have no attributes of their own."""
        raise NotImplementedError

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> Any:
        """Refuse: searches have no methods of their own."""
        raise NotImplementedError

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        """Return that no search is wrapped."""
        return [False] * self.num_envs


def flat(observation: Observation) -> torch.Tensor:
    """Return observations laid flat, (B, W)."""
    return torch.cat([observation.view.flatten(1), observation.numbers], dim=1)


def peer_learner(
    environment: SearchEnvironment, *, batch: int, updates: int, learning_rate: float = 3e-4
) -> SAC:
    """Return Stable-Baselines3's learner in an environment.

    Parameters
    ----------
    environment : SearchEnvironment
        Where it learns.
    batch : int
        Transitions per update.
    updates : int
        Updates per step of all searches.
    learning_rate : float
        Of all its optimisers; the default is its own.
    """
    return SAC(
        "MlpPolicy",
        FlatSearches(environment),
        learning_rate=learning_rate,
        batch_size=batch,
        buffer_size=200_000,
        learning_starts=4 * len(environment.heading),
        train_freq=1,
        gradient_steps=updates,
        gamma=0.99,
        tau=0.005,
        seed=0,
        device="cpu",
    )
