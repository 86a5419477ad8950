"""Training configurations: one YAML file per run."""

from __future__ import annotations

import dataclasses
import math
import typing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from wisar_planner.errors import InvalidInput
from wisar_planner.training.ablation import check_ablation
from wisar_planner.training.sac import SacSettings
from wisar_planner.training.streams import check_seed
from wisar_planner.training.worlds import WorldDistribution


@dataclass(frozen=True)
class TrainingConfig:
    """What to train, on what, for how long.

    Parameters
    ----------
    name : str
        Name of the model.
    seed : int
        Seed of everything random.
    steps : int
        Steps flown in all environments together.
    environments : int
        Searches side by side.
    warm_up_steps : int
        Steps flown at random before the first update.
    updates : float
        Updates per step of all environments; below 1 they come less often than every step.
    batch : int
        Transitions per update.
    replay : int
        Steps kept in the replay memory.
    n_step : int
        Steps per transition.
    gamma : float
        Discount per step.
    reward_scale : float
        Factor of the reward.
    entropy : (float, float)
        Target entropy of the policy at the start and at the end, nats.
    decay_from : float
        Share of the training after which the learning rates fall, linearly to 2%.
    validation_maps : int
        Maps of the paper's setup that the policy is judged on.
    validation_every : int
        Steps between validations.
    ablation : str
        Part of the policy to leave out, see `training.ablation`; empty for none.
    sac : SacSettings
        Settings of the algorithm.
    worlds : WorldDistribution
        What is trained on.
    """

    name: str = "sac"
    seed: int = 0
    steps: int = 600_000
    environments: int = 64
    warm_up_steps: int = 4096
    updates: float = 2.0
    batch: int = 256
    replay: int = 400_000
    n_step: int = 3
    gamma: float = 0.99
    reward_scale: float = 0.2
    entropy: tuple[float, float] = (-1.0, -2.5)
    decay_from: float = 0.5
    validation_maps: int = 512
    validation_every: int = 50_000
    ablation: str = ""
    sac: SacSettings = field(default_factory=SacSettings)
    worlds: WorldDistribution = field(default_factory=WorldDistribution)

    def __post_init__(self) -> None:
        for name, least in (
            ("steps", 1),
            ("environments", 1),
            ("batch", 1),
            ("replay", 1),
            ("n_step", 1),
            ("validation_maps", 1),
            ("validation_every", 1),
        ):
            if not getattr(self, name) >= least:
                raise InvalidInput(f"{name} must be at least {least}, not {getattr(self, name)}")
        for name in ("updates", "reward_scale"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise InvalidInput(f"{name} must be above 0 and finite, not {getattr(self, name)}")
        if not 0.0 <= self.decay_from < 1.0:
            raise InvalidInput(f"decay_from must be from 0 to below 1, not {self.decay_from}")
        check_seed(self.seed)
        check_ablation(self.ablation)
        if not 0.0 < self.gamma <= 1.0:
            raise InvalidInput(f"gamma must be over 0 and at most 1, not {self.gamma}")
        if self.warm_up_steps < (self.n_step + 1) * self.environments:
            raise InvalidInput(
                f"warm_up_steps must be at least {(self.n_step + 1) * self.environments} for "
                f"{self.n_step}-step transitions of {self.environments} environments"
            )
        if self.replay < 2 * self.warm_up_steps:
            raise InvalidInput(f"replay must be at least twice warm_up_steps, not {self.replay}")


def read_config(path: Path, **overrides: Any) -> TrainingConfig:
    """Return the configuration in a YAML file.

    Parameters
    ----------
    path : Path
        The file; fields that it does not name keep their defaults.
    **overrides
        Fields that replace those of the file.

    Raises
    ------
    InvalidInput
        When the file cannot be read, names an unknown field, or a value cannot be right.
    """
    config: TrainingConfig = build(TrainingConfig, {**read_yaml(path), **overrides}, str(path))
    return config


def read_yaml(path: Path) -> dict[str, Any]:
    """Return the fields in a YAML file.

    Raises
    ------
    InvalidInput
        When the file is not YAML or no mapping.
    """
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise InvalidInput(f"{path} is not YAML: {' '.join(str(error).split())}") from None
    if not isinstance(content, dict):
        raise InvalidInput(f"{path} must be a mapping of fields, see config/sac.yaml")
    return content


def build(kind: type[Any], content: dict[str, Any], where: str) -> Any:
    """Make a dataclass of plain values, which must have the types of its fields."""
    types = typing.get_type_hints(kind)
    known = {each.name: each for each in dataclasses.fields(kind)}
    values = {}
    for name, value in content.items():
        if name not in known:
            raise InvalidInput(f"{where}: unknown field {name}; the fields are {', '.join(known)}")
        values[name] = _value(types[name], value, f"{where}: {name}")
    try:
        return kind(**values)
    except InvalidInput as error:
        raise InvalidInput(f"{where}: {error}") from None


def _value(kind: Any, value: Any, where: str) -> Any:
    if dataclasses.is_dataclass(kind):
        if not isinstance(value, dict):
            raise InvalidInput(f"{where} must be a mapping, not {value!r}")
        return build(typing.cast(type[Any], kind), value, where)
    if typing.get_origin(kind) is tuple:
        kinds = typing.get_args(kind)
        if not isinstance(value, list | tuple) or len(value) != len(kinds):
            raise InvalidInput(f"{where} must be a list of {len(kinds)} numbers, not {value!r}")
        return tuple(_value(k, v, where) for k, v in zip(kinds, value, strict=True))
    if kind is float and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    if not isinstance(value, kind) or (kind is int and isinstance(value, bool)):
        raise InvalidInput(f"{where} must be of type {kind.__name__}, not {value!r}")
    return value
