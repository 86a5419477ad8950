"""Soft actor-critic with ordinary critics Q(s, a), as the paper trained it.

Haarnoja et al. (2018), "Soft Actor-Critic Algorithms and Applications"; what the paper's table does
not name is as in Stable-Baselines3 2.1.0: discount 0.99, twin critics, targets that follow after
every update, a temperature that starts at 1 and is steered to an entropy of minus the number of
actions, one learning rate for all.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from wisar_planner.training.config import check_at_least, check_positive, check_positive_share
from wisar_planner.training.paper.network import Actor, Critics, NetworkSettings
from wisar_planner.training.paper.observation import Layout
from wisar_planner.training.paper.replay import Batch
from wisar_planner.training.records import make_optimizer_tensors, optimizer_tensors

_TARGET_ENTROPY = -1.0


@dataclass(frozen=True)
class LearnerSettings:
    """Settings of the algorithm.

    Parameters
    ----------
    learning_rate : float
        Learning rate of Adam, of actor, critics and temperature.
    batch : int
        Transitions per update.
    tau : float
        Share of the critics that moves into their targets at each update.
    gamma : float
        Discount per step.
    """

    learning_rate: float = 1e-6
    batch: int = 1024
    tau: float = 1e-4
    gamma: float = 0.99

    def __post_init__(self) -> None:
        check_positive(self, "learning_rate")
        check_at_least(self, batch=1)
        check_positive_share(self, "tau", "gamma")


class Learner:
    """Actor, critics and temperature, and how they learn.

    Parameters
    ----------
    settings : LearnerSettings
        Settings.
    network : NetworkSettings
        Size of the networks.
    layout : Layout
        Layout of the observation.
    seed : int
        Seed of the first parameters.
    device : torch.device
        Where to compute.
    """

    def __init__(
        self,
        settings: LearnerSettings,
        network: NetworkSettings,
        layout: Layout,
        seed: int,
        device: torch.device,
    ) -> None:
        self.settings = settings
        # PyTorch's modules draw from its global generator, which is given back as it was.
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            self.actor = Actor(network, layout).to(device)
            self.critics = Critics(network, layout).to(device)
        self.targets = copy.deepcopy(self.critics).requires_grad_(False)
        self.log_temperature = torch.zeros((), device=device, requires_grad=True)
        rate = settings.learning_rate
        self.optimizers = {
            "actor": torch.optim.Adam(self.actor.parameters(), lr=rate, fused=True),
            "critics": torch.optim.Adam(self.critics.parameters(), lr=rate, fused=True),
            "temperature": torch.optim.Adam([self.log_temperature], lr=rate),
        }

    @property
    def parameters(self) -> int:
        """Parameters of the policy network."""
        return sum(each.numel() for each in self.actor.parameters())

    def update(self, batch: Batch, generator: torch.Generator) -> dict[str, Tensor]:
        """Learn from one batch.

        Parameters
        ----------
        batch : Batch
            Transitions.
        generator : torch.Generator
            Source of randomness.

        Returns
        -------
        dict of str to Tensor
            Losses and figures to log.
        """
        s = self.settings
        temperature = self.log_temperature.detach().exp()

        # Critics: the value of the action taken is the reward plus the soft value later on.
        with torch.no_grad():
            action, log_probability = self.actor.sample(batch.later, generator)
            values = self.targets(batch.later, action).amin(dim=0)
            soft = values - temperature * log_probability
            target = batch.reward + s.gamma * torch.where(batch.over, 0.0, soft)
        taken = self.critics(batch.now, batch.action)
        critic_loss = 0.5 * (taken - target).square().mean(dim=1).sum()
        self._step("critics", critic_loss)

        # Actor: towards actions that the critics value, as random as the temperature pays for.
        # The critics' own gradients are not asked for here: they are a third of the work.
        action, log_probability = self.actor.sample(batch.now, generator)
        self.critics.requires_grad_(False)
        values = self.critics(batch.now, action).amin(dim=0)
        self.critics.requires_grad_(True)
        actor_loss = (temperature * log_probability - values).mean()
        self._step("actor", actor_loss)

        # Temperature: up where the policy is less random than wanted, down where it is more.
        entropy = -log_probability.detach().mean()
        self._step("temperature", self.log_temperature * (entropy - _TARGET_ENTROPY))
        with torch.no_grad():
            torch._foreach_lerp_(_values(self.targets), _values(self.critics), s.tau)
        return {
            "critic_loss": critic_loss.detach(),
            "actor_loss": actor_loss.detach(),
            "value": taken.detach().mean(),
            "entropy": entropy,
            "temperature": temperature,
        }

    @torch.no_grad()
    def act(self, observation: Tensor, generator: torch.Generator | None) -> Tensor:
        """Return an action per search, (B,); the most likely ones without a generator."""
        if generator is None:
            mean, _ = self.actor(observation)
            return torch.tanh(mean)
        action, _ = self.actor.sample(observation, generator)
        return action

    def tensors(self) -> dict[str, Tensor]:
        """Return every tensor that changes, by name, for checkpoints."""
        found = {"temperature": self.log_temperature.detach()}
        for name, module in (
            ("actor", self.actor),
            ("critics", self.critics),
            ("targets", self.targets),
        ):
            found |= {f"{name}.{key}": value for key, value in module.state_dict().items()}
        found |= dict(optimizer_tensors(self.optimizers))
        return found

    def load(self, stored: dict[str, Tensor]) -> None:
        """Take over tensors as `tensors` returned them."""
        make_optimizer_tensors(self.optimizers)
        with torch.no_grad():
            for name, tensor in self.tensors().items():
                tensor.copy_(stored[name])

    def _step(self, name: str, loss: Tensor) -> None:
        optimizer = self.optimizers[name]
        optimizer.zero_grad(set_to_none=True)
        torch.autograd.backward(loss)
        optimizer.step()


def _values(module: nn.Module) -> list[Tensor]:
    return [each.detach() for each in module.parameters()]
