"""What the paper's policy observes: five parts in one vector."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True)
class Layout:
    """Where the parts stand in the observation.

    Parameters
    ----------
    waypoints : int
        Steps of a search N.
    gaussians : int
        Gaussians of a map G.
    """

    waypoints: int
    gaussians: int

    @property
    def sizes(self) -> dict[str, int]:
        """Numbers of each part, in the order of the observation."""
        return {
            "path": 2 * self.waypoints,
            "pdm": 6 * self.gaussians,
            "position": 2,
            "out_of_bounds": 1,
            "steps": 1,
        }

    @property
    def size(self) -> int:
        """Numbers of the whole observation, 2 N + 6 G + 4."""
        return sum(self.sizes.values())

    def split(self, observation: Tensor) -> dict[str, Tensor]:
        """Return the parts of observations, (B, size), by name."""
        sizes = self.sizes
        parts = torch.split(observation, list(sizes.values()), dim=-1)
        return dict(zip(sizes, parts, strict=True))


def observe(layout: Layout, path: Tensor, flown: Tensor, means: Tensor, variance: float) -> Tensor:
    """Return what searches show, (B, layout.size) float32.

    Everything is scaled linearly, the area to [0, 1] x [0, 1] and the steps to [0, 1]. The path is
    x_0 ... x_t, then zeros: first all x, then all y. A Gaussian is its mean and its covariance, row
    by row. The paper's out-of-bounds state is 1 inside the area.

    Parameters
    ----------
    layout : Layout
        Where the parts stand.
    path : (B, N + 1, 2) float32
        Positions of the whole search; those after `flown` steps do not show.
    flown : (B,) int64
        Steps flown t. After the last one the path is x_0 ... x_(N - 1) with nothing in its value:
        the search is over.
    means : (B, G, 2) float32
        Means of the Gaussians.
    variance : float
        Variance of all of them along either axis.
    """
    count, n = len(path), layout.waypoints
    known = torch.arange(n, device=path.device) <= flown[:, None]
    shown = torch.where(known[:, None, :], path[:, :n].transpose(1, 2), 0.0)
    covariance = (variance * torch.eye(2, device=path.device)).reshape(1, 1, 4)
    pdm = torch.cat([means, covariance.expand(count, layout.gaussians, 4)], dim=-1)
    position = path[torch.arange(count, device=path.device), flown]
    return torch.cat(
        [
            shown.reshape(count, -1),
            pdm.reshape(count, -1),
            position,
            is_inside(position)[:, None].float(),
            flown[:, None] / n,
        ],
        dim=-1,
    )


def is_inside(position: Tensor) -> Tensor:
    """Tell which positions, (..., 2), lie in the area or on its border."""
    return ((position >= 0.0) & (position <= 1.0)).all(dim=-1)
