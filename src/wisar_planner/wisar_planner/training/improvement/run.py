"""A run of policy iteration: rounds of branches, critics and imitation, each validated."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from wisar_planner.errors import InvalidInput
from wisar_planner.policy.heading import GAUSSIAN
from wisar_planner.policy.model import find_model, load_model, save_model
from wisar_planner.policy.observation import Observation
from wisar_planner.training.improvement.branches import Labels, fly_branches
from wisar_planner.training.improvement.config import ImprovementConfig
from wisar_planner.training.improvement.critics import learn_critics
from wisar_planner.training.improvement.imitation import imitate
from wisar_planner.training.improvement.networks import (
    Networks,
    Policy,
    corrected_turn,
    likeliest_turn,
    make_networks,
)
from wisar_planner.training.improvement.value import learn_value
from wisar_planner.training.judging import Flights, fly_maps
from wisar_planner.training.records import Validation, card_of
from wisar_planner.training.run import OnProgress, Run
from wisar_planner.training.streams import validation_generator


class ImprovementRun(Run[ImprovementConfig]):
    """A run of policy iteration; see `Run`.

    It is validated before the first round, too. Environments begin anew with each round, so that a
    checkpoint needs none.

    Raises
    ------
    InvalidInput
        When the policy to improve cannot be loaded.
    """

    def __init__(
        self, config: ImprovementConfig, folder: Path | None, device: torch.device
    ) -> None:
        super().__init__(config, folder, device)
        start = load_model(find_model(config.start))
        if start.distribution != GAUSSIAN:
            raise InvalidInput(
                f"start: policy iteration improves policies with Gaussian turns, {config.start} is "
                f"{start.distribution}; start from sac_plain or train by config/ppo.yaml"
            )
        self._start = start.card
        self.actor: Networks = {
            name: torch.tensor(value, device=device, requires_grad=True)
            for name, value in start.weights.items()
        }
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

        policy = partial(likeliest_turn, self.actor)
        value_error = learn_value(c, policy, self._value, self.generator, on_steps)
        labels = self._with_earlier(fly_branches(c, policy, self._value, self.generator, on_steps))
        rng = np.random.default_rng([c.seed, len(self.validations)])
        critics, left = learn_critics(c, labels, rng, self.generator, on_update)
        teacher = self._teacher(critics)
        loss = imitate(c, self.actor, teacher, self.generator, on_steps, on_update)
        return {
            "value_error": value_error,
            "critics_leave": left,
            "imitation_loss": loss,
            "teacher": self._share_of(teacher),
        }

    def _teacher(self, critics: Networks) -> Policy:
        """Return the present policy corrected by critics; it stays when the policy learns."""
        frozen = {name: each.detach().clone() for name, each in self.actor.items()}

        def teacher(shown: Observation) -> Tensor:
            with torch.no_grad():
                return corrected_turn(frozen, critics, shown, self.config.margin)

        return teacher

    def _with_earlier(self, fresh: Labels) -> Labels:
        """Return the latest labels, fresh and earlier ones, and keep them."""
        old = self._labels
        both = fresh if old is None else Labels(*map(torch.cat, zip(old, fresh, strict=True)))
        self._labels = Labels(*(each[-self.config.remembered_labels :] for each in both))
        return self._labels

    def _share_of(self, policy: Policy) -> float:
        """Return the share of the bound of a policy on the validation maps."""
        maps = self.config.validation_maps
        return float(fly_maps(policy, maps, validation_generator(self.device)).share.mean())

    def fly(self, maps: int, generator: torch.Generator) -> Flights:
        """Fly the present policy; see `Run.fly`."""
        return fly_maps(partial(likeliest_turn, self.actor), maps, generator)

    def _save_model(self, path: Path, result: Validation) -> None:
        weights = {name: value.detach().cpu().numpy() for name, value in self.actor.items()}
        start = {
            name: self._start[name]
            for name in ("algorithm", "config", "training", "start", "weights_sha256")
            if name in self._start
        }
        card = {
            "what": "search policy, a squashed Gaussian over the next turn; see docs/policy.md",
            **card_of(self.plain_config(), result, self.config.validation_maps, self.device),
            "algorithm": "policy iteration from a policy trained by soft actor-critic (start)",
            "start": start,
        }
        save_model(path, weights, card)

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
