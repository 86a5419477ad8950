"""A training run of the paper's policy: fly whole searches, learn on the way."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import torch
from safetensors.torch import save_file
from torch import Tensor

from wisar_planner.training.judging import Flights
from wisar_planner.training.paper.config import PaperConfig
from wisar_planner.training.paper.environment import PaperEnvironment
from wisar_planner.training.paper.learner import Learner
from wisar_planner.training.paper.observation import is_inside
from wisar_planner.training.paper.replay import Replay
from wisar_planner.training.records import Validation, card_of
from wisar_planner.training.run import OnProgress, Run


class PaperRun(Run[PaperConfig]):
    """A run of the paper's policy; see `Run`.

    It is validated between searches, so that a checkpoint needs no environment.
    """

    def __init__(self, config: PaperConfig, folder: Path | None, device: torch.device) -> None:
        super().__init__(config, folder, device)
        self.environment = PaperEnvironment(config.environments, config.task, self.generator)
        self.learner = Learner(config.sac, config.network, config.task.layout, config.seed, device)
        # No run needs a memory for more steps than it flies.
        self.replay = Replay(
            min(config.buffer_size, config.steps), config.environments, config.task, device
        )

    def _learn(self, on_progress: OnProgress) -> Iterator[dict[str, float]]:
        c = self.config
        figures: dict[str, list[Tensor]] = {}
        while self.steps < c.steps:
            before = self.steps
            for each in self._round(on_progress):
                for name, value in each.items():
                    figures.setdefault(name, []).append(value)
            crossed = self.steps // c.validation_every > before // c.validation_every
            if crossed or self.steps >= c.steps:
                yield {name: float(torch.stack(v).mean()) for name, v in figures.items()}
                figures.clear()

    def _round(self, on_progress: OnProgress) -> Iterator[dict[str, Tensor]]:
        """Fly searches from their start to their end; yield the figures of each update."""
        c = self.config
        self.environment.begin()
        self.replay.begin(self.environment.means, self.environment.position)
        for _ in range(c.task.waypoints):
            if self.steps < c.learning_starts:
                action = 2.0 * self._uniform() - 1.0
            else:
                action = self.learner.act(self.environment.observe(), self.generator)
            reward = self.environment.step(action)
            self.replay.add(action, reward, self.environment.position)
            self.steps += c.environments
            due = (self.steps // c.environments) % c.train_every == 0
            if due and self.steps > c.learning_starts:
                for _ in range(c.gradient_steps):
                    self.updates += 1
                    batch = self.replay.sample(c.sac.batch, self.generator)
                    yield self.learner.update(batch, self.generator)
            on_progress(self.steps, self.updates)

    def _uniform(self) -> Tensor:
        return torch.rand(self.config.environments, generator=self.generator, device=self.device)

    @torch.no_grad()
    def fly(self, maps: int, generator: torch.Generator) -> Flights:
        """Fly the present policy; see `Run.fly`. Tells the share of steps that leave the area."""
        environment = PaperEnvironment(maps, self.config.task, generator)
        for _ in range(self.config.task.waypoints):
            environment.step(self.learner.act(environment.observe(), None))
        outside = ~is_inside(environment.path[:, 1:])
        return Flights(
            environment.seen / environment.in_area,
            environment.seen / environment.bound,
            {"out_of_area": float(outside.float().mean())},
        )

    def _save_model(self, path: Path, result: Validation) -> None:
        save_file({k: v.contiguous() for k, v in self.learner.actor.state_dict().items()}, path)
        card = {
            "what": "The paper's policy: a squashed Gaussian over the absolute heading",
            "parameters": self.learner.parameters,
            **card_of(self.plain_config(), result, self.config.validation_maps, self.device),
        }
        path.with_suffix(".json").write_text(json.dumps(card, indent=2) + "\n", encoding="utf-8")

    def _tensors(self) -> dict[str, Tensor]:
        replay = {f"replay.{name}": value for name, value in self.replay.tensors().items()}
        return self.learner.tensors() | replay

    def _counters(self) -> dict[str, Any]:
        return {"begun": self.replay.begun}

    def _restore(self, stored: dict[str, Tensor], counters: Mapping[str, Any]) -> None:
        self.learner.load(stored)
        for name, tensor in self.replay.tensors().items():
            tensor.copy_(stored[f"replay.{name}"])
        self.replay.begun, self.replay.flown = counters["begun"], self.config.task.waypoints
