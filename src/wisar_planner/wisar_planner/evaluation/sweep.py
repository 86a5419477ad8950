"""The paper's parameter sweep: random sizes of its network, each trained for the same steps.

Appendix "Policy Network Design": 39 runs over the number of layers, their width, the features of
the path and its extractor. The paper gives the ranges in figures alone; the defaults here contain
what it chose (8 layers of 2000, 1000 features) and the 8 layers after which more did not help.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import joblib
import numpy as np
import torch

from wisar_planner.errors import InvalidInput
from wisar_planner.evaluation.runner import parallel_pool
from wisar_planner.evaluation.sweep_store import SweepStore
from wisar_planner.training.divergence import Diverged
from wisar_planner.training.paper.config import PaperConfig
from wisar_planner.training.paper.network import PATH_EXTRACTORS
from wisar_planner.training.paper.run import PaperRun


@dataclass(frozen=True)
class SweepRecord:
    """One sample and how it went.

    Attributes
    ----------
    index : int
        Number of the sample.
    layers, width, path_features : int
        Size of its network.
    path_extractor : str
        Extractor of the path.
    parameters : int
        Parameters of its policy network.
    e_p, share_of_bound : float or None
        Means on the validation maps at the end of the training; None where it diverged.
    seconds : float
        Time of the training, s; where it diverged, with that of validations.
    """

    index: int
    layers: int
    width: int
    path_features: int
    path_extractor: str
    parameters: int
    e_p: float | None
    share_of_bound: float | None
    seconds: float


@dataclass(frozen=True)
class Sweep:
    """What is sampled, and what all samples share.

    Parameters
    ----------
    base : PaperConfig
        Training of every sample, but for its network's size and its seed.
    samples : int
        Number of samples; samples 0 to N - 1 of the seed.
    seed : int
        Seed of the samples and their training.
    layers, width, path_features : (int, int)
        Smallest and largest value; all between are equally likely.
    path_extractors : tuple of str
        Extractors, equally likely.

    Raises
    ------
    InvalidInput
        If a number or a range cannot be right.
    """

    base: PaperConfig
    samples: int = 39
    seed: int = 0
    layers: tuple[int, int] = (1, 12)
    width: tuple[int, int] = (100, 2000)
    path_features: tuple[int, int] = (100, 1000)
    path_extractors: tuple[str, ...] = tuple(PATH_EXTRACTORS)

    def __post_init__(self) -> None:
        if self.samples < 1:
            raise InvalidInput(f"samples must be at least 1, not {self.samples}")
        if self.seed < 0:
            raise InvalidInput(f"seed must not be negative, not {self.seed}")
        for name in ("layers", "width", "path_features"):
            low, high = getattr(self, name)
            if not 1 <= low <= high:
                raise InvalidInput(f"{name} must be a range of numbers from 1 on, not {low},{high}")
        unknown = [each for each in self.path_extractors if each not in PATH_EXTRACTORS]
        if unknown or not self.path_extractors:
            raise InvalidInput(
                f"path_extractors must be some of {', '.join(PATH_EXTRACTORS)}, "
                f"not {', '.join(self.path_extractors) or 'none'}"
            )

    def sample(self, index: int) -> PaperConfig:
        """Return the training of one sample; it depends on the seed and the index alone."""
        rng = np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(index,)))
        seed = int(rng.integers(2**31))
        layers, width, features = (
            int(rng.integers(low, high, endpoint=True))
            for low, high in (self.layers, self.width, self.path_features)
        )
        extractor = self.path_extractors[int(rng.integers(len(self.path_extractors)))]
        network = dataclasses.replace(
            self.base.network,
            layers=layers,
            width=width,
            path_features=features,
            path_extractor=extractor,
        )
        # A sample is judged once, at its end.
        return dataclasses.replace(
            self.base, seed=seed, network=network, validation_every=self.base.steps
        )

    def common_setup(self) -> dict[str, Any]:
        """Return what all samples share, whatever their number."""
        base = dataclasses.asdict(self.base)
        for name in ("seed", "name", "validation_every"):
            del base[name]
        for name in ("layers", "width", "path_features", "path_extractor"):
            del base["network"][name]
        return {
            "seed": self.seed,
            "layers": list(self.layers),
            "width": list(self.width),
            "path_features": list(self.path_features),
            "path_extractors": list(self.path_extractors),
            "base": base,
        }


def run_sample(index: int, config: PaperConfig, device: str) -> SweepRecord:
    """Train one sample.

    Parameters
    ----------
    index : int
        Its number.
    config : PaperConfig
        Its training.
    device : str
        Where to compute.
    """
    # One thread, so that a sample gives the same numbers whatever runs beside it.
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    began = time.monotonic()
    try:
        run = PaperRun(config, None, torch.device(device))
        *_, last = run.train()
        e_p, share, seconds = last.efficiency, last.share, last.seconds
    except Diverged:
        # A result, too: the same sample would diverge again whenever the sweep goes on.
        e_p, share, seconds = None, None, time.monotonic() - began
    finally:
        torch.set_num_threads(threads)
    network = config.network
    return SweepRecord(
        index=index,
        layers=network.layers,
        width=network.width,
        path_features=network.path_features,
        path_extractor=network.path_extractor,
        parameters=run.learner.parameters,
        e_p=e_p,
        share_of_bound=share,
        seconds=seconds,
    )


def run_sweep(
    sweep: Sweep,
    *,
    jobs: int = 1,
    dask: str | None = None,
    device: str = "cpu",
    store: SweepStore | None = None,
    on_record: Callable[[SweepRecord], None] | None = None,
) -> list[SweepRecord]:
    """Train all samples that are not in the store yet.

    Parameters
    ----------
    sweep : Sweep
        What to run.
    jobs : int
        Local processes; -1 for one per core. Not used with a cluster.
    dask : str, optional
        Address of a Dask scheduler, to run on its workers.
    device : str
        Where to compute.
    store : SweepStore, optional
        Finished samples to continue from; new ones are added to it as they come.
    on_record : callable, optional
        Called in this process with each new record.

    Returns
    -------
    list of SweepRecord
        All samples in order.
    """
    known = [SweepRecord(**each) for each in (store.records if store else ())]
    records = {each.index: each for each in known if each.index < sweep.samples}
    missing = [index for index in range(sweep.samples) if index not in records]
    if missing:
        with parallel_pool(jobs, dask) as parallel:
            tasks = (joblib.delayed(run_sample)(i, sweep.sample(i), device) for i in missing)
            for record in parallel(tasks):
                records[record.index] = record
                if store:
                    store.append(dataclasses.asdict(record))
                if on_record:
                    on_record(record)
    return [records[index] for index in sorted(records)]
