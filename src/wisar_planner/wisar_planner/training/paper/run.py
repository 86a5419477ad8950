"""A training run of the paper's policy: fly, learn, validate, keep what is needed to go on."""

from __future__ import annotations

import dataclasses
import json
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import torch
from safetensors.torch import save_file
from torch import Tensor
from torch.utils.tensorboard import SummaryWriter

from wisar_planner.errors import InvalidInput
from wisar_planner.training.paper.config import PaperConfig
from wisar_planner.training.paper.environment import PaperEnvironment, TaskSettings
from wisar_planner.training.paper.learner import Learner
from wisar_planner.training.paper.observation import is_inside
from wisar_planner.training.paper.replay import Replay
from wisar_planner.training.records import (
    Validation,
    card_of,
    read_checkpoint,
    write_checkpoint,
)
from wisar_planner.training.streams import training_generator, validation_generator


class PaperRun:
    """One run, in a folder of its own.

    Parameters
    ----------
    config : PaperConfig
        What to train.
    folder : Path, optional
        Where the run keeps its checkpoint, its log and its best model; without it, nowhere.
    device : torch.device
        Where to compute; the CPU gives the same result for the same seed.
    """

    def __init__(self, config: PaperConfig, folder: Path | None, device: torch.device) -> None:
        self.config, self.folder, self.device = config, folder, device
        self.generator = training_generator(config.seed, device)
        self.environment = PaperEnvironment(config.environments, config.task, self.generator)
        self.learner = Learner(config.sac, config.network, config.task.layout, config.seed, device)
        # No run needs a memory for more steps than it flies.
        self.replay = Replay(
            min(config.buffer_size, config.steps), config.environments, config.task, device
        )
        self.steps, self.updates, self.seconds = 0, 0, 0.0
        self.best_share = 0.0
        self.validations: list[Validation] = []

    def train(self, on_progress: Callable[[int, int], None] | None = None) -> Iterator[Validation]:
        """Train to the end, or on from where a checkpoint was.

        Parameters
        ----------
        on_progress : callable, optional
            Told steps and updates after each step.

        Yields
        ------
        Validation
            After each validation; the checkpoint and, when it is the best so far, the model are
            written by then.
        """
        c = self.config
        figures: dict[str, list[Tensor]] = {}
        log = None
        if self.folder is not None:
            self.folder.mkdir(parents=True, exist_ok=True)
            log = SummaryWriter(str(self.folder), purge_step=self.steps)
        began = time.monotonic()
        while self.steps < c.steps:
            before = self.steps
            for each in self._round(on_progress):
                for name, value in each.items():
                    figures.setdefault(name, []).append(value)
            crossed = self.steps // c.validation_every > before // c.validation_every
            if crossed or self.steps >= c.steps:
                self.seconds += time.monotonic() - began
                means = {name: float(torch.stack(v).mean()) for name, v in figures.items()}
                figures.clear()
                result = self._validated(means)
                if log is not None:
                    result.log(log)
                yield result
                began = time.monotonic()
        if log is not None:
            log.close()

    def _round(self, on_progress: Callable[[int, int], None] | None) -> Iterator[dict[str, Tensor]]:
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
            if on_progress is not None:
                on_progress(self.steps, self.updates)

    def _uniform(self) -> Tensor:
        return torch.rand(self.config.environments, generator=self.generator, device=self.device)

    def _validated(self, figures: dict[str, float]) -> Validation:
        judged = validate(self.learner, self.config.task, self.config.validation_maps, self.device)
        figures = {**figures, "out_of_area": judged.out_of_area}
        result = Validation(
            self.steps, self.updates, self.seconds, judged.efficiency, judged.share, figures
        )
        self.validations.append(result)
        best = judged.share > self.best_share
        self.best_share = max(self.best_share, judged.share)
        if self.folder is not None:
            if best:
                self._save_model(self.folder, result)
            self.save_checkpoint()
        return result

    def _save_model(self, folder: Path, result: Validation) -> None:
        """Write the actor's weights and a card beside them."""
        path = folder / f"{self.config.name}.safetensors"
        save_file({k: v.contiguous() for k, v in self.learner.actor.state_dict().items()}, path)
        config = dataclasses.asdict(self.config)
        card = {
            "what": "The paper's policy: a squashed Gaussian over the absolute heading",
            "parameters": self.learner.parameters,
            **card_of(config, result, self.config.validation_maps, self.device),
        }
        path.with_suffix(".json").write_text(json.dumps(card, indent=2) + "\n", encoding="utf-8")

    # Checkpoints; a round is over whenever one is written, so the environment has no state.

    def save_checkpoint(self) -> None:
        """Write all that the run needs to go on as if it had not stopped."""
        if self.folder is None:
            return
        counters = {
            "steps": self.steps,
            "updates": self.updates,
            "seconds": self.seconds,
            "best_share": self.best_share,
            "begun": self.replay.begun,
            "config": dataclasses.asdict(self.config),
            "validations": [vars(each) for each in self.validations],
        }
        tensors = {"generator": self.generator.get_state()} | self._tensors()
        write_checkpoint(self.folder, tensors, counters)

    def load_checkpoint(self) -> None:
        """Go on from the folder's checkpoint.

        Raises
        ------
        InvalidInput
            When it cannot be read or belongs to another configuration.
        """
        if self.folder is None:
            raise InvalidInput("folder: a run without a folder has no checkpoint")
        config = dataclasses.asdict(self.config)
        stored, counters = read_checkpoint(self.folder, config, self.device)
        self.learner.load(stored)
        for name, tensor in self.replay.tensors().items():
            tensor.copy_(stored[f"replay.{name}"])
        self.generator.set_state(stored["generator"].cpu())
        self.replay.begun, self.replay.flown = counters["begun"], self.config.task.waypoints
        self.steps, self.updates = counters["steps"], counters["updates"]
        self.seconds, self.best_share = counters["seconds"], counters["best_share"]
        self.validations = [Validation(**each) for each in counters["validations"]]

    def _tensors(self) -> dict[str, Tensor]:
        replay = {f"replay.{name}": value for name, value in self.replay.tensors().items()}
        return self.learner.tensors() | replay


class Judgement(NamedTuple):
    """How good a policy is on the validation maps.

    Attributes
    ----------
    efficiency, share : float
        Mean e_p and mean share of the bound, as in `training.run.fly_validation`.
    out_of_area : float
        Share of the steps that end outside the area.
    """

    efficiency: float
    share: float
    out_of_area: float


@torch.no_grad()
def validate(learner: Learner, task: TaskSettings, maps: int, device: torch.device) -> Judgement:
    """Return how good the most likely headings are.

    Parameters
    ----------
    learner : Learner
        The learner.
    task : TaskSettings
        The task.
    maps : int
        Number of maps; the same ones whenever it is the same.
    device : torch.device
        Where to compute.
    """
    environment = PaperEnvironment(maps, task, validation_generator(device))
    for _ in range(task.waypoints):
        environment.step(learner.act(environment.observe(), None))
    outside = ~is_inside(environment.path[:, 1:])
    return Judgement(
        float((environment.seen / environment.in_area).mean()),
        float((environment.seen / environment.bound).mean()),
        float(outside.float().mean()),
    )
