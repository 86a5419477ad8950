"""Random search worlds to learn from."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
from torch import Tensor

from wisar_planner.errors import InvalidInput
from wisar_planner.policy import unseen_map
from wisar_planner.policy.observation import cells_per_step
from wisar_planner.policy.unseen_map import OUTSIDE, margin, window_side


class Worlds(NamedTuple):
    """Random worlds, lengths in cells of their rasters.

    Attributes
    ----------
    density : (n, side, side) float32
        Probability density, `OUTSIDE` beyond the area and the swath around it.
    low, high : (n, 2) float32
        Corners of the rectangular area.
    start : (n, 2) float32
        Where the drones start.
    heading : (n,) float32
        Their first headings, rad.
    step, radius : (n,) float32
        Step length and swath radius.
    steps : (n,) float32
        Steps that the budget allows.
    """

    density: Tensor
    low: Tensor
    high: Tensor
    start: Tensor
    heading: Tensor
    step: Tensor
    radius: Tensor
    steps: Tensor


@dataclass(frozen=True)
class WorldDistribution:
    """What random worlds look like. All lengths are in steps.

    A share of the worlds has the paper's setup: 18.75 steps square, 4 Gaussians of a standard
    deviation of 2.795 steps, a swath radius of 0.3125 steps, 64 steps. The others vary.

    Parameters
    ----------
    paper_share : float
        Share of worlds with the paper's setup.
    sides : (float, float)
        Shortest and longest side of the area. Narrower swaths need finer cells, so that a side is
        cut to what the raster has room for then, the shortest one, too: with swath radii from 0.2
        and sides up to 58 steps to 37.6 steps at the worst. That cuts a side in 7% of the other
        worlds of config/expert_iteration.yaml.
    modes : int
        Most Gaussians; from 1 up.
    deviations : (float, float)
        Smallest and largest standard deviation along the axes of a Gaussian.
    radii : (float, float)
        Smallest and largest swath radius.
    budgets : (int, int)
        Fewest and most steps of the budget.
    field_share : float
        Share of the worlds that vary whose density is no mixture but the exponential of smooth
        noise, which has detail everywhere.
    smoothness : (float, float)
        Smallest and largest standard deviation of the Gaussian that smooths that noise.
    contrast : (float, float)
        Smallest and largest standard deviation of the logarithm of that density.
    """

    paper_share: float = 1.0
    sides: tuple[float, float] = (10.0, 29.0)
    modes: int = 16
    deviations: tuple[float, float] = (0.8, 6.0)
    radii: tuple[float, float] = (0.2, 0.6)
    budgets: tuple[int, int] = (10, 160)
    field_share: float = 0.0
    smoothness: tuple[float, float] = (0.4, 4.0)
    contrast: tuple[float, float] = (0.5, 2.0)

    def __post_init__(self) -> None:
        for name in ("paper_share", "field_share"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise InvalidInput(f"{name} must be from 0 to 1, not {getattr(self, name)}")
        if not 1 <= self.modes <= 1000:
            raise InvalidInput(f"modes must be from 1 to 1000, not {self.modes}")
        for name, least in (
            # In an area two steps wide some heading stays inside wherever the drone is.
            ("sides", 2.0), ("deviations", 0.01), ("radii", 0.05), ("budgets", 1),
            ("smoothness", 0.1), ("contrast", 0.01),
        ):  # fmt: skip
            low, high = getattr(self, name)
            if not least <= low <= high < math.inf:
                raise InvalidInput(f"{name} must be two rising numbers from {least} up")
        widest = float(self.radii[1])
        cells = cells_per_step(widest)
        room = (self.side - 2 * _edge(math.ceil(cells * widest))) / cells
        if self.paper_share < 1.0 and room < self.sides[0]:
            raise InvalidInput(
                f"radii must leave room for sides of {self.sides[0]:g} steps, but {widest:g} "
                f"leaves {max(room, 0.0):.1f}: lower it, or raise the longest of sides"
            )

    @property
    def window(self) -> int:
        """Side of the window that a step can touch, in cells."""
        radii = [PAPER_RADIUS] if self.paper_share == 1.0 else [*self.radii, PAPER_RADIUS]
        return max(window_side(c := cells_per_step(r), c * r) for r in radii)

    @property
    def side(self) -> int:
        """Side of the rasters, in cells."""
        widest = PAPER_SIDE if self.paper_share == 1.0 else max(self.sides[1], PAPER_SIDE)
        cells = 8.0
        needed = math.ceil(widest * cells) + 2 * margin(cells, cells * 0.6)
        return unseen_map.BLOCK * math.ceil(needed / unseen_map.BLOCK)


# Logarithm of the least density of a Gaussian, over that at its mean.
_LEAST_EXPONENT = -80.0
# Least weight of a Gaussian, where the mean is 1.
_LEAST_WEIGHT = 1e-12

PAPER_SIDE = 150.0 / 8.0
PAPER_DEVIATION = math.sqrt(500.0) / 8.0
PAPER_RADIUS = 2.5 / 8.0
PAPER_MODES, PAPER_STEPS = 4, 64


# Worlds that are drawn at once, at most; bounds the memory for it.
_AT_ONCE = 4096


def parts(count: int, most: int | None = None) -> Iterator[range]:
    """Yield the numbers of worlds in parts that are drawn at once.

    Whoever draws as many worlds in the same parts from the same generator draws the same ones.

    Parameters
    ----------
    count : int
        How many worlds.
    most : int, optional
        Most worlds of a part; as many as memory is for unless given.
    """
    size = most or _AT_ONCE
    for first in range(0, count, size):
        yield range(first, min(first + size, count))


def _edge(reach: Any) -> Any:
    """Return how many cells are left around an area for a swath that reaches so many beyond it."""
    return unseen_map.BLOCK + reach + 2


def random_worlds(
    count: int, distribution: WorldDistribution, generator: torch.Generator
) -> Worlds:
    """Return random worlds on the generator's device.

    Parameters
    ----------
    count : int
        How many.
    distribution : WorldDistribution
        What they look like.
    generator : torch.Generator
        Source of randomness.
    """
    d = distribution
    where = generator.device

    def uniform(*shape: int) -> Tensor:
        return torch.rand(count, *shape, generator=generator, device=where)

    def between(limits: tuple[float, float], *shape: int) -> Tensor:
        """Return numbers whose logarithm is uniform."""
        low, high = limits
        return low * (high / low) ** uniform(*shape)

    paper = uniform() < d.paper_share
    radius = torch.where(paper, PAPER_RADIUS, between(d.radii))
    cells = cells_per_step(radius)
    edge = _edge(torch.ceil(cells * radius))
    room = (d.side - 2.0 * edge) / cells
    sides = torch.minimum(between(d.sides, 2), room[:, None])
    sides = torch.where(paper[:, None], PAPER_SIDE, sides)
    steps = torch.where(paper, float(PAPER_STEPS), torch.floor(between(d.budgets)))
    modes = torch.where(paper, PAPER_MODES, 1 + torch.floor(d.modes * uniform() ** 2).long())
    most = PAPER_MODES if d.paper_share == 1.0 else d.modes
    present = torch.arange(most, device=where) < modes[:, None]
    # One in millions of draws is 0, which would mean no mode; no other is below 1e-10.
    drawn = (-torch.log1p(-uniform(most))).clamp(min=_LEAST_WEIGHT)
    weights = torch.where(paper[:, None], 1.0, drawn)
    weights = torch.where(present, weights, 0.0)
    means = uniform(most, 2) * sides[:, None, :]
    deviations = between(d.deviations, most, 2)
    deviations = torch.where(paper[:, None, None], PAPER_DEVIATION, deviations)
    turn = math.pi * uniform(most)

    # From steps to cells, with room around the area.
    low = edge[:, None].expand(-1, 2)
    high = low + sides * cells[:, None]
    means = low[:, None, :] + means * cells[:, None, None]
    deviations = deviations * cells[:, None, None]
    density = _density(d.side, weights, means, deviations, turn)
    if d.field_share > 0.0:
        fields = torch.nonzero(~paper & (uniform() < d.field_share))[:, 0]
        smoothness, contrast = between(d.smoothness) * cells, between(d.contrast)
        if len(fields):  # a GPU's Fourier transform takes no empty batch
            density[fields] = _fields(d.side, smoothness[fields], contrast[fields], generator)
    centre = torch.arange(d.side, device=where) + 0.5
    reach = (radius * cells)[:, None]
    inside = [
        (centre > low[:, axis, None] - reach) & (centre < high[:, axis, None] + reach)
        for axis in (0, 1)
    ]
    density = torch.where(inside[1][:, :, None] & inside[0][:, None, :], density, OUTSIDE)
    return Worlds(
        density=density,
        low=low.contiguous(),
        high=high,
        start=low + uniform(2) * (high - low),
        heading=2.0 * math.pi * uniform(),
        step=cells,
        radius=radius * cells,
        steps=steps,
    )


def _density(side: int, weights: Tensor, means: Tensor, deviations: Tensor, turn: Tensor) -> Tensor:
    """Return the density of mixtures at the centres of cells, (n, side, side).

    A weight of 0 means that there is no such mode, nor any after it.
    """
    # Worlds of many modes first, so that those that have a k-th are the first ones.
    modes = (weights > 0.0).sum(dim=1)
    order = torch.argsort(modes, descending=True)
    having = (modes[:, None] > torch.arange(weights.shape[1], device=modes.device)).sum(dim=0)
    centre = torch.arange(side, device=weights.device) + 0.5
    density = torch.zeros(len(weights), side, side, device=weights.device)
    for k, count in enumerate(having.tolist()):
        some = order[:count]
        dx = (centre - means[some, k, 0, None])[:, None, :]
        dy = (centre - means[some, k, 1, None])[:, :, None]
        c, s = (f(turn[some, k])[:, None, None] for f in (torch.cos, torch.sin))
        along, across = (deviations[some, k, axis, None, None] for axis in (0, 1))
        u = (c / along) * dx + (s / along) * dy
        v = (c / across) * dy - (s / across) * dx
        # Numbers so small that they lose digits take processors ten times as long.
        exponent = u.square_().add_(v.square_()).mul_(-0.5).clamp_(min=_LEAST_EXPONENT)
        norm = weights[some, k, None, None] / (along * across)
        density[:count].addcmul_(exponent.exp_(), norm)
    return torch.empty_like(density).index_copy_(0, order, density)


def _fields(side: int, smoothness: Tensor, contrast: Tensor, generator: torch.Generator) -> Tensor:
    """Return densities whose logarithm is smooth noise, periodic over the raster, (n, side, side).

    Parameters
    ----------
    side : int
        Side of the rasters, in cells.
    smoothness : (n,)
        Standard deviation of the Gaussian that smooths white noise, in cells.
    contrast : (n,)
        Standard deviation of the logarithm.
    generator : torch.Generator
        Source of the noise.
    """
    where = generator.device
    noise = torch.randn(len(contrast), side, side, generator=generator, device=where)
    rows = torch.fft.fftfreq(side, device=where)[:, None]
    columns = torch.fft.rfftfreq(side, device=where)[None, :]
    # The Gaussian's Fourier transform.
    width = 2.0 * math.pi**2 * smoothness.square()[:, None, None]
    passed = torch.exp(-width * (rows.square() + columns.square()))
    field = torch.fft.irfft2(torch.fft.rfft2(noise) * passed, s=(side, side))
    field = field - field.mean(dim=(1, 2), keepdim=True)
    spread = field.square().mean(dim=(1, 2), keepdim=True).sqrt().clamp(min=1e-12)
    return torch.exp(contrast[:, None, None] * field / spread)
