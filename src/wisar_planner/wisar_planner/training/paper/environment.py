"""The paper's environment: absolute headings, shaped reward, the drone may leave the area."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from wisar_planner.errors import InvalidInput
from wisar_planner.policy.observation import reference_density
from wisar_planner.policy.unseen_map import OUTSIDE, UnseenMap
from wisar_planner.training.config import check_at_least
from wisar_planner.training.divergence import check_finite
from wisar_planner.training.paper.observation import Layout, is_inside, observe
from wisar_planner.training.worlds import (
    PAPER_DEVIATION,
    PAPER_SIDE,
    WorldDistribution,
    Worlds,
    random_worlds,
)

#: Variance of the Gaussians with the side of the area as unit.
VARIANCE = (PAPER_DEVIATION / PAPER_SIDE) ** 2

_WORLDS = WorldDistribution(paper_share=1.0)


@dataclass(frozen=True)
class TaskSettings:
    """The task; the area, the covariance, the step and the swath are always the paper's.

    Parameters
    ----------
    waypoints : int
        Steps of a search N.
    gaussians : int
        Gaussians of a map G.
    epsilon : float
        Scaled reward that a step must pass to earn it, see `search.reward.shaped_reward`.
    w_oob : float
        Penalty of a step that ends outside the area.
    w_r : float
        Weight of the scaled reward.
    w_0 : float
        Penalty of a step that sees too little.
    """

    waypoints: int = 64
    gaussians: int = 4
    epsilon: float = 0.1
    w_oob: float = 1.0
    w_r: float = 0.5
    w_0: float = 0.5

    def __post_init__(self) -> None:
        check_at_least(self, waypoints=1, gaussians=1)
        for name in ("epsilon", "w_oob", "w_r", "w_0"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0.0):
                raise InvalidInput(f"{name} must be finite and not negative, not {value}")

    @property
    def layout(self) -> Layout:
        """Layout of the observation."""
        return Layout(self.waypoints, self.gaussians)


class PaperEnvironment:
    """B searches of the same length, side by side; all begin and end together.

    The action a is the absolute heading u = pi (a + 1). A search goes on outside the area.

    Parameters
    ----------
    count : int
        Number of searches B.
    task : TaskSettings
        The task.
    generator : torch.Generator
        Source of randomness; its device is the environment's.

    Attributes
    ----------
    flown : int
        Steps flown since the searches began.
    path : (B, N + 1, 2) float32
        Positions, with the area as [0, 1] x [0, 1].
    means : (B, G, 2) float32
        Means of the Gaussians, in the same unit.
    seen, in_area : (B,) float32
        Probability seen so far, up to a good two steps beyond the area, and that in the area.
    bound : (B,) float32
        Probability on the most probable ground that fits into the swath.
    """

    def __init__(self, count: int, task: TaskSettings, generator: torch.Generator) -> None:
        self.count, self.task, self.generator = count, task, generator
        self.begin()

    def begin(self) -> None:
        """Put all searches into new random worlds."""
        count, task, device = self.count, self.task, self.generator.device
        worlds = random_worlds(count, _WORLDS, self.generator)
        self.means = torch.rand(count, task.gaussians, 2, generator=self.generator, device=device)
        self._low, self._size = worlds.low, worlds.high - worlds.low
        density, self.in_area = _mixture(worlds, self.means)
        step, radius, window = worlds.step, worlds.radius, _WORLDS.window
        # Beyond the area the paper's drone sees probability, too. The bound is of searches that
        # stay in the area.
        self._unseen = UnseenMap(density, step, radius, window)
        within = torch.where(worlds.density < 0.0, OUTSIDE, density)
        budget = torch.full_like(step, task.waypoints)
        swept = 2.0 * radius * step * budget + math.pi * radius.square()
        self.bound = reference_density(UnseenMap(within, step, radius, window), budget) * swept
        # The paper's k over p_A: the area over that of an isolated step.
        isolated = radius * (math.pi * radius + 2.0 * step)
        self._scale = self._size.prod(dim=1) / isolated / self.in_area
        self.flown = 0
        self.path = torch.zeros(count, task.waypoints + 1, 2, device=device)
        self.path[:, 0] = (worlds.start - self._low) / self._size
        start = self._cells(self.path[:, 0])
        self.seen = self._unseen.see(start, start)

    @property
    def position(self) -> Tensor:
        """Where the drones are, (B, 2)."""
        return self.path[:, self.flown]

    def observe(self) -> Tensor:
        """Return what the searches show, see `observation.observe`."""
        flown = torch.full((self.count,), self.flown, device=self.path.device)
        return observe(self.task.layout, self.path, flown, self.means, VARIANCE)

    def step(self, action: Tensor) -> Tensor:
        """Fly one step; after `waypoints` of them the searches must begin anew.

        Parameters
        ----------
        action : (B,) float32
            Headings, -1 to 1.

        Returns
        -------
        (B,) float32
            The shaped reward r'.

        Raises
        ------
        Diverged
            When a heading is not finite.
        """
        check_finite("headings of the policy", action)
        task, before = self.task, self.position
        heading = math.pi * (action + 1.0)
        unit = torch.stack([torch.cos(heading), torch.sin(heading)], dim=-1)
        after = before + self._unseen.step[:, None] / self._size * unit
        gain = self._unseen.see(self._cells(before), self._cells(after))
        self.flown += 1
        self.path[:, self.flown] = after
        self.seen = self.seen + gain
        reward = self._scale * gain
        earned = torch.where(reward > task.epsilon, task.w_r * reward, -task.w_0)
        return torch.where(is_inside(after), earned, -task.w_oob)

    def _cells(self, position: Tensor) -> Tensor:
        """Return positions in cells of the raster; far outside the area they may lie off it."""
        return self._low + position * self._size


def _mixture(worlds: Worlds, means: Tensor) -> tuple[Tensor, Tensor]:
    """Return the paper's mixture on the rasters of worlds, per cell, and what lies in the area."""
    side, gaussians = worlds.density.shape[-1], means.shape[1]
    size = worlds.high - worlds.low
    deviation = PAPER_DEVIATION * worlds.step[:, None, None]
    centre = torch.arange(side, device=means.device) + 0.5 - worlds.low[:, None, :, None]
    axes = torch.exp(
        -0.5 * ((centre - (means * size[:, None])[..., None]) / deviation[..., None]) ** 2
    )
    peak = 1.0 / (2.0 * math.pi * gaussians * deviation.square())
    density = peak * torch.einsum("ngy,ngx->nyx", axes[:, :, 1], axes[:, :, 0])
    scale = size[:, None] / (math.sqrt(2.0) * deviation)
    shares = 0.5 * (torch.erf((1.0 - means) * scale) + torch.erf(means * scale))
    return density, shares.prod(dim=-1).mean(dim=-1)
