"""The algorithms that `wisar train` knows: their configurations and their runs."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import torch

from wisar_planner.errors import InvalidInput
from wisar_planner.policy.model import Model, load_model
from wisar_planner.training.config import build, read_fields
from wisar_planner.training.expert_iteration import config as expert_iteration
from wisar_planner.training.expert_iteration.config import ExpertConfig
from wisar_planner.training.expert_iteration.run import ExpertRun
from wisar_planner.training.improvement import config as improvement
from wisar_planner.training.improvement.config import ImprovementConfig
from wisar_planner.training.improvement.run import ImprovementRun
from wisar_planner.training.judging import planned
from wisar_planner.training.paper import config as paper
from wisar_planner.training.paper.config import PaperConfig
from wisar_planner.training.paper.run import PaperRun
from wisar_planner.training.ppo import config as ppo
from wisar_planner.training.ppo.config import PpoConfig
from wisar_planner.training.ppo.run import PpoRun
from wisar_planner.training.records import read_counters, read_tensors
from wisar_planner.training.run import Run, RunConfig
from wisar_planner.training.sac.config import SacConfig
from wisar_planner.training.sac.run import SacRun


class Algorithm(NamedTuple):
    """A way to train.

    Attributes
    ----------
    config : type
        Its configurations, a dataclass.
    run : type
        Its runs.
    words : str
        What tells a policy that was made so from one of the same name by another algorithm.
    planned : bool
        Whether planners can fly its policies.
    """

    config: type[RunConfig]
    run: Callable[[Any, Path, torch.device], Run[Any]]
    words: str = ""
    planned: bool = True


#: By what the field `algorithm` of a configuration says; without it, it is for the first.
ALGORITHMS = {
    "": Algorithm(SacConfig, SacRun),
    improvement.ALGORITHM: Algorithm(ImprovementConfig, ImprovementRun, "improved"),
    ppo.ALGORITHM: Algorithm(PpoConfig, PpoRun, "ppo"),
    expert_iteration.ALGORITHM: Algorithm(ExpertConfig, ExpertRun, "from search"),
    paper.ALGORITHM: Algorithm(PaperConfig, PaperRun, planned=False),
}


def algorithm_of(config: Mapping[str, Any], where: str) -> Algorithm:
    """Return the algorithm that a configuration of plain values is for.

    Parameters
    ----------
    config : mapping
        The configuration.
    where : str
        Where it stands, for the message.

    Raises
    ------
    InvalidInput
        When there is no such algorithm.
    """
    named = [name for name in ALGORITHMS if name]
    if "algorithm" not in config:
        return ALGORITHMS[""]
    if config["algorithm"] not in named:
        raise InvalidInput(
            f"{where}: algorithm must be {' or '.join(named)}, or left out for soft actor-critic, "
            f"not {config['algorithm']!r}"
        )
    return ALGORITHMS[config["algorithm"]]


def read_any_config(path: Path, **overrides: Any) -> RunConfig:
    """Return the configuration in a YAML file, of the algorithm that the file names.

    Parameters
    ----------
    path : Path
        The file; fields that it does not name keep their defaults. Without the field `algorithm`
        it is for `training.sac`.
    **overrides
        Fields that replace those of the file.

    Raises
    ------
    InvalidInput
        When the file cannot be read, names an unknown algorithm or field, or a value cannot be
        right.
    """
    return _make_config({**read_fields(path), **overrides}, str(path))


def _make_config(content: dict[str, Any], where: str) -> RunConfig:
    config: RunConfig = build(algorithm_of(content, where).config, content, where)
    return config


def make_run(config: RunConfig, folder: Path, device: torch.device) -> Run[Any]:
    """Return the run of a configuration, at its beginning.

    Parameters
    ----------
    config
        What to train.
    folder : Path
        Where the run keeps its checkpoint, its log and its best model.
    device : torch.device
        Where to compute.

    Raises
    ------
    InvalidInput
        When a policy that the configuration starts from cannot be loaded.
    """
    return ALGORITHMS[getattr(config, "algorithm", "")].run(config, folder, device)


def load_run(folder: Path, device: torch.device) -> Run[Any]:
    """Return the run that left a checkpoint in a folder, to fly its last policy.

    Raises
    ------
    InvalidInput
        When the checkpoint cannot be read, or a policy that the run started from cannot be loaded.
    """
    config = _make_config(read_counters(folder)["config"], str(folder))
    run = make_run(config, folder, device)
    run.load_checkpoint(to_train=False)
    return run


def last_policy(folder: Path) -> Model | None:
    """Return the last policy of a run from its checkpoint, None where no planner could fly it.

    None are ablations and the paper's policy. What the run started from is not needed.

    Raises
    ------
    InvalidInput
        When the checkpoint cannot be read.
    """
    counters = read_counters(folder)
    config = counters["config"]
    if config.get("ablation") or not algorithm_of(config, str(folder)).planned:
        return None
    distribution = counters.get("distribution")
    if distribution is None:  # Earlier checkpoints leave that to the card of the best policy.
        distribution = load_model(folder / f"{config['name']}.safetensors").distribution
    return planned(read_tensors(folder, "actor"), distribution)
