"""A run of policy iteration: rounds of branches, critics and imitation, each validated."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.utils.tensorboard import SummaryWriter

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
from wisar_planner.training.records import (
    Validation,
    card_of,
    read_checkpoint,
    write_checkpoint,
)
from wisar_planner.training.run import fly_validation
from wisar_planner.training.streams import training_generator
from wisar_planner.training.worlds import WorldDistribution


class ImprovementRun:
    """One run, in a folder of its own.

    Parameters
    ----------
    config : ImprovementConfig
        What to improve, and how.
    folder : Path
        Where the run keeps its checkpoint, its log and its best model.
    device : torch.device
        Where to compute; the CPU gives the same result for the same seed.

    Raises
    ------
    InvalidInput
        When the policy to improve cannot be loaded.
    """

    def __init__(self, config: ImprovementConfig, folder: Path, device: torch.device) -> None:
        self.config, self.folder, self.device = config, folder, device
        self.generator = training_generator(config.seed, device)
        start = load_model(find_model(config.start))
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
        self.steps, self.updates, self.seconds = 0, 0, 0.0
        self.best_share = 0.0
        self.validations: list[Validation] = []

    def train(self, on_progress: Callable[[int, int], None] | None = None) -> Iterator[Validation]:
        """Improve to the last round, or on from where a checkpoint was.

        Parameters
        ----------
        on_progress : callable, optional
            Told steps and updates as they grow.

        Yields
        ------
        Validation
            Of the policy before the first round and after each; the checkpoint and, when it is
            the best so far, the model are written by then.
        """
        self.folder.mkdir(parents=True, exist_ok=True)
        with SummaryWriter(str(self.folder), purge_step=self.steps) as log:
            if not self.validations:
                yield self._validated(log, {})
            while len(self.validations) <= self.config.rounds:
                began = time.monotonic()
                figures = self._round(on_progress or (lambda _steps, _updates: None))
                self.seconds += time.monotonic() - began
                yield self._validated(log, figures)

    def _round(self, on_progress: Callable[[int, int], None]) -> dict[str, float]:
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
            "teacher": self._fly_validation(teacher)[1],
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

    def _fly_validation(self, policy: Policy) -> tuple[float, float]:
        maps = self.config.validation_maps
        return fly_validation(policy, maps, self.device, WorldDistribution())

    def _validated(self, log: SummaryWriter, figures: dict[str, float]) -> Validation:
        efficiency, share = self._fly_validation(partial(likeliest_turn, self.actor))
        result = Validation(self.steps, self.updates, self.seconds, efficiency, share, figures)
        self.validations.append(result)
        result.log(log)
        better, self.best_share = share > self.best_share, max(share, self.best_share)
        if better:
            weights = {name: value.detach().cpu().numpy() for name, value in self.actor.items()}
            save_model(self.folder / f"{self.config.name}.safetensors", weights, self._card(result))
        self.save_checkpoint()
        return result

    def _card(self, validation: Validation) -> dict[str, Any]:
        config = dataclasses.asdict(self.config)
        start = {
            name: self._start[name]
            for name in ("algorithm", "config", "training", "start", "weights_sha256")
            if name in self._start
        }
        return {
            "what": "search policy, a squashed Gaussian over the next turn; see docs/policy.md",
            **card_of(config, validation, self.config.validation_maps, self.device),
            "algorithm": "policy iteration from a policy trained by soft actor-critic (start)",
            "start": start,
        }

    # Checkpoints; environments begin anew with each round.

    def save_checkpoint(self) -> None:
        """Write all that the run needs to go on as if it had not stopped."""
        counters = {
            "steps": self.steps,
            "updates": self.updates,
            "seconds": self.seconds,
            "best_share": self.best_share,
            "config": dataclasses.asdict(self.config),
            "validations": [vars(each) for each in self.validations],
        }
        write_checkpoint(self.folder, self._tensors(), counters)

    def load_checkpoint(self) -> None:
        """Go on from the folder's checkpoint.

        Raises
        ------
        InvalidInput
            When it cannot be read or belongs to another configuration.
        """
        config = dataclasses.asdict(self.config)
        stored, counters = read_checkpoint(self.folder, config, self.device)
        with torch.no_grad():
            for owner, networks in (("actor", self.actor), ("value", self._value)):
                for name, tensor in networks.items():
                    tensor.copy_(stored[f"{owner}.{name}"])
        if "labels.turns" in stored:
            self._labels = Labels(*(stored[f"labels.{name}"] for name in Labels._fields))
        self.generator.set_state(stored["generator"].cpu())
        self.steps, self.updates = counters["steps"], counters["updates"]
        self.seconds, self.best_share = counters["seconds"], counters["best_share"]
        self.validations = [Validation(**each) for each in counters["validations"]]

    def _tensors(self) -> dict[str, Tensor]:
        found = {"generator": self.generator.get_state()}
        found |= {f"actor.{name}": each.detach() for name, each in self.actor.items()}
        found |= {f"value.{name}": each.detach() for name, each in self._value.items()}
        if self._labels is not None:
            found |= {f"labels.{name}": each for name, each in self._labels._asdict().items()}
        return found
