"""The algorithms that `wisar train` knows: their configurations and their runs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

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
from wisar_planner.training.run import Run
from wisar_planner.training.sac.config import SacConfig
from wisar_planner.training.sac.run import SacRun

Config = SacConfig | ImprovementConfig | PpoConfig | ExpertConfig | PaperConfig
AnyRun = (
    Run[SacConfig] | Run[ImprovementConfig] | Run[PpoConfig] | Run[ExpertConfig] | Run[PaperConfig]
)

_CONFIGS: dict[
    str, type[ImprovementConfig] | type[PpoConfig] | type[ExpertConfig] | type[PaperConfig]
] = {
    improvement.ALGORITHM: ImprovementConfig,
    ppo.ALGORITHM: PpoConfig,
    expert_iteration.ALGORITHM: ExpertConfig,
    paper.ALGORITHM: PaperConfig,
}


def read_any_config(path: Path, **overrides: Any) -> Config:
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


def _make_config(content: dict[str, Any], where: str) -> Config:
    if "algorithm" in content and content["algorithm"] not in _CONFIGS:
        raise InvalidInput(
            f"{where}: algorithm must be {' or '.join(_CONFIGS)}, or left out for soft "
            f"actor-critic, not {content['algorithm']!r}"
        )
    kind = _CONFIGS[content["algorithm"]] if "algorithm" in content else SacConfig
    config: Config = build(kind, content, where)
    return config


def make_run(config: Config, folder: Path, device: torch.device) -> AnyRun:
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
    if isinstance(config, PaperConfig):
        return PaperRun(config, folder, device)
    if isinstance(config, PpoConfig):
        return PpoRun(config, folder, device)
    if isinstance(config, ExpertConfig):
        return ExpertRun(config, folder, device)
    if isinstance(config, ImprovementConfig):
        return ImprovementRun(config, folder, device)
    return SacRun(config, folder, device)


def load_run(folder: Path, device: torch.device) -> AnyRun:
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
    if config.get("ablation") or config.get("algorithm") == paper.ALGORITHM:
        return None
    distribution = counters.get("distribution")
    if distribution is None:  # Earlier checkpoints leave that to the card of the best policy.
        distribution = load_model(folder / f"{config['name']}.safetensors").distribution
    return planned(read_tensors(folder, "actor"), distribution)
