"""What a training run leaves behind: its log, its checkpoint, the common part of its card."""

from __future__ import annotations

import json
import platform
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors import safe_open
from safetensors.torch import load_file, save_file
from torch import Tensor
from torch.utils.tensorboard import SummaryWriter

from wisar_planner.errors import InvalidInput

Optimizers = Mapping[str, torch.optim.Optimizer]

_CHECKPOINT = "checkpoint.safetensors"


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

    def score(self, paper_share: float) -> float:
        """Return what a run keeps the policy of that has most of it.

        The share of the bound; where other worlds were flown, too, of both kinds as training has
        them.

        Parameters
        ----------
        paper_share : float
            Share of the worlds with the paper's setup.
        """
        others = self.figures.get("other_worlds", self.share)
        return paper_share * self.share + (1.0 - paper_share) * others

    def log(self, writer: SummaryWriter) -> None:
        """Write to TensorBoard."""
        for name, value in (
            ("validation/e_p", self.efficiency),
            ("validation/share_of_bound", self.share),
            *((f"training/{name}", value) for name, value in self.figures.items()),
        ):
            writer.add_scalar(name, value, self.steps)
        writer.flush()


def card_of(
    config: dict[str, Any], result: Validation, maps: int, device: torch.device
) -> dict[str, Any]:
    """Return what the card of every trained model says of its training and validation."""
    return {
        "name": config["name"],
        "algorithm": "soft actor-critic, twin critics, learned temperature",
        "config": config,
        "training": {
            "seed": config["seed"],
            "steps": result.steps,
            "updates": result.updates,
            "wall_time_s": round(result.seconds, 1),
            "hardware": hardware(device),
            "versions": {
                "python": platform.python_version(),
                "torch": torch.__version__,
                "numpy": np.__version__,
            },
        },
        "validation": {
            "maps": maps,
            "e_p": round(result.efficiency, 4),
            "share_of_bound": round(result.share, 4),
            "note": "estimated on the training raster, on maps that chose this checkpoint",
        },
    }


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


# Checkpoints


def has_checkpoint(folder: Path) -> bool:
    """Return whether a run left a checkpoint in its folder."""
    return (folder / _CHECKPOINT).exists()


def write_checkpoint(
    folder: Path, tensors: Mapping[str, Tensor], counters: Mapping[str, Any]
) -> None:
    """Replace the folder's checkpoint, whole or not at all.

    Parameters
    ----------
    folder : Path
        The run's folder.
    tensors : mapping of str to Tensor
        All that changes while the run trains.
    counters : mapping
        The rest, ready for JSON; its `config` is compared when the checkpoint is read.
    """
    new = folder / "checkpoint.new"
    save_file(
        {name: value.contiguous() for name, value in tensors.items()},
        new,
        metadata={"counters": json.dumps(counters)},
    )
    new.replace(folder / _CHECKPOINT)


def read_checkpoint(
    folder: Path, config: dict[str, Any], device: torch.device
) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """Return tensors and counters of the folder's checkpoint.

    Raises
    ------
    InvalidInput
        When it cannot be read or belongs to another configuration.
    """
    path = folder / _CHECKPOINT
    counters = read_counters(folder)
    try:
        stored = load_file(path, device=str(device))
    except Exception as error:  # safetensors raises its own kinds
        raise InvalidInput(f"{path} cannot be read: {error}") from None
    if counters["config"] != json.loads(json.dumps(config)):
        raise InvalidInput(
            f"{path} belongs to another configuration; take another folder or remove it"
        )
    return stored, counters


def read_tensors(folder: Path, owner: str) -> dict[str, Tensor]:
    """Return those of the tensors in the folder's checkpoint that are called `owner`.NAME, by NAME.

    Raises
    ------
    InvalidInput
        When the checkpoint cannot be read.
    """
    path, above = folder / _CHECKPOINT, f"{owner}."
    try:
        with safe_open(path, "pt") as stored:
            names = [name for name in stored.keys() if name.startswith(above)]  # noqa: SIM118
            return {name.removeprefix(above): stored.get_tensor(name) for name in names}
    except Exception as error:  # safetensors raises its own kinds
        raise InvalidInput(f"{path} cannot be read: {error}") from None


def read_counters(folder: Path) -> dict[str, Any]:
    """Return what the folder's checkpoint says beside its tensors: configuration, validations, ...

    Raises
    ------
    InvalidInput
        When there is no checkpoint or it cannot be read.
    """
    path = folder / _CHECKPOINT
    try:
        with path.open("rb") as file:
            header = json.loads(file.read(int.from_bytes(file.read(8), "little")))
        counters: dict[str, Any] = json.loads(header["__metadata__"]["counters"])
    except FileNotFoundError:
        raise InvalidInput(f"{folder} holds no {_CHECKPOINT}; give the folder of a run") from None
    except (ValueError, KeyError, OverflowError, MemoryError) as error:
        raise InvalidInput(f"{path} cannot be read: {error}") from None
    if not counters["validations"]:
        raise InvalidInput(f"{path} is from before the first validation")
    return counters


def optimizer_tensors(optimizers: Optimizers) -> Iterator[tuple[str, Tensor]]:
    """Yield the optimisers' tensors by name."""
    for name, optimizer in optimizers.items():
        for i, parameter in enumerate(optimizer.param_groups[0]["params"]):
            for key, value in optimizer.state[parameter].items():
                yield f"optimizer.{name}.{i}.{key}", value


def make_optimizer_tensors(optimizers: Optimizers) -> None:
    """Let optimisers make their tensors, which they do at their first step, to be overwritten."""
    for optimizer in optimizers.values():
        for parameter in optimizer.param_groups[0]["params"]:
            parameter.grad = torch.zeros_like(parameter)
        optimizer.step()
