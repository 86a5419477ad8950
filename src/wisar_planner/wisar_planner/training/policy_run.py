"""What the runs have in common that make a better policy of another one."""

from __future__ import annotations

import dataclasses
from functools import partial
from pathlib import Path
from typing import Any, ClassVar, Protocol, TypeVar

import torch

from wisar_planner.errors import InvalidInput
from wisar_planner.policy.heading import DIRECTED
from wisar_planner.policy.model import find_model, load_model, save_model
from wisar_planner.training.judging import Flights, fly_maps
from wisar_planner.training.networks import Networks, Policy, likeliest_turn
from wisar_planner.training.records import Validation, card_of, read_counters
from wisar_planner.training.run import Run, RunConfig
from wisar_planner.training.worlds import WorldDistribution


class PolicyRunConfig(RunConfig, Protocol):
    """What the configurations of these runs have."""

    @property
    def start(self) -> str:
        """The policy to begin with: name of a shipped one, or path of a .safetensors file."""

    @property
    def worlds(self) -> WorldDistribution:
        """What is trained on."""


Config = TypeVar("Config", bound=PolicyRunConfig)


class PolicyRun(Run[Config]):
    """A run that makes a better policy of another one; see `Run`.

    It is validated on maps of the paper's setup and, if it trains on others, on half as many of
    these. The best policy is chosen by both, weighted as the training is.

    Raises
    ------
    InvalidInput
        When the policy to begin with cannot be loaded.
    """

    #: What the card says of how the policy was made, and of how it was judged.
    algorithm: ClassVar[str]
    judged: ClassVar[str] = "estimated on the training raster"

    def __init__(self, config: Config, folder: Path | None, device: torch.device) -> None:
        super().__init__(config, folder, device)
        self._start = load_model(find_model(config.start))
        # By name, since a file gives them in any order, and optimisers count them.
        self._start_weights = {
            name: torch.tensor(value, device=device)
            for name, value in sorted(self._start.weights.items())
        }
        # What learns, and how its turns are distributed; a kind of run may begin with another.
        self.actor: Networks = {
            name: value.clone().requires_grad_() for name, value in self._start_weights.items()
        }
        self._distribution = self._start.distribution

    def _counters(self) -> dict[str, Any]:
        return {
            "start_sha256": self._start.card["weights_sha256"],
            "distribution": self._distribution,
        }

    def load_checkpoint(self, *, to_train: bool = True) -> None:
        """Go on from the folder's checkpoint; see `Run.load_checkpoint`.

        Raises
        ------
        InvalidInput
            Also when the policy to begin with is not the one that the run began with.
        """
        if self.folder is not None:
            begun = read_counters(self.folder).get("start_sha256")
            if begun not in (None, self._start.card["weights_sha256"]):
                raise InvalidInput(
                    f"start: {self.config.start} is another policy than {self.folder} began with; "
                    "take another folder"
                )
        super().load_checkpoint(to_train=to_train)

    def _policy(self) -> Policy:
        """Return the present policy without noise; it changes as the actor learns."""
        return partial(likeliest_turn, self.actor, self._distribution)

    def fly(self, maps: int, generator: torch.Generator) -> Flights:
        """Fly the present policy; see `Run.fly`."""
        return self._flights(self._policy(), maps, generator)

    def _flights(self, policy: Policy, maps: int, generator: torch.Generator) -> Flights:
        flights = fly_maps(policy, maps, generator)
        worlds = self.config.worlds
        if worlds.paper_share == 1.0:
            return flights
        others = fly_maps(
            policy, max(1, maps // 2), generator, dataclasses.replace(worlds, paper_share=0.0)
        )
        return flights._replace(figures={"other_worlds": float(others.share.mean())})

    def _score(self, result: Validation) -> float:
        return result.score(self.config.worlds.paper_share)

    def _save_model(self, path: Path, result: Validation) -> None:
        weights = {name: value.detach().cpu().numpy() for name, value in self.actor.items()}
        turns = "one of 32 directions with an offset each"
        if self._distribution != DIRECTED:
            turns = "a squashed Gaussian over the next turn"
        start = self._start.card
        told = ("algorithm", "config", "training", "start", "distribution", "weights_sha256")
        card = {
            "what": f"search policy, {turns}; see docs/policy.md",
            **card_of(self.plain_config(), result, self.config.validation_maps, self.device),
            "algorithm": f"{self.algorithm} from another policy (start)",
            "distribution": self._distribution,
            "start": {name: start[name] for name in told if name in start},
        }
        card["validation"]["note"] = f"{self.judged}, on maps that chose this checkpoint"
        if "other_worlds" in result.figures:
            others = round(result.figures["other_worlds"], 4)
            card["validation"]["share_of_bound_other_worlds"] = others
        save_model(path, weights, card)
