"""Training configurations of the paper's policy: YAML files with `algorithm: paper_sac`."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from wisar_planner.errors import InvalidInput
from wisar_planner.training.config import (
    build,
    check_algorithm,
    check_at_least,
    check_name,
    read_fields,
    rounds,
)
from wisar_planner.training.paper.environment import TaskSettings
from wisar_planner.training.paper.learner import LearnerSettings
from wisar_planner.training.paper.network import NetworkSettings
from wisar_planner.training.streams import check_seed

#: What a file's field `algorithm` says.
ALGORITHM = "paper_sac"


@dataclass(frozen=True)
class PaperConfig:
    """What to train, for how long; the defaults are the paper's.

    Parameters
    ----------
    algorithm : str
        Always `paper_sac`.
    name : str
        Name of the model.
    seed : int
        Seed of everything random.
    steps : int
        Steps flown in all environments together; the last searches are flown to their end.
    environments : int
        Searches side by side, the paper's workers.
    learning_starts : int
        Steps flown at random before the first update.
    train_every : int
        Steps of each environment between updates.
    gradient_steps : int
        Updates then made.
    buffer_size : int
        Steps kept in the replay memory; it never takes more memory than `steps` need.
    validation_maps : int
        Maps that the policy is judged on.
    validation_every : int
        Steps between validations, which wait for the searches to end.
    task : TaskSettings
        The task.
    sac : LearnerSettings
        Settings of the algorithm.
    network : NetworkSettings
        Size of the networks.
    """

    algorithm: str = ALGORITHM
    name: str = "paper_sac"
    seed: int = 0
    steps: int = 500_000_000
    environments: int = 32
    learning_starts: int = 8192
    train_every: int = 10
    gradient_steps: int = 50
    buffer_size: int = 5_000_000
    validation_maps: int = 512
    validation_every: int = 1_000_000
    task: TaskSettings = field(default_factory=TaskSettings)
    sac: LearnerSettings = field(default_factory=LearnerSettings)
    network: NetworkSettings = field(default_factory=NetworkSettings)

    def __post_init__(self) -> None:
        check_algorithm(self.algorithm, ALGORITHM)
        check_name(self.name)
        check_seed(self.seed)
        check_at_least(
            self,
            steps=1,
            environments=1,
            train_every=1,
            gradient_steps=1,
            buffer_size=1,
            validation_maps=1,
            validation_every=1,
        )
        if self.learning_starts < 0:
            raise InvalidInput(f"learning_starts must not be negative, not {self.learning_starts}")
        # The last searches are flown to their end.
        length = self.task.waypoints
        flown = length * rounds(self.steps, self.environments * length)
        last_update = flown - flown % self.train_every
        if self.environments * last_update <= self.learning_starts:
            raise InvalidInput(
                f"steps must be more than learning_starts ({self.learning_starts}) by enough for "
                f"an update, not {self.steps}: nothing would be learned"
            )


def read_paper_config(path: Path, **overrides: Any) -> PaperConfig:
    """Return the configuration in a YAML file of the paper's policy.

    Parameters
    ----------
    path : Path
        The file; fields that it does not name keep their defaults.
    **overrides
        Fields that replace those of the file.

    Raises
    ------
    InvalidInput
        When the file cannot be read, is for another algorithm, names an unknown field, or a value
        cannot be right.
    """
    content = {**read_fields(path), **overrides}
    if content.get("algorithm") != ALGORITHM:
        raise InvalidInput(f"{path} must have `algorithm: {ALGORITHM}`, see config/paper_sac.yaml")
    config: PaperConfig = build(PaperConfig, content, str(path))
    return config
