"""Many searches at once, on the CPU or a GPU."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from wisar_planner.policy.observation import Observation, observe, reference_density
from wisar_planner.policy.unseen_map import UnseenMap
from wisar_planner.training.divergence import check_finite
from wisar_planner.training.worlds import WorldDistribution, parts, random_worlds

# Turns tried, in this order, where a step would leave the area; the last is a U-turn.
_TURNS = 32


class SearchEnvironment:
    """B searches in random worlds; each starts anew in another world when its budget is flown.

    The action is the turn from the last heading in units of pi. Where it would lead out of the
    area, the drone flies the nearest heading that does not.

    Parameters
    ----------
    count : int
        Number of searches B.
    distribution : WorldDistribution
        What the worlds look like.
    generator : torch.Generator
        Source of randomness; its device is the environment's.
    stagger : bool
        Whether the first searches begin with part of their budget flown, so that not all end at
        once.
    """

    def __init__(
        self,
        count: int,
        distribution: WorldDistribution,
        generator: torch.Generator,
        *,
        stagger: bool = False,
    ) -> None:
        self.distribution = distribution
        self.generator = generator
        device = generator.device
        side = distribution.side

        def zeros(*shape: int) -> Tensor:
            return torch.zeros(count, *shape, device=device)

        self.unseen = UnseenMap(zeros(side, side), zeros(), zeros(), distribution.window)
        self.low, self.high, self.position = zeros(2), zeros(2), zeros(2)
        self.heading, self.steps, self.steps_left = zeros(), zeros(), zeros()
        #: Density x cells in the area when the search began, and what was seen of it since.
        self.in_area, self.seen = zeros(), zeros()
        #: Where the last steps ended, before searches began anew.
        self.reached = zeros(2)
        turns = torch.arange(_TURNS + 1, device=device)
        sign = 1.0 - 2.0 * (turns % 2)
        self._turns = sign * torch.ceil(turns / 2.0) * (2.0 * math.pi / _TURNS)
        for part in parts(count):
            self._begin(torch.arange(part.start, part.stop, device=device))
        if stagger:
            share = torch.rand(count, generator=generator, device=device)
            self.steps_left = torch.clamp(torch.ceil(share * self.steps), min=1.0)

    def tensors(self) -> dict[str, Tensor]:
        """Return its state by name, for checkpoints; written to, it is another state."""
        names = ("low", "high", "position", "heading", "steps", "steps_left", "in_area", "seen")
        return {name: getattr(self, name) for name in names} | self.unseen.arrays()

    def observe(self) -> Observation:
        """Return what the searches show."""
        return observe(self.unseen, self.position, self.heading, self.steps_left)

    def step(self, action: Tensor) -> tuple[Tensor, Tensor]:
        """Fly one step; start those anew whose budget is flown.

        Parameters
        ----------
        action : (B,) float32
            Turns in units of pi, -1 to 1.

        Returns
        -------
        reward : (B,) float32
            Probability newly seen over what a step sees on the most probable ground.
        done : (B,) bool
            Which searches ended with this step.

        Raises
        ------
        Diverged
            When a turn is not finite: what the drone saw from nowhere could not be looked up.
        """
        check_finite("turns of the policy", action)
        wanted = self.heading + math.pi * action
        headings = wanted[:, None] + self._turns
        ends = self.position[:, None, :] + self.unseen.step[:, None, None] * torch.stack(
            [torch.cos(headings), torch.sin(headings)], dim=-1
        )
        inside = ((ends >= self.low[:, None]) & (ends <= self.high[:, None])).all(dim=-1)
        first = inside.int().argmax(dim=1)
        rows = torch.arange(len(first), device=first.device)
        end = ends[rows, first]
        gain = self.unseen.see(self.position, end)
        self.position, self.heading = end, headings[rows, first]
        self.reached = end.clone()
        self.steps_left = self.steps_left - 1.0
        self.seen = self.seen + gain
        reward = gain / (2.0 * self.unseen.radius * self.unseen.step)
        done = self.steps_left < 0.5
        if bool(done.any()):
            ended = torch.nonzero(done)[:, 0]
            self._begin(ended)
        return reward, done

    def _begin(self, searches: Tensor) -> None:
        """Put searches into new random worlds."""
        worlds = random_worlds(len(searches), self.distribution, self.generator)
        raw = UnseenMap(worlds.density, worlds.step, worlds.radius, self.distribution.window)
        reference = reference_density(raw, worlds.steps)[:, None, None]
        density = torch.where(raw.levels[0] >= 0.0, raw.levels[0] / reference, raw.levels[0])
        fresh = UnseenMap(density, worlds.step, worlds.radius, self.distribution.window)
        self.in_area[searches] = _mass_within(density, worlds.low, worlds.high)
        # The drone sees the ground around its start before it moves.
        self.seen[searches] = fresh.see(worlds.start, worlds.start)
        self.unseen.replace(searches, fresh)
        self.low[searches], self.high[searches] = worlds.low, worlds.high
        self.position[searches], self.heading[searches] = worlds.start, worlds.heading
        self.steps[searches] = self.steps_left[searches] = worlds.steps


def _mass_within(density: Tensor, low: Tensor, high: Tensor) -> Tensor:
    """Return the sum of density over rectangles, (n,); cells at the edge count in part."""
    cells = torch.arange(density.shape[1], device=density.device)
    shares = [
        torch.clamp(
            torch.minimum(cells + 1.0, high[:, axis, None])
            - torch.maximum(cells.float(), low[:, axis, None]),
            min=0.0,
        )
        for axis in (0, 1)
    ]
    return torch.einsum("nyx,nx,ny->n", density.clamp(min=0.0), shares[0], shares[1])
