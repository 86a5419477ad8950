"""Configurations of proximal policy optimisation: YAML files with `algorithm: ppo`."""

from __future__ import annotations

from dataclasses import dataclass, field

from wisar_planner.errors import InvalidInput
from wisar_planner.training.config import (
    check_algorithm,
    check_all_finite,
    check_at_least,
    check_name,
    check_positive,
    check_share,
    rounds,
)
from wisar_planner.training.streams import check_seed
from wisar_planner.training.worlds import WorldDistribution

#: What a file's field `algorithm` says.
ALGORITHM = "ppo"


@dataclass(frozen=True)
class PpoConfig:
    """Which policy to start from, how to improve it, for how long.

    Parameters
    ----------
    algorithm : str
        Always `ppo`.
    name : str
        Name of the model.
    start : str
        The policy to begin with, name of a shipped one or path of a .safetensors file; one of
        another distribution or size is imitated first.
    seed : int
        Seed of everything random.
    steps : int
        Steps to fly, those of imitation and of the value alone included.
    imitation_steps : int
        Steps flown to imitate the start, where it is imitated.
    value_steps : int
        Steps flown after that in which only the value of states is learned.
    environments : int
        Searches side by side.
    window : int
        Steps of each search between updates.
    batch : int
        States per update; each is used once.
    channels, blocks : int
        Size of the networks of policy and value.
    noise : (float, float)
        Standard deviation of turns within a direction, in units of pi, at the beginning and, on a
        geometric scale, at the end.
    entropy : (float, float)
        Weight of the entropy over directions at the beginning and at the end; advantages have a
        standard deviation of one.
    trace : float
        Lambda of the advantages: 0 looks one step ahead, 1 to the end of the window.
    clip : float
        Change of a turn's likelihood, as a share, from which it brings no more.
    rate, value_rate, imitation_rate : float
        Learning rates of Adam at the beginning; they fall linearly to 3%, that of the value to 10%.
    largest_gradient : float
        Norm to which gradients of the policy are cut.
    validation_maps : int
        Maps of the paper's setup that the policy is judged on, and half as many of other worlds.
    validation_every : int
        Steps between validations.
    worlds : WorldDistribution
        What is trained on.
    """

    algorithm: str = ALGORITHM
    name: str = "sac"
    start: str = "sac_plain"
    seed: int = 0
    steps: int = 250_000_000
    imitation_steps: int = 5_000_000
    value_steps: int = 8_000_000
    environments: int = 32_768
    window: int = 16
    batch: int = 8192
    channels: int = 64
    blocks: int = 4
    noise: tuple[float, float] = (0.03, 0.006)
    entropy: tuple[float, float] = (0.002, 0.0)
    trace: float = 0.9
    clip: float = 0.2
    rate: float = 5e-4
    value_rate: float = 1e-3
    imitation_rate: float = 2e-3
    largest_gradient: float = 1.0
    validation_maps: int = 512
    validation_every: int = 20_000_000
    worlds: WorldDistribution = field(default_factory=WorldDistribution)

    def __post_init__(self) -> None:
        check_algorithm(self.algorithm, ALGORITHM)
        check_name(self.name)
        check_seed(self.seed)
        check_at_least(
            self,
            imitation_steps=1,
            value_steps=1,
            environments=1,
            window=1,
            batch=1,
            channels=1,
            blocks=1,
            validation_maps=2,
            validation_every=1,
        )
        if self.steps <= (most := self._steps_before_learning):
            raise InvalidInput(
                f"steps must be at least {most + 1}, as the policy learns from what it gains after "
                f"imitation_steps and value_steps alone, not {self.steps}"
            )
        check_positive(self, "rate", "value_rate", "imitation_rate", "clip", "largest_gradient")
        check_share(self, "trace")
        if not all(0.0 < noise <= 1.0 for noise in self.noise):
            raise InvalidInput(f"noise must be above 0 and at most 1, not {self.noise}")
        check_all_finite(self, "entropy")

    @property
    def _steps_before_learning(self) -> int:
        """Steps flown before the policy learns from what it gains, the start imitated or not."""
        window, found = self.window * self.environments, []
        for imitation in (0, self.imitation_steps):
            imitated = self.environments * rounds(imitation, self.environments)
            left = imitation + self.value_steps - imitated
            found.append(imitated + window * rounds(left, window))
        return max(found)
