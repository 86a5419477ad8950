"""Configurations of an improvement: YAML files with `algorithm: improvement`."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from wisar_planner.errors import InvalidInput
from wisar_planner.training.config import (
    check_algorithm,
    check_at_least,
    check_name,
    check_positive,
    check_share,
)
from wisar_planner.training.streams import check_seed
from wisar_planner.training.worlds import WorldDistribution

#: What a file's field `algorithm` says.
ALGORITHM = "improvement"


@dataclass(frozen=True)
class ImprovementConfig:
    """Which policy to improve, how, for how long.

    Parameters
    ----------
    algorithm : str
        Always `improvement`.
    name : str
        Name of the model.
    start : str
        The policy to improve: name of a shipped one, or path of a .safetensors file.
    seed : int
        Seed of everything random.
    rounds : int
        Rounds of policy iteration.
    environments : int
        Searches side by side.
    valued_steps : int
        Steps per round from which the value of states is learned.
    trace : float
        Lambda of TD(lambda), from which the value learns: 0 looks one step ahead, 1 to the end.
    labels : int
        States per round from which branches are flown.
    remembered_labels : int
        States whose branches the critics learn from, the latest.
    branches : int
        Turns flown from a state: the policy's own and others.
    horizon : int
        Steps of a branch; then the value of the state it leads to counts.
    deviations : (float, float)
        Smallest and largest deviation of a branch's turn from the policy's, degrees.
    critics : int
        Critics whose mean corrects the policy.
    channels, blocks : int
        Size of the networks of critics and value.
    critic_updates, imitation_updates : int
        Updates per round.
    critic_rate, imitation_rate, value_rate : float
        Learning rates of Adam at the beginning of each round; they fall linearly to 3%.
    batch : int
        States per update.
    margin : float
        Advantage from which another turn replaces the policy's own, in steps over the most
        probable ground.
    imitated_steps : int
        Steps per round that the policy flies to imitate its correction there.
    validation_maps : int
        Maps of the paper's setup that the policy is judged on.
    worlds : WorldDistribution
        What is trained on.
    """

    algorithm: str = ALGORITHM
    name: str = "sac"
    start: str = "sac_plain"
    seed: int = 0
    rounds: int = 4
    environments: int = 512
    valued_steps: int = 400_000
    trace: float = 0.9
    labels: int = 20_480
    remembered_labels: int = 61_440
    branches: int = 8
    horizon: int = 8
    deviations: tuple[float, float] = (6.0, 120.0)
    critics: int = 4
    channels: int = 32
    blocks: int = 3
    critic_updates: int = 2000
    imitation_updates: int = 2000
    critic_rate: float = 2e-3
    imitation_rate: float = 5e-4
    value_rate: float = 2e-3
    batch: int = 256
    margin: float = 0.02
    imitated_steps: int = 102_400
    validation_maps: int = 512
    worlds: WorldDistribution = field(default_factory=WorldDistribution)

    def __post_init__(self) -> None:
        check_algorithm(self.algorithm, ALGORITHM)
        check_name(self.name)
        check_seed(self.seed)
        check_at_least(
            self,
            rounds=1,
            environments=1,
            valued_steps=1,
            labels=1,
            remembered_labels=self.labels,
            branches=2,
            horizon=1,
            critics=1,
            channels=1,
            blocks=1,
            critic_updates=1,
            imitation_updates=1,
            batch=1,
            imitated_steps=1,
            validation_maps=2,
        )
        check_positive(self, "critic_rate", "imitation_rate", "value_rate")
        check_share(self, "trace")
        low, high = self.deviations
        if not 0.0 < low <= high <= 180.0:
            raise InvalidInput("deviations must be two rising numbers above 0, at most 180")
        if not 0.0 <= self.margin < math.inf:
            raise InvalidInput(f"margin must be at least 0 and finite, not {self.margin}")

    @property
    def round_steps(self) -> int:
        """Steps flown in a round, about."""
        return self.valued_steps + self.labels * self.branches * self.horizon + self.imitated_steps

    @property
    def steps(self) -> int:
        """Steps flown in all rounds, about."""
        return self.rounds * self.round_steps
