"""A training run: fly, learn, validate, keep what is needed to go on."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.utils.tensorboard import SummaryWriter

from wisar_planner.policy.model import save_model
from wisar_planner.policy.observation import Observation
from wisar_planner.training.ablation import make_environment, make_network
from wisar_planner.training.config import TrainingConfig, as_dict
from wisar_planner.training.records import (
    Validation,
    card_of,
    make_optimizer_tensors,
    optimizer_tensors,
    read_checkpoint,
    write_checkpoint,
)
from wisar_planner.training.replay import Replay
from wisar_planner.training.sac import Sac
from wisar_planner.training.streams import training_generator, validation_generator
from wisar_planner.training.worlds import WorldDistribution


class TrainingRun:
    """One run, in a folder of its own.

    Parameters
    ----------
    config : TrainingConfig
        What to train.
    folder : Path
        Where the run keeps its checkpoint, its log and its best model.
    device : torch.device
        Where to compute; the CPU gives the same result for the same seed.
    """

    def __init__(self, config: TrainingConfig, folder: Path, device: torch.device) -> None:
        self.config, self.folder, self.device = config, folder, device
        self.generator = training_generator(config.seed, device)
        self.environment = make_environment(
            config.ablation, config.environments, config.worlds, self.generator, stagger=True
        )
        self.sac = Sac(
            config.sac, np.random.default_rng(config.seed), device, make_network(config.ablation)
        )
        self.replay = Replay(
            config.replay, config.environments, config.n_step, config.gamma, device
        )
        self.steps, self.updates, self.seconds = 0, 0, 0.0
        self._owed = 0.0  # updates, where they are no whole number per step
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
        self.folder.mkdir(parents=True, exist_ok=True)
        with SummaryWriter(str(self.folder), purge_step=self.steps) as log:
            observation = self.environment.observe()
            figures: dict[str, list[Tensor]] = {}
            began = time.monotonic()
            while self.steps < c.steps:
                learning = self.steps >= c.warm_up_steps
                if learning:
                    action = self.sac.act(observation, self.generator)
                else:
                    action = 2.0 * self._uniform() - 1.0
                reward, done = self.environment.step(action)
                self.replay.add(observation, action, c.reward_scale * reward, done)
                observation = self.environment.observe()
                self.steps += c.environments
                if learning:
                    self._owed += c.updates
                while self._owed >= 1.0:
                    self._owed -= 1.0
                    self.updates += 1
                    for name, value in self._update().items():
                        figures.setdefault(name, []).append(value)
                if on_progress is not None:
                    on_progress(self.steps, self.updates)
                if (
                    self.steps // c.validation_every
                    != (self.steps - c.environments) // c.validation_every
                    or self.steps >= c.steps
                ):
                    self.seconds += time.monotonic() - began
                    means = {
                        name: float(torch.stack(values).mean()) for name, values in figures.items()
                    }
                    figures.clear()
                    yield self._validated(log, means)
                    began = time.monotonic()

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

    def _validated(self, log: SummaryWriter, figures: dict[str, float]) -> Validation:
        efficiency, share = fly_validation(
            lambda shown: self.sac.act(shown, None),
            self.config.validation_maps,
            self.device,
            WorldDistribution(),
            self.config.ablation,
        )
        result = Validation(self.steps, self.updates, self.seconds, efficiency, share, figures)
        self.validations.append(result)
        result.log(log)
        better, self.best_share = share > self.best_share, max(share, self.best_share)
        if better and not self.config.ablation:
            weights = {name: value.detach().cpu().numpy() for name, value in self.sac.actor.items()}
            save_model(self.folder / f"{self.config.name}.safetensors", weights, self._card(result))
        self.save_checkpoint()
        return result

    def _card(self, validation: Validation) -> dict[str, Any]:
        return {
            "what": "search policy, a squashed Gaussian over the next turn; see docs/policy.md",
            **card_of(as_dict(self.config), validation, self.config.validation_maps, self.device),
        }

    # Checkpoints

    def save_checkpoint(self) -> None:
        """Write all that the run needs to go on as if it had not stopped."""
        counters = {
            "steps": self.steps,
            "updates": self.updates,
            "owed": self._owed,
            "seconds": self.seconds,
            "best_share": self.best_share,
            "added": self.replay.added,
            "config": as_dict(self.config),
            "validations": [vars(each) for each in self.validations],
        }
        write_checkpoint(self.folder, _tensors_of(self), counters)

    def load_checkpoint(self) -> None:
        """Go on from the folder's checkpoint.

        Raises
        ------
        InvalidInput
            When it cannot be read or belongs to another configuration.
        """
        stored, counters = read_checkpoint(self.folder, as_dict(self.config), self.device)
        make_optimizer_tensors(self.sac.optimizers)
        with torch.no_grad():
            for name, tensor in _tensors_of(self).items():
                tensor.copy_(stored[name])
        self.generator.set_state(stored["generator"].cpu())
        self.replay.added = counters["added"]
        self.steps, self.updates = counters["steps"], counters["updates"]
        self._owed = counters["owed"]
        self.seconds, self.best_share = counters["seconds"], counters["best_share"]
        self.validations = [Validation(**each) for each in counters["validations"]]


def _tensors_of(run: TrainingRun) -> dict[str, Tensor]:
    """Return every tensor that changes while a run trains, by name."""
    found: dict[str, Tensor] = {"generator": run.generator.get_state()}
    for owner, values in (
        ("actor", run.sac.actor),
        ("critics", run.sac.critics),
        ("targets", run.sac.targets),
        ("environment", run.environment.tensors()),
        ("replay", run.replay.tensors()),
    ):
        found |= {f"{owner}.{name}": value.detach() for name, value in values.items()}
    found["temperature"] = run.sac.log_temperature.detach()
    found |= dict(optimizer_tensors(run.sac.optimizers))
    return found


@torch.no_grad()
def fly_validation(
    act: Callable[[Observation], Tensor],
    maps: int,
    device: torch.device,
    worlds: WorldDistribution,
    ablation: str = "",
) -> tuple[float, float]:
    """Return mean e_p and mean share of the bound of a policy.

    Parameters
    ----------
    act : callable
        From what searches show to their turns, see `SearchEnvironment.step`.
    maps : int
        Number of maps; the same ones whenever it is the same.
    device : torch.device
        Where to compute.
    worlds : WorldDistribution
        What the maps look like.
    ablation : str
        The policy's ablation.
    """
    environment = make_environment(ablation, maps, worlds, validation_generator(device))
    unseen, steps = environment.unseen, environment.steps.clone()
    in_area = environment.in_area.clone()
    step_area = (2.0 * unseen.radius * unseen.step).clone()
    swept = step_area * steps + math.pi * unseen.radius.square()
    seen = environment.seen.clone()
    searching = torch.ones(maps, device=device)
    for _ in range(int(steps.max())):
        reward, done = environment.step(act(environment.observe()))
        seen += searching * reward * step_area
        searching = searching * ~done
    return float((seen / in_area).mean()), float((seen / swept).mean())
