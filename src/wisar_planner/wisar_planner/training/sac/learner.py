"""Soft actor-critic (Haarnoja et al. 2018, "Soft Actor-Critic Algorithms and Applications").

Twin critics, a squashed Gaussian actor, a learned temperature. Two things differ from the usual
form because the action is one turn on a ring. A critic gives a value per direction and is read at
the action by periodic interpolation, so that one pass values any number of actions; and transitions
span several steps (the entropy bonus counts from the last one on).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial

import numpy as np
import torch
from torch import Tensor

from wisar_planner.policy.heading import ACTOR_OUTPUTS, actor_distribution, value_at
from wisar_planner.policy.observation import Observation
from wisar_planner.training import squashed_gaussian
from wisar_planner.training.ablation import Network, make_network
from wisar_planner.training.config import check_at_least, check_positive, check_positive_share
from wisar_planner.training.sac.replay import Batch


@dataclass(frozen=True)
class SacSettings:
    """Settings of the algorithm.

    Parameters
    ----------
    channels, blocks : int
        Size of the networks, see `policy.network.initial_parameters`.
    critic_rate, actor_rate, temperature_rate : float
        Learning rates of Adam.
    tau : float
        Share of the critics that moves into their targets at each update.
    action_samples : int
        Actions per state that expectations over the policy are taken from.
    least_temperature : float
        The temperature does not fall under this.
    """

    channels: int = 64
    blocks: int = 3
    critic_rate: float = 1e-3
    actor_rate: float = 5e-4
    temperature_rate: float = 1e-3
    tau: float = 0.005
    action_samples: int = 4
    least_temperature: float = 1e-4

    def __post_init__(self) -> None:
        check_at_least(self, channels=1, blocks=1, action_samples=1)
        check_positive(self, "critic_rate", "actor_rate", "temperature_rate", "least_temperature")
        check_positive_share(self, "tau")


class Sac:
    """Actor, critics and temperature, and how they learn.

    Parameters
    ----------
    settings : SacSettings
        Settings.
    rng : numpy.random.Generator
        Source of the first parameters.
    device : torch.device
        Where to compute.
    network : Network, optional
        Network of actor and critics; the ring network unless given.
    """

    def __init__(
        self,
        settings: SacSettings,
        rng: np.random.Generator,
        device: torch.device,
        network: Network | None = None,
    ) -> None:
        self.settings = settings
        self._network = network or make_network("")
        make = partial(
            self._network.make, rng, channels=settings.channels, blocks=settings.blocks,
            device=device,
        )  # fmt: skip
        self.actor = make(networks=1, outputs=ACTOR_OUTPUTS)
        self.critics = make(networks=2)
        self.targets = {name: value.detach().clone() for name, value in self.critics.items()}
        self.log_temperature = torch.tensor(math.log(0.02), device=device, requires_grad=True)
        self.optimizers = {
            "critics": torch.optim.Adam(self.critics.values(), lr=settings.critic_rate, fused=True),
            "actor": torch.optim.Adam(self.actor.values(), lr=settings.actor_rate, fused=True),
            "temperature": torch.optim.Adam(
                [self.log_temperature], lr=settings.temperature_rate, betas=(0.5, 0.999)
            ),
        }

    def update(
        self, batch: Batch, target_entropy: float, rate: float, generator: torch.Generator
    ) -> dict[str, Tensor]:
        """Learn from one batch.

        Parameters
        ----------
        batch : Batch
            Transitions.
        target_entropy : float
            Entropy of the policy that the temperature is steered to, nats.
        rate : float
            Factor of all learning rates.
        generator : torch.Generator
            Source of randomness.

        Returns
        -------
        dict of str to Tensor
            Losses and figures to log.
        """
        s = self.settings
        for name, full in (
            ("critics", s.critic_rate),
            ("actor", s.actor_rate),
            ("temperature", s.temperature_rate),
        ):
            self.optimizers[name].param_groups[0]["lr"] = rate * full
        temperature = self.log_temperature.detach().exp().clamp(min=s.least_temperature)

        # Critics: the value of the action taken is the reward plus the soft value later on.
        with torch.no_grad():
            action, log_probability = self._sample(batch.later, generator)
            values = value_at(self._values(self.targets, batch.later), action.expand(2, -1, -1))
            soft = values.amin(dim=0) - temperature * log_probability
            target = batch.reward + batch.discount * soft.mean(dim=-1)
        now = self._values(self.critics, batch.now)
        taken = value_at(now, batch.action[None, :, None].expand(2, -1, -1))[..., 0]
        critic_loss = 0.5 * (taken - target).square().sum(dim=0).mean()
        self._step("critics", critic_loss)

        # Actor: towards actions that the critics value, as random as the temperature pays for.
        action, log_probability = self._sample(batch.now, generator)
        values = value_at(now.detach(), action.expand(2, -1, -1)).amin(dim=0)
        actor_loss = (temperature * log_probability - values).mean()
        self._step("actor", actor_loss)

        # Temperature: up where the policy is less random than wanted, down where it is more.
        entropy = -log_probability.detach().mean()
        self._step("temperature", self.log_temperature * (entropy - target_entropy))
        with torch.no_grad():
            self.log_temperature.clamp_(min=math.log(s.least_temperature))
            torch._foreach_lerp_(list(self.targets.values()), list(self.critics.values()), s.tau)
        return {
            "critic_loss": critic_loss.detach(),
            "value": taken.detach().mean(),
            "entropy": entropy,
            "temperature": temperature,
        }

    @torch.no_grad()
    def act(self, observation: Observation, generator: torch.Generator | None) -> Tensor:
        """Return an action per search, (B,); the most likely ones without a generator."""
        if generator is None:
            return torch.tanh(self._policy(observation)[0])
        mean, log_std = self._policy(observation)
        return squashed_gaussian.sample(mean, log_std, mean.shape, generator)[0]

    def _policy(self, observation: Observation) -> tuple[Tensor, Tensor]:
        return actor_distribution(self._network.forward(self.actor, *observation)[0])

    def _values(self, critics: dict[str, Tensor], observation: Observation) -> Tensor:
        """Return values per direction, (2, B, DIRECTIONS)."""
        return self._network.forward(critics, *observation)[:, 0]

    def _sample(
        self, observation: Observation, generator: torch.Generator
    ) -> tuple[Tensor, Tensor]:
        """Return actions and the logarithms of their probability densities, (B, M) each."""
        mean, log_std = (x[:, None] for x in self._policy(observation))
        shape = torch.Size((len(mean), self.settings.action_samples))
        return squashed_gaussian.sample(mean, log_std, shape, generator)

    def _step(self, name: str, loss: Tensor) -> None:
        optimizer = self.optimizers[name]
        optimizer.zero_grad(set_to_none=True)
        loss.backward()  # type: ignore[no-untyped-call]
        optimizer.step()
