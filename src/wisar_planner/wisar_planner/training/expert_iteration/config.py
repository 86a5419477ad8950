"""Configurations of expert iteration: YAML files with `algorithm: expert_iteration`."""

from __future__ import annotations

from dataclasses import dataclass, field

from wisar_planner.training.config import (
    check_algorithm,
    check_at_least,
    check_name,
    check_positive,
)
from wisar_planner.training.streams import check_seed
from wisar_planner.training.worlds import WorldDistribution

#: What a file's field `algorithm` says.
ALGORITHM = "expert_iteration"

# What search labels of a flight, about: the steps after a random one.
_STEPS_OF_A_FLIGHT = 32


@dataclass(frozen=True)
class ExpertConfig:
    """Which policy learns from search, how much of it.

    Parameters
    ----------
    algorithm : str
        Always `expert_iteration`.
    name : str
        Name of the model.
    start : str
        The policy to begin with: name of a shipped one, or path of a .safetensors file.
    channels : int
        Channels inside; a policy to begin with that has fewer is widened. 0 for those that it has.
    labels : tuple of str
        Folders of earlier runs of expert iteration, whose labels are remembered from the beginning.
    seed : int
        Seed of everything random.
    rounds : int
        How often search goes on from what the policy has learned by then.
    flights : int
        Flights per round whose rest, from a random step on, search makes better.
    tries : int
        Ways on with random turns that the policy flies from there, to begin with the best.
    moves : int
        Moves that search tries per step of the rest, to make the best way on better.
    early_weight : float
        What search thinks of probability that is seen early, see `planners.refine`.
    remembered_flights : int
        Flights that the policy learns from, the latest.
    updates : int
        Updates per round.
    batch : int
        States per update.
    rate : float
        Learning rate of Adam at the beginning; it falls linearly to 3% over all rounds.
    validation_maps : int
        Maps of the paper's setup that the policy is judged on, and half as many of other worlds.
    worlds : WorldDistribution
        What is trained on.
    """

    algorithm: str = ALGORITHM
    name: str = "sac"
    start: str = "sac"
    channels: int = 0
    labels: tuple[str, ...] = ()
    seed: int = 0
    rounds: int = 8
    flights: int = 4096
    tries: int = 16
    moves: int = 200
    early_weight: float = 0.25
    remembered_flights: int = 32_768
    updates: int = 2000
    batch: int = 512
    rate: float = 4e-3
    validation_maps: int = 1024
    worlds: WorldDistribution = field(default_factory=WorldDistribution)

    def __post_init__(self) -> None:
        check_algorithm(self.algorithm, ALGORITHM)
        check_name(self.name)
        check_seed(self.seed)
        check_at_least(
            self, channels=0, rounds=1, flights=1, tries=0, moves=1, early_weight=0.0,
            remembered_flights=self.flights, updates=1, batch=1, validation_maps=2,
        )  # fmt: skip
        check_positive(self, "rate")

    @property
    def steps(self) -> int:
        """Steps that search labels in all rounds, about."""
        return self.rounds * self.flights * _STEPS_OF_A_FLIGHT
