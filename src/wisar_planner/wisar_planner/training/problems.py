"""Random search problems, as planners take them, from the worlds of training."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np
import torch

from wisar_planner.pdm import Grid, RasterMap
from wisar_planner.policy.unseen_map import BLOCK
from wisar_planner.search.area import SearchArea
from wisar_planner.search.problem import SearchProblem
from wisar_planner.training.worlds import WorldDistribution, Worlds, random_worlds

# Worlds drawn together.
_TOGETHER = 16


def random_problems(
    count: int, distribution: WorldDistribution, generator: torch.Generator
) -> Iterator[SearchProblem]:
    """Yield random search problems; a cell of their worlds' rasters is a metre wide.

    Parameters
    ----------
    count : int
        How many.
    distribution : WorldDistribution
        What their worlds look like. Those of the paper's setup, as many as its share of the count,
        come first: they need smaller rasters.
    generator : torch.Generator
        Source of randomness.
    """
    paper = round(distribution.paper_share * count)
    for share, some in ((1.0, paper), (0.0, count - paper)):
        kind = dataclasses.replace(distribution, paper_share=share)
        for first in range(0, some, _TOGETHER):
            worlds = random_worlds(min(_TOGETHER, some - first), kind, generator)
            for k in range(len(worlds.steps)):
                yield _problem(worlds, k)


def _problem(worlds: Worlds, k: int) -> SearchProblem:
    """Return the search problem of a world."""
    low, high, start = (
        each[k].double().cpu().numpy() for each in (worlds.low, worlds.high, worlds.start)
    )
    step, radius = float(worlds.step[k]), float(worlds.radius[k])
    # Nothing lies beyond the swath around the area.
    columns, rows = (int(length) for length in np.ceil(high + radius) + BLOCK)
    density = worlds.density[k, :rows, :columns].double().clamp(min=0.0).cpu().numpy()
    rows, columns = density.shape
    return SearchProblem(
        pdm=RasterMap(density / density.sum(), Grid(0.0, 0.0, 1.0, columns, rows)),
        area=SearchArea.rectangle(*low, *high),
        start=np.clip(start, low, high),
        step_length=step,
        swath_radius=radius,
        max_distance=step * float(worlds.steps[k]),
    )
