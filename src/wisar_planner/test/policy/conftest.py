import math

import numpy as np
import pytest

from wisar_planner import GaussianMixture, Grid
from wisar_planner.policy.observation import cells_per_step
from wisar_planner.policy.unseen_map import BLOCK, UnseenMap, margin, window_side


class World:
    """A paper-like map of one search; lengths in cells, the raster's cell a metre wide."""

    def __init__(self, seed: int, radius: float, sides: float = 14.0) -> None:
        self.rng = np.random.default_rng(seed)
        self.step = cells_per_step(radius)
        self.radius = radius * self.step
        self.edge = margin(self.step, self.radius)
        self.side = BLOCK * math.ceil((sides * self.step + 2 * self.edge) / BLOCK)
        low, high = self.edge, self.side - self.edge
        self.pdm = GaussianMixture(
            np.full(4, 0.25),
            self.rng.uniform(low, high, (4, 2)),
            np.repeat((2.8 * self.step) ** 2 * np.eye(2)[None], 4, axis=0),
        )
        self.grid = Grid(0.0, 0.0, 1.0, self.side, self.side)
        self.mass = self.pdm.rasterize(self.grid)

    def unseen(self, *rasters: np.ndarray) -> UnseenMap:
        """Return a map of these rasters, side by side; of this world's unless given."""
        density = np.array(rasters or [self.mass], dtype=np.float32)
        ones = np.ones(len(density), dtype=np.float32)
        window = window_side(self.step, self.radius)
        return UnseenMap(density, ones * self.step, ones * self.radius, window)

    def path(self, steps: int, turn: float) -> np.ndarray:
        """Return waypoints of a random walk that keeps off the border, (steps + 1, 2) float32."""
        low, high = self.edge, self.side - self.edge
        heading = self.rng.uniform(0.0, 2.0 * np.pi)
        points = [self.rng.uniform(low, high, 2)]
        while len(points) <= steps:
            heading += self.rng.normal(0.0, turn)
            end = points[-1] + self.step * np.array([np.cos(heading), np.sin(heading)])
            if ((end > low) & (end < high)).all():
                points.append(end)
        return np.array(points, dtype=np.float32)


@pytest.fixture
def make_world():
    """Make a world from a seed and a swath radius in steps."""
    return World


@pytest.fixture
def fly():
    """See along a path, the disc at its start first; return what each step saw."""

    def see(unseen: UnseenMap, path: np.ndarray) -> np.ndarray:
        legs = zip(np.concatenate([path[:1], path[:-1]]), path, strict=True)
        count = len(unseen.step)
        return np.array(
            [unseen.see(np.tile(a, (count, 1)), np.tile(b, (count, 1))) for a, b in legs]
        )

    return see
