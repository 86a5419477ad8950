"""A run of expert iteration: rounds of search and of learning from it, each validated."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from wisar_planner.errors import InvalidInput
from wisar_planner.policy.model import Model
from wisar_planner.policy.network import forward
from wisar_planner.training.divergence import check_finite
from wisar_planner.training.expert_iteration.config import ExpertConfig
from wisar_planner.training.expert_iteration.labels import Labels, lesson
from wisar_planner.training.imitation_loss import imitation_loss
from wisar_planner.training.judging import Flights, fly_problems, planned
from wisar_planner.training.networks import learn, mirrored, optimizer_of, widened
from wisar_planner.training.policy_run import PolicyRun
from wisar_planner.training.problems import random_problems
from wisar_planner.training.processes import in_processes
from wisar_planner.training.records import (
    has_checkpoint,
    make_optimizer_tensors,
    optimizer_tensors,
    read_tensors,
)
from wisar_planner.training.run import OnProgress
from wisar_planner.training.worlds import WorldDistribution

# Flights that a process labels at a time.
_AT_A_TIME = 16
# What a checkpoint calls its labels.
_LABELS = "labels"


class ExpertRun(PolicyRun[ExpertConfig]):
    """A run of expert iteration; see `PolicyRun`.

    It is validated before the first round, too, and flies validation maps as plans fly maps. Search
    runs in as many processes as PyTorch has threads.

    Raises
    ------
    InvalidInput
        Also when the policy to begin with has more channels than are wanted.
    """

    algorithm = "expert iteration"
    judged = "by the exact seen probability"

    def __init__(self, config: ExpertConfig, folder: Path | None, device: torch.device) -> None:
        super().__init__(config, folder, device)
        if config.channels:
            self._widen(config.channels)
        self._optimizers = {"actor": optimizer_of(self.actor, config.rate)}
        make_optimizer_tensors(self._optimizers)
        self._rounds: list[Labels] = []

    def _widen(self, channels: int) -> None:
        """Give the policy more channels to learn with."""
        weights = {name: value.detach().cpu().numpy() for name, value in self.actor.items()}
        if (before := weights["view"].shape[1]) > channels:
            raise InvalidInput(
                f"channels: {self.config.start} has {before}, more than {channels}; leave the "
                "field out, or begin with another policy"
            )
        wider = widened(weights, channels, np.random.default_rng(self.config.seed))
        self.actor = {
            name: torch.tensor(value, device=self.device, requires_grad=True)
            for name, value in wider.items()
        }

    def fly(self, maps: int, generator: torch.Generator) -> Flights:
        """Fly the present policy; see `Run.fly`."""
        worlds, model = self.config.worlds, self._model()
        others = 0 if worlds.paper_share == 1.0 else max(1, maps // 2)
        # The same maps of the paper's setup as other runs draw from this generator.
        problems = itertools.chain(
            random_problems(maps, 0, WorldDistribution(), generator),
            random_problems(0, others, worlds, generator),
        )
        flown = torch.tensor(list(fly_problems(problems, model)))
        efficiency, share = flown[:maps].T
        figures = {"other_worlds": float(flown[maps:, 1].mean())} if others else {}
        return Flights(efficiency, share, figures)

    def _model(self) -> Model:
        """Return the present policy as planners fly it."""
        return planned(self.actor, self._distribution)

    def _learn(self, on_progress: OnProgress) -> Iterator[dict[str, float]]:
        if not self.validations:
            self._recall()
            yield {}
        while len(self.validations) <= self.config.rounds:
            yield self._round(on_progress)

    def _round(self, on_progress: OnProgress) -> dict[str, float]:
        c, model, count = self.config, self._model(), len(self.validations)
        lessons = []
        tasks = ((c, model, flights, (c.seed, count, first)) for first, flights in self._batches())
        for each in in_processes(lesson, tasks):
            lessons.append(each)
            self.steps += len(each.labels.turn)
            on_progress(self.steps, self.updates)
        self._remember(Labels.joined([each.labels for each in lessons]))
        seen, found = (sum(getattr(each, name) for each in lessons) for name in ("seen", "found"))
        loss = self._imitate()
        self._check_policy()
        return {"search_brings": found / seen - 1.0, "loss": loss}

    @torch.no_grad()
    def _check_policy(self) -> None:
        """Raise Diverged where the policy does not say a number: planners would fly nowhere."""
        view, numbers = (
            torch.from_numpy(each[:1]).float().to(self.device) for each in self._rounds[-1][:2]
        )
        check_finite("outputs of the policy", forward(self.actor, view, numbers))

    def _batches(self) -> Iterator[tuple[int, tuple[int, int]]]:
        """Yield the first flight of each batch of a round, and how many are of either kind.

        Those of the paper's setup are spread evenly, so that their share is right in all batches
        together.
        """
        flights, share = self.config.flights, self.config.worlds.paper_share
        for first in range(0, flights, _AT_A_TIME):
            end = min(first + _AT_A_TIME, flights)
            paper = round(share * end) - round(share * first)
            yield first, (paper, end - first - paper)

    def _recall(self) -> None:
        """Remember the labels of earlier runs, the latest rounds of all of them last."""
        runs = [read_labels(Path(each)) for each in self.config.labels]
        for together in range(-max(map(len, runs), default=0), 0):
            for each in runs:
                if len(each) >= -together:
                    self._remember(each[together])

    def _remember(self, fresh: Labels) -> None:
        """Add the labels of a round; forget the oldest rounds beyond what is to be remembered."""
        rounds = max(1, self.config.remembered_flights // self.config.flights)
        self._rounds = [*self._rounds, fresh][-rounds:]

    def _imitate(self) -> float:
        """Learn from the labels of all rounds that are remembered; return the mean loss."""
        c = self.config
        view, numbers, turn = (torch.from_numpy(each) for each in Labels.joined(self._rounds))
        optimizer, losses = self._optimizers["actor"], []
        for _ in range(c.updates):
            some = torch.randint(
                len(turn), (c.batch,), generator=self.generator, device=self.device
            )
            flip = torch.rand(c.batch, generator=self.generator, device=self.device) < 0.5
            # Labels stay in main memory: there are millions.
            views, told, turns = (
                each[some.cpu()].to(self.device) for each in (view, numbers, turn)
            )
            shown, wanted = mirrored(views.float(), turns, flip)
            loss = imitation_loss(forward(self.actor, shown, told)[0], self._distribution, wanted)
            learn(optimizer, loss, c.rate, self.updates / (c.rounds * c.updates))
            self.updates += 1
            losses.append(loss.detach())
        return float(torch.stack(losses).mean())

    def _tensors(self) -> dict[str, Tensor]:
        found = {f"actor.{name}": each.detach() for name, each in self.actor.items()}
        found |= dict(optimizer_tensors(self._optimizers))
        for place, labels in enumerate(self._rounds):
            for name, each in labels._asdict().items():
                found[f"{_LABELS}.{place}.{name}"] = torch.from_numpy(each)
        return found

    def _restore(self, stored: dict[str, Tensor], counters: Mapping[str, Any]) -> None:
        for name, tensor in self._tensors().items():
            tensor.copy_(stored[name])
        labels = f"{_LABELS}."
        self._rounds = _rounds_in(
            {k.removeprefix(labels): v for k, v in stored.items() if k.startswith(labels)}
        )


def read_labels(folder: Path) -> list[Labels]:
    """Return the labels that a run of expert iteration remembers, by round.

    Raises
    ------
    InvalidInput
        When the folder has no checkpoint of such a run.
    """
    if not has_checkpoint(folder):
        raise InvalidInput(
            f"labels: {folder} holds no run; train it first, or leave it out of the configuration"
        )
    if not (labels := _rounds_in(read_tensors(folder, _LABELS))):
        raise InvalidInput(f"labels: {folder} is no run of expert iteration that has labels")
    return labels


def _rounds_in(stored: Mapping[str, Tensor]) -> list[Labels]:
    rounds = len({name.split(".")[0] for name in stored})
    return [
        Labels(*(stored[f"{place}.{name}"].cpu().numpy() for name in Labels._fields))
        for place in range(rounds)
    ]
