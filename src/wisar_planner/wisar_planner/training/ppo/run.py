"""A run of proximal policy optimisation."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from wisar_planner.policy.heading import ACTOR_OUTPUTS, DIRECTED, likeliest_turn
from wisar_planner.policy.model import find_model, load_model, save_model
from wisar_planner.policy.network import forward
from wisar_planner.policy.observation import Observation
from wisar_planner.training.environment import SearchEnvironment
from wisar_planner.training.improvement.networks import (
    Networks,
    Policy,
    make_networks,
    state_value,
)
from wisar_planner.training.judging import Flights, fly_maps
from wisar_planner.training.ppo.config import PpoConfig
from wisar_planner.training.ppo.experience import Experience, fly_window, make_environments
from wisar_planner.training.ppo.imitation import imitate_step
from wisar_planner.training.ppo.turns import Turns, log_likelihood
from wisar_planner.training.records import (
    Validation,
    card_of,
    make_optimizer_tensors,
    optimizer_tensors,
)
from wisar_planner.training.run import OnProgress, Run

# Decay of Adam's means: shorter memories than usual, as what is learned from changes.
_BETAS = (0.9, 0.98)


class PpoRun(Run[PpoConfig]):
    """A run of proximal policy optimisation; see `Run`.

    First the start is imitated, unless it is of the same distribution and size; then the value of
    states is learned, then both policy and value. When a run goes on from a checkpoint, its
    searches begin anew: thousands of maps are too much to keep.

    Raises
    ------
    InvalidInput
        When the policy to start from cannot be loaded.
    """

    def __init__(self, config: PpoConfig, folder: Path | None, device: torch.device) -> None:
        super().__init__(config, folder, device)
        if device.type == "cuda":
            # Products of 10 bits of mantissa are enough and several times as fast there.
            torch.backends.cuda.matmul.allow_tf32 = True
        start = load_model(find_model(config.start))
        self._start = start.card
        weights = {
            name: torch.tensor(value, device=device) for name, value in start.weights.items()
        }
        self._teacher: Policy = partial(_likeliest, weights, start.distribution)
        rng = np.random.default_rng(config.seed)
        self.actor = self._networks(rng, ACTOR_OUTPUTS)
        self._value = self._networks(rng, 1)
        self._optimizers = {
            name: torch.optim.Adam(networks.values(), lr=config.rate, betas=_BETAS, fused=True)
            for name, networks in (("actor", self.actor), ("value", self._value))
        }
        make_optimizer_tensors(self._optimizers)
        same_size = {k: v.shape for k, v in weights.items()} == {
            k: v.shape for k, v in self.actor.items()
        }
        if start.distribution == DIRECTED and same_size:
            with torch.no_grad():
                for name, value in weights.items():
                    self.actor[name].copy_(value)
            self.imitation_steps = 0
        else:
            self.imitation_steps = config.imitation_steps

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

    def fly(self, maps: int, generator: torch.Generator) -> Flights:
        """Fly the present policy; see `Run.fly`."""
        policy = partial(_likeliest, self.actor, DIRECTED)
        flights = fly_maps(policy, maps, generator)
        worlds = self.config.worlds
        if worlds.paper_share == 1.0:
            return flights
        others = fly_maps(
            policy, maps // 2, generator, dataclasses.replace(worlds, paper_share=0.0)
        )
        return flights._replace(figures={"other_worlds": float(others.share.mean())})

    def _score(self, result: Validation) -> float:
        share, others = self.config.worlds.paper_share, result.figures.get("other_worlds", 0.0)
        return share * result.share + (1.0 - share) * others

    def _save_model(self, path: Path, result: Validation) -> None:
        weights = {name: value.detach().cpu().numpy() for name, value in self.actor.items()}
        names = ("algorithm", "config", "training", "start", "distribution", "weights_sha256")
        card = {
            "what": "search policy, one of 32 directions with an offset each; see docs/policy.md",
            **card_of(self.plain_config(), result, self.config.validation_maps, self.device),
            "algorithm": "proximal policy optimisation from another policy (start)",
            "distribution": DIRECTED,
            "start": {name: self._start[name] for name in names if name in self._start},
        }
        if "other_worlds" in result.figures:
            card["validation"]["share_of_bound_other_worlds"] = round(
                result.figures["other_worlds"], 4
            )
        save_model(path, weights, card)

    def _tensors(self) -> dict[str, Tensor]:
        found = {f"actor.{name}": each.detach() for name, each in self.actor.items()}
        found |= {f"value.{name}": each.detach() for name, each in self._value.items()}
        return found | dict(optimizer_tensors(self._optimizers))

    def _restore(self, stored: dict[str, Tensor], counters: Mapping[str, Any]) -> None:
        for name, tensor in self._tensors().items():
            tensor.copy_(stored[name])


@torch.no_grad()
def _likeliest(actor: Mapping[str, Tensor], distribution: str, shown: Observation) -> Tensor:
    """Return the turns of a policy as planners fly them."""
    result: Tensor = likeliest_turn(forward(actor, *shown)[0], distribution)
    return result
