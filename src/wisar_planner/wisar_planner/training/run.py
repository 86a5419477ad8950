"""A training run: fly, learn, validate, keep what is needed to go on."""

from __future__ import annotations

import json
import math
import platform
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors.torch import load_file, save_file
from torch import Tensor
from torch.utils.tensorboard import SummaryWriter

from wisar_planner.errors import InvalidInput
from wisar_planner.policy.model import save_model
from wisar_planner.policy.observation import Observation
from wisar_planner.training.ablation import make_environment, make_network
from wisar_planner.training.config import TrainingConfig, as_dict
from wisar_planner.training.replay import Replay
from wisar_planner.training.sac import Sac
from wisar_planner.training.worlds import WorldDistribution

# Streams of random numbers that no seed of a training run can reach: its generator gets the seed
# itself. The final evaluation draws its maps with NumPy, from `wisar evaluate`'s own streams.
_VALIDATION_SEED = 2**40


@dataclass(frozen=True)
class Validation:
    """How good the policy was at some point of its training.

    Attributes
    ----------
    steps, updates : int
        Steps flown and updates made until then.
    seconds : float
        Time spent on them, s, without that of validations.
    efficiency : float
        Mean probability efficiency e_p on the validation maps.
    share : float
        Mean share of the bound, the most probable ground that fits into the swath.
    figures : dict of str to float
        Means of the figures of the updates since the last validation.
    """

    steps: int
    updates: int
    seconds: float
    efficiency: float
    share: float
    figures: dict[str, float]


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
        self.generator = torch.Generator(device=device).manual_seed(config.seed)
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
        for name, value in (
            ("validation/e_p", efficiency),
            ("validation/share_of_bound", share),
            *((f"training/{name}", value) for name, value in figures.items()),
        ):
            log.add_scalar(name, value, self.steps)
        better, self.best_share = share > self.best_share, max(share, self.best_share)
        if better and not self.config.ablation:
            weights = {name: value.detach().cpu().numpy() for name, value in self.sac.actor.items()}
            save_model(self.folder / f"{self.config.name}.safetensors", weights, self._card(result))
        self.save_checkpoint()
        return result

    def _card(self, validation: Validation) -> dict[str, Any]:
        return {
            "name": self.config.name,
            "what": "search policy, a squashed Gaussian over the next turn; see docs/policy.md",
            "algorithm": "soft actor-critic, twin critics, learned temperature",
            "config": as_dict(self.config),
            "training": {
                "seed": self.config.seed,
                "steps": validation.steps,
                "updates": validation.updates,
                "wall_time_s": round(validation.seconds, 1),
                "hardware": hardware(self.device),
                "versions": {
                    "python": platform.python_version(),
                    "torch": torch.__version__,
                    "numpy": np.__version__,
                },
            },
            "validation": {
                "maps": self.config.validation_maps,
                "e_p": round(validation.efficiency, 4),
                "share_of_bound": round(validation.share, 4),
                "note": "estimated on the training raster, on maps that chose this checkpoint",
            },
        }

    # Checkpoints

    def save_checkpoint(self) -> None:
        """Write all that the run needs to go on as if it had not stopped."""
        tensors = {name: value.contiguous() for name, value in _tensors_of(self).items()}
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
        new = self.folder / "checkpoint.new"
        save_file(tensors, new, metadata={"counters": json.dumps(counters)})
        new.replace(self.folder / "checkpoint.safetensors")

    def load_checkpoint(self) -> None:
        """Go on from the folder's checkpoint.

        Raises
        ------
        InvalidInput
            When it cannot be read or belongs to another configuration.
        """
        path = self.folder / "checkpoint.safetensors"
        try:
            stored = load_file(path, device=str(self.device))
            with path.open("rb") as file:
                header = json.loads(file.read(int.from_bytes(file.read(8), "little")))
            counters = json.loads(header["__metadata__"]["counters"])
        except Exception as error:  # safetensors raises its own kinds
            raise InvalidInput(f"{path} cannot be read: {error}") from None
        if counters["config"] != json.loads(json.dumps(as_dict(self.config))):
            raise InvalidInput(
                f"{path} belongs to another configuration; take another folder or remove it"
            )
        # Adam makes its state at the first step; give it one to be overwritten.
        for optimizer in self.sac.optimizers.values():
            for parameter in optimizer.param_groups[0]["params"]:
                parameter.grad = torch.zeros_like(parameter)
            optimizer.step()
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
    for name, optimizer in run.sac.optimizers.items():
        for i, parameter in enumerate(optimizer.param_groups[0]["params"]):
            for key, value in optimizer.state[parameter].items():
                found[f"optimizer.{name}.{i}.{key}"] = value
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
    generator = torch.Generator(device=device).manual_seed(_VALIDATION_SEED)
    environment = make_environment(ablation, maps, worlds, generator)
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


def hardware(device: torch.device) -> str:
    """Return what the training ran on, in words."""
    if device.type == "cuda":
        return torch.cuda.get_device_name(device)
    model = platform.processor() or platform.machine()
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        model = next(line.split(":", 1)[1].strip() for line in lines if "model name" in line)
    except (OSError, StopIteration):
        pass
    return f"{torch.get_num_threads()} thread(s) of {model}"
