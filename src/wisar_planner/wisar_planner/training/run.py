"""What every training run does: learn, be validated, keep what is needed to go on."""

from __future__ import annotations

import dataclasses
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, ClassVar, Generic, Protocol, TypeVar

import torch
from torch import Tensor
from torch.utils.tensorboard import SummaryWriter

from wisar_planner.errors import InvalidInput
from wisar_planner.training.divergence import check_finite
from wisar_planner.training.judging import Flights
from wisar_planner.training.records import Validation, read_checkpoint, write_checkpoint
from wisar_planner.training.streams import training_generator, validation_generator

# Bytes of the state of a GPU's generator; that of the CPU has thousands.
_CUDA_STATE = 16

#: Told steps and updates as they grow.
OnProgress = Callable[[int, int], None]


class RunConfig(Protocol):
    """What the configurations of all runs have; they are dataclasses of plain values."""

    __dataclass_fields__: ClassVar[dict[str, Any]]

    @property
    def name(self) -> str:
        """Name of the model."""

    @property
    def seed(self) -> int:
        """Seed of everything random."""

    @property
    def steps(self) -> int:
        """Steps flown until the end, about."""

    @property
    def validation_maps(self) -> int:
        """Maps of the paper's setup that the policy is judged on."""


Config = TypeVar("Config", bound=RunConfig)


class Run(ABC, Generic[Config]):
    """One run, in a folder of its own.

    Parameters
    ----------
    config
        What to train.
    folder : Path, optional
        Where the run keeps its checkpoint, its log and its best model; without it, nowhere.
    device : torch.device
        Where to compute; the CPU gives the same result for the same seed.
    """

    def __init__(self, config: Config, folder: Path | None, device: torch.device) -> None:
        self.config, self.folder, self.device = config, folder, device
        self.generator = training_generator(config.seed, device)
        self.steps, self.updates, self.seconds = 0, 0, 0.0
        self.best_score, self.best_share = 0.0, 0.0
        self.validations: list[Validation] = []

    # What kinds of runs differ in.

    @abstractmethod
    def fly(self, maps: int, generator: torch.Generator) -> Flights:
        """Fly the present policy, without noise, on random maps of the paper's setup."""

    def judge(
        self, maps: int, generator: torch.Generator, on_flown: Callable[[int], None]
    ) -> Flights:
        """Fly as `fly` does; exact where the run can, and tell how many more maps were flown."""
        flights = self.fly(maps, generator)
        on_flown(maps)
        return flights

    @abstractmethod
    def _learn(self, on_progress: OnProgress) -> Iterator[dict[str, float]]:
        """Train on to the end; whenever a validation is due, yield figures since the last one."""

    @abstractmethod
    def _save_model(self, path: Path, result: Validation) -> None:
        """Write the present policy, which is the best so far, with its card."""

    @abstractmethod
    def _tensors(self) -> dict[str, Tensor]:
        """Return every tensor that a checkpoint keeps, by name."""

    def _counters(self) -> dict[str, Any]:
        """Return what else a checkpoint keeps."""
        return {}

    @abstractmethod
    def _restore(self, stored: dict[str, Tensor], counters: Mapping[str, Any]) -> None:
        """Take over what `_tensors` and `_counters` gave when the checkpoint was written."""

    def _score(self, result: Validation) -> float:
        """Return what the best policy has most of."""
        return result.share

    # What they share.

    def train(self, on_progress: OnProgress | None = None) -> Iterator[Validation]:
        """Train to the end, or on from where a checkpoint was.

        Parameters
        ----------
        on_progress : callable, optional
            Told steps and updates as they grow.

        Yields
        ------
        Validation
            After each validation; the checkpoint and, when it is the best so far, the model are
            written by then.

        Raises
        ------
        Diverged
            When the policy or a loss is no longer finite; what was written last stays.
        """
        log = None
        if self.folder is not None:
            self.folder.mkdir(parents=True, exist_ok=True)
            # What came after the checkpoint is flown anew; its own validation stays.
            begun = self.steps + 1 if self.validations else 0
            log = SummaryWriter(str(self.folder), purge_step=begun)
        try:
            began = time.monotonic()
            for figures in self._learn(on_progress or (lambda _steps, _updates: None)):
                self.seconds += time.monotonic() - began
                result = self._validated(figures)
                if log is not None:
                    result.log(log)
                yield result
                began = time.monotonic()
        finally:
            if log is not None:
                log.close()

    def _validated(self, figures: dict[str, float]) -> Validation:
        flights = self.fly(self.config.validation_maps, validation_generator(self.device))
        result = Validation(
            self.steps, self.updates, self.seconds,
            float(flights.efficiency.mean()), float(flights.share.mean()),
            {**figures, **flights.figures},
        )  # fmt: skip
        told = {"e_p": result.efficiency, "share of the bound": result.share, **result.figures}
        for name, value in told.items():
            check_finite(f"values of {name}", torch.tensor(value))
        self.validations.append(result)
        score = self._score(result)
        better = score > self.best_score
        if better:
            self.best_score, self.best_share = score, result.share
        if self.folder is not None:
            if better:
                self._save_model(self.folder / f"{self.config.name}.safetensors", result)
            self._save_checkpoint(self.folder)
        return result

    def _save_checkpoint(self, folder: Path) -> None:
        """Write all that the run needs to go on as if it had not stopped."""
        counters = {
            "steps": self.steps,
            "updates": self.updates,
            "seconds": self.seconds,
            "best_score": self.best_score,
            "best_share": self.best_share,
            "config": self.plain_config(),
            "validations": [vars(each) for each in self.validations],
            **self._counters(),
        }
        tensors = {"generator": self.generator.get_state()} | self._tensors()
        write_checkpoint(folder, tensors, counters)

    def load_checkpoint(self, *, to_train: bool = True) -> None:
        """Go on from the folder's checkpoint.

        Parameters
        ----------
        to_train : bool
            Whether training is to go on; the policy alone can be flown on another kind of device
            than the run was begun on, too.

        Raises
        ------
        InvalidInput
            When there is no folder, or its checkpoint cannot be read, belongs to another
            configuration, or is of another kind of device.
        """
        if self.folder is None:
            raise InvalidInput("folder: a run without a folder has no checkpoint")
        stored, counters = read_checkpoint(self.folder, self.plain_config(), self.device)
        state = stored["generator"].cpu()
        if to_train:
            self._check_device(state)
        with torch.no_grad():
            self._restore(stored, counters)
        if to_train:
            self.generator.set_state(state)
        self.steps, self.updates = counters["steps"], counters["updates"]
        self.seconds = counters["seconds"]
        self.best_score, self.best_share = counters["best_score"], counters["best_share"]
        self.validations = [Validation(**each) for each in counters["validations"]]

    def _check_device(self, state: Tensor) -> None:
        """Raise InvalidInput where a generator's state is of another kind of device."""
        if len(state) != len(self.generator.get_state()):
            begun = "cuda" if len(state) == _CUDA_STATE else "cpu"
            raise InvalidInput(
                f"{self.folder} was begun on {begun}; go on with --device {begun}, or take another "
                "folder"
            )

    def plain_config(self) -> dict[str, Any]:
        """Return the configuration as plain values, for a card or a checkpoint."""
        return dataclasses.asdict(self.config)
