"""A training run by soft actor-critic: fly, remember, learn from what is remembered."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from wisar_planner.policy.heading import GAUSSIAN
from wisar_planner.policy.model import save_model
from wisar_planner.training.ablation import make_environment, make_network
from wisar_planner.training.judging import Flights, fly_maps, fly_maps_exactly
from wisar_planner.training.records import (
    Validation,
    card_of,
    make_optimizer_tensors,
    optimizer_tensors,
)
from wisar_planner.training.run import OnProgress, Run
from wisar_planner.training.sac.config import SacConfig
from wisar_planner.training.sac.learner import Sac
from wisar_planner.training.sac.replay import Replay


class SacRun(Run[SacConfig]):
    """A run by soft actor-critic; see `Run`."""

    def __init__(self, config: SacConfig, folder: Path | None, device: torch.device) -> None:
        super().__init__(config, folder, device)
        self.environment = make_environment(
            config.ablation, config.environments, config.worlds, self.generator, stagger=True
        )
        self.sac = Sac(
            config.sac, np.random.default_rng(config.seed), device, make_network(config.ablation)
        )
        self.replay = Replay(
            config.replay, config.environments, config.n_step, config.gamma, device
        )
        self._owed = 0.0  # updates, where they are no whole number per step

    def _learn(self, on_progress: OnProgress) -> Iterator[dict[str, float]]:
        c = self.config
        observation = self.environment.observe()
        figures: dict[str, list[Tensor]] = {}
        while self.steps < c.steps:
            learning = self.steps >= c.warm_up_steps
            if learning:
                action = self.sac.act(observation, self.generator)
            else:
                action = 2.0 * self._uniform() - 1.0
            reward, done = self.environment.step(action)
            self.replay.add(observation, action, c.reward_scale * reward, done)
            observation = self.environment.observe()
            before, self.steps = self.steps, self.steps + c.environments
            if learning:
                self._owed += c.updates
            while self._owed >= 1.0:
                self._owed -= 1.0
                self.updates += 1
                for name, value in self._update().items():
                    figures.setdefault(name, []).append(value)
            on_progress(self.steps, self.updates)
            crossed = self.steps // c.validation_every != before // c.validation_every
            if crossed or self.steps >= c.steps:
                yield {name: float(torch.stack(each).mean()) for name, each in figures.items()}
                figures.clear()

    def _update(self) -> dict[str, Tensor]:
        c, done = self.config, self.steps / self.config.steps
        left = (1.0 - done) / (1.0 - c.decay_from) if done > c.decay_from else 1.0
        first, last = c.entropy
        return self.sac.update(
            self.replay.sample(c.batch, self.generator),
            target_entropy=first + (last - first) * done,
            rate=max(left, 0.02),
            generator=self.generator,
        )

    def _uniform(self) -> Tensor:
        return torch.rand(self.config.environments, generator=self.generator, device=self.device)

    def fly(self, maps: int, generator: torch.Generator) -> Flights:
        """Fly the present policy; see `Run.fly`."""
        return fly_maps(
            lambda shown: self.sac.act(shown, None), maps, generator, ablation=self.config.ablation
        )

    def judge(
        self, maps: int, generator: torch.Generator, on_flown: Callable[[int], None]
    ) -> Flights:
        """Fly the present policy by the exact seen probability; see `Run.judge`."""
        return fly_maps_exactly(
            lambda shown: self.sac.act(shown, None), maps, generator, self.config.ablation, on_flown
        )

    def _save_model(self, path: Path, result: Validation) -> None:
        if self.config.ablation:
            return  # No planner could fly it.
        weights = {name: value.detach().cpu().numpy() for name, value in self.sac.actor.items()}
        card = {
            "what": "search policy, a squashed Gaussian over the next turn; see docs/policy.md",
            **card_of(self.plain_config(), result, self.config.validation_maps, self.device),
        }
        save_model(path, weights, card)

    def _tensors(self) -> dict[str, Tensor]:
        found: dict[str, Tensor] = {}
        for owner, values in (
            ("actor", self.sac.actor),
            ("critics", self.sac.critics),
            ("targets", self.sac.targets),
            ("environment", self.environment.tensors()),
            ("replay", self.replay.tensors()),
        ):
            found |= {f"{owner}.{name}": value.detach() for name, value in values.items()}
        found["temperature"] = self.sac.log_temperature.detach()
        return found | dict(optimizer_tensors(self.sac.optimizers))

    def _counters(self) -> dict[str, Any]:
        return {"owed": self._owed, "added": self.replay.added, "distribution": GAUSSIAN}

    def _restore(self, stored: dict[str, Tensor], counters: Mapping[str, Any]) -> None:
        make_optimizer_tensors(self.sac.optimizers)
        for name, tensor in self._tensors().items():
            tensor.copy_(stored[name])
        self.replay.added, self._owed = counters["added"], counters["owed"]
