"""Training configurations of soft actor-critic: YAML files without the field `algorithm`."""

from __future__ import annotations

from dataclasses import dataclass, field

from wisar_planner.errors import InvalidInput
from wisar_planner.training.ablation import check_ablation
from wisar_planner.training.config import (
    check_all_finite,
    check_at_least,
    check_name,
    check_positive,
    check_positive_share,
    rounds,
)
from wisar_planner.training.sac.learner import SacSettings
from wisar_planner.training.streams import check_seed
from wisar_planner.training.worlds import WorldDistribution


@dataclass(frozen=True)
class SacConfig:
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
        check_at_least(
            self,
            **dict.fromkeys(("steps", "environments", "batch", "replay", "n_step"), 1),
            **dict.fromkeys(("validation_maps", "validation_every"), 1),
        )
        check_positive(self, "updates", "reward_scale")
        if not 0.0 <= self.decay_from < 1.0:
            raise InvalidInput(f"decay_from must be from 0 to below 1, not {self.decay_from}")
        check_all_finite(self, "entropy")
        check_name(self.name)
        check_seed(self.seed)
        check_ablation(self.ablation)
        check_positive_share(self, "gamma")
        if self.warm_up_steps < (self.n_step + 1) * self.environments:
            raise InvalidInput(
                f"warm_up_steps must be at least {(self.n_step + 1) * self.environments} for "
                f"{self.n_step}-step transitions of {self.environments} environments"
            )
        # Steps are flown in all environments at once.
        warm_up = rounds(self.warm_up_steps, self.environments)
        if (rounds(self.steps, self.environments) - warm_up) * self.updates < 1.0:
            raise InvalidInput(
                f"steps must be more than warm_up_steps ({self.warm_up_steps}) by enough for an "
                f"update, not {self.steps}: nothing would be learned"
            )
        if self.replay < 2 * self.warm_up_steps:
            raise InvalidInput(f"replay must be at least twice warm_up_steps, not {self.replay}")
