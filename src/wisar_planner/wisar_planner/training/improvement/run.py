"""A run of policy iteration: rounds of branches, critics and imitation, each validated."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from wisar_planner.policy.observation import Observation
from wisar_planner.training.improvement.branches import Labels, fly_branches
from wisar_planner.training.improvement.config import ImprovementConfig
from wisar_planner.training.improvement.critics import learn_critics
from wisar_planner.training.improvement.imitation import imitate
from wisar_planner.training.improvement.value import learn_value
from wisar_planner.training.networks import (
    Networks,
    Policy,
    corrected_turn,
    likeliest_turn,
    make_networks,
)
from wisar_planner.training.policy_run import PolicyRun
from wisar_planner.training.run import OnProgress
from wisar_planner.training.streams import validation_generator


class ImprovementRun(PolicyRun[ImprovementConfig]):
    """A run of policy iteration; see `PolicyRun`.

    It is validated before the first round, too. Environments begin anew with each round, so that a
    checkpoint needs none.
    """

    algorithm = "policy iteration"

    def __init__(
        self, config: ImprovementConfig, folder: Path | None, device: torch.device
    ) -> None:
        super().__init__(config, folder, device)
        self._value = make_networks(
            np.random.default_rng(config.seed),
            networks=1,
            channels=config.channels,
            blocks=config.blocks,
            device=device,
        )
        self._labels: Labels | None = None

    def _learn(self, on_progress: OnProgress) -> Iterator[dict[str, float]]:
        if not self.validations:
            yield {}
        while len(self.validations) <= self.config.rounds:
            yield self._round(on_progress)

    def _round(self, on_progress: OnProgress) -> dict[str, float]:
        c = self.config

        def on_steps(count: int) -> None:
            self.steps += count
            on_progress(self.steps, self.updates)

        def on_update() -> None:
            self.updates += 1

        policy = self._policy()
        value_error = learn_value(c, policy, self._value, self.generator, on_steps)
        labels = self._with_earlier(fly_branches(c, policy, self._value, self.generator, on_steps))
        rng = np.random.default_rng([c.seed, len(self.validations)])
        critics, left = learn_critics(c, labels, rng, self.generator, on_update)
        teacher = self._teacher(critics)
        loss = imitate(
            c, self.actor, self._distribution, teacher, self.generator, on_steps, on_update
        )
        taught = self._flights(teacher, c.validation_maps, validation_generator(self.device))
        return {
            "value_error": value_error,
            "critics_leave": left,
            "imitation_loss": loss,
            "teacher": float(taught.share.mean()),
            **{f"teacher_{name}": value for name, value in taught.figures.items()},
        }

    def _teacher(self, critics: Networks) -> Policy:
        """Return the present policy corrected by critics; it stays when the policy learns."""
        frozen = {name: each.detach().clone() for name, each in self.actor.items()}
        own = partial(likeliest_turn, frozen, self._distribution)

        def teacher(shown: Observation) -> Tensor:
            with torch.no_grad():
                return corrected_turn(own(shown), critics, shown, self.config.margin)

        return teacher

    def _with_earlier(self, fresh: Labels) -> Labels:
        """Return the latest labels, fresh and earlier ones, and keep them."""
        old = self._labels
        both = fresh if old is None else Labels(*map(torch.cat, zip(old, fresh, strict=True)))
        self._labels = Labels(*(each[-self.config.remembered_labels :] for each in both))
        return self._labels

    def _tensors(self) -> dict[str, Tensor]:
        found = {f"actor.{name}": each.detach() for name, each in self.actor.items()}
        found |= {f"value.{name}": each.detach() for name, each in self._value.items()}
        if self._labels is not None:
            found |= {f"labels.{name}": each for name, each in self._labels._asdict().items()}
        return found

    def _restore(self, stored: dict[str, Tensor], counters: Mapping[str, Any]) -> None:
        for owner, networks in (("actor", self.actor), ("value", self._value)):
            for name, tensor in networks.items():
                tensor.copy_(stored[f"{owner}.{name}"])
        if "labels.turns" in stored:
            self._labels = Labels(*(stored[f"labels.{name}"] for name in Labels._fields))
