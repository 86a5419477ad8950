"""A run of proximal policy optimisation."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from wisar_planner.policy.heading import ACTOR_OUTPUTS, DIRECTED
from wisar_planner.policy.network import forward
from wisar_planner.policy.observation import Observation
from wisar_planner.training.environment import SearchEnvironment
from wisar_planner.training.networks import (
    Networks,
    Policy,
    likeliest_turn,
    make_networks,
    state_value,
)
from wisar_planner.training.policy_run import PolicyRun
from wisar_planner.training.ppo.config import PpoConfig
from wisar_planner.training.ppo.experience import Experience, fly_window, make_environments
from wisar_planner.training.ppo.imitation import imitate_step
from wisar_planner.training.ppo.turns import Turns, log_likelihood
from wisar_planner.training.records import make_optimizer_tensors, optimizer_tensors
from wisar_planner.training.run import OnProgress

# Decay of Adam's means: shorter memories than usual, as what is learned from changes.
_BETAS = (0.9, 0.98)


class PpoRun(PolicyRun[PpoConfig]):
    """A run of proximal policy optimisation; see `PolicyRun`.

    First the start is imitated, unless it is of the same distribution and size; then the value of
    states is learned, then both policy and value. When a run goes on from a checkpoint, its
    searches begin anew: thousands of maps are too much to keep.
    """

    algorithm = "proximal policy optimisation"

    def __init__(self, config: PpoConfig, folder: Path | None, device: torch.device) -> None:
        super().__init__(config, folder, device)
        if device.type == "cuda":
            # Products of 10 bits of mantissa are enough and several times as fast there.
            torch.backends.cuda.matmul.allow_tf32 = True
        self._teacher: Policy = partial(
            likeliest_turn, self._start_weights, self._start.distribution
        )
        rng = np.random.default_rng(config.seed)
        fresh = self._networks(rng, ACTOR_OUTPUTS)
        self._value = self._networks(rng, 1)
        self.imitation_steps = 0
        if self._start.distribution != DIRECTED or _shapes(fresh) != _shapes(self.actor):
            self.imitation_steps = config.imitation_steps
            self.actor, self._distribution = fresh, DIRECTED
        self._optimizers = {
            name: torch.optim.Adam(networks.values(), lr=config.rate, betas=_BETAS, fused=True)
            for name, networks in (("actor", self.actor), ("value", self._value))
        }
        make_optimizer_tensors(self._optimizers)

    def _networks(self, rng: np.random.Generator, outputs: int) -> Networks:
        return make_networks(
            rng, networks=1, outputs=outputs, channels=self.config.channels,
            blocks=self.config.blocks, device=self.device,
        )  # fmt: skip

    def _learn(self, on_progress: OnProgress) -> Iterator[dict[str, float]]:
        c = self.config
        environments = make_environments(c, self.generator)
        figures: dict[str, list[float]] = {}
        while self.steps < c.steps:
            if self.steps < self.imitation_steps:
                flown, found = c.environments, self._imitate(environments)
            else:
                flown, found = c.window * c.environments, self._improve(environments)
            for name, value in found.items():
                figures.setdefault(name, []).append(value)
            before, self.steps = self.steps, self.steps + flown
            on_progress(self.steps, self.updates)
            imitated = before < self.imitation_steps <= self.steps
            crossed = self.steps // c.validation_every != before // c.validation_every
            if imitated or crossed or self.steps >= c.steps:
                yield {name: float(np.mean(each)) for name, each in figures.items()}
                figures.clear()

    def _imitate(self, environments: list[SearchEnvironment]) -> dict[str, float]:
        c, done = self.config, self.steps / self.imitation_steps
        losses = [
            imitate_step(
                each, self.actor, self._teacher, self._optimizers["actor"], c.imitation_rate, done
            )
            for each in environments
        ]
        self.updates += len(losses)
        return {"imitation_loss": float(np.mean(losses))}

    def _improve(self, environments: list[SearchEnvironment]) -> dict[str, float]:
        """Fly a window of all searches and learn from it."""
        c = self.config
        began = self.imitation_steps + c.value_steps
        done = max(0.0, (self.steps - began) / max(1, c.steps - began))
        noise = c.noise[0] * (c.noise[1] / c.noise[0]) ** done
        entropy = c.entropy[0] + (c.entropy[1] - c.entropy[0]) * done
        for name, rate, least in (("actor", c.rate, 0.03), ("value", c.value_rate, 0.1)):
            self._optimizers[name].param_groups[0]["lr"] = rate * max(1.0 - done, least)
        flown = [
            fly_window(c, each, self.actor, self._value, noise, self.generator)
            for each in environments
        ]
        together = Experience(*(torch.cat(each) for each in zip(*flown, strict=True)))
        changes, entropies = [], []
        for batch in together.batches(c.batch, self.generator):
            shown = Observation(batch.view, batch.numbers)
            error = (state_value(self._value, shown) - batch.returns).square().mean()
            self._update("value", error)
            if self.steps >= began:
                output = forward(self.actor, *shown)[0]
                likelihood, spread = log_likelihood(
                    output, Turns(batch.direction, batch.deviation), noise
                )
                change = torch.exp((likelihood - batch.log_likelihood).clamp(-10.0, 10.0))
                gain = torch.minimum(
                    change * batch.advantage,
                    change.clamp(1.0 - c.clip, 1.0 + c.clip) * batch.advantage,
                )
                self._update("actor", -gain.mean() - entropy * spread.mean())
                changes.append((change.detach() - 1.0).abs().mean())
                entropies.append(spread.detach().mean())
            self.updates += 1
        found = {"surprise": float(together.surprise.square().mean().sqrt())}
        if changes:
            found["change"] = float(torch.stack(changes).mean())
            found["entropy"] = float(torch.stack(entropies).mean())
        return found

    def _update(self, name: str, loss: Tensor) -> None:
        optimizer = self._optimizers[name]
        optimizer.zero_grad(set_to_none=True)
        loss.backward()  # type: ignore[no-untyped-call]
        if name == "actor":
            torch.nn.utils.clip_grad_norm_(self.actor.values(), self.config.largest_gradient)
        optimizer.step()

    def _tensors(self) -> dict[str, Tensor]:
        found = {f"actor.{name}": each.detach() for name, each in self.actor.items()}
        found |= {f"value.{name}": each.detach() for name, each in self._value.items()}
        return found | dict(optimizer_tensors(self._optimizers))

    def _restore(self, stored: dict[str, Tensor], counters: Mapping[str, Any]) -> None:
        for name, tensor in self._tensors().items():
            tensor.copy_(stored[name])


def _shapes(networks: Networks) -> dict[str, torch.Size]:
    return {name: each.shape for name, each in networks.items()}
