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
from wisar_planner.training.worlds import WorldDistribution, Worlds, parts, random_worlds

# Worlds other than the paper's that are drawn together: their rasters are large.
_TOGETHER = 16


def random_problems(
    paper: int, others: int, distribution: WorldDistribution, generator: torch.Generator
) -> Iterator[SearchProblem]:
    """Yield random search problems; a cell of their worlds' rasters is a metre wide.

    Parameters
    ----------
    paper : int
        How many of the paper's setup; those come first, the ones that as many searches of a
        `SearchEnvironment` have.
    others : int
        How many of other worlds.
    distribution : WorldDistribution
        What the other worlds look like.
    generator : torch.Generator
        Source of randomness.
    """
    for share, drawn in ((1.0, parts(paper)), (0.0, parts(others, _TOGETHER))):
        kind = dataclasses.replace(distribution, paper_share=share)
        for part in drawn:
            worlds = random_worlds(len(part), kind, generator)
            for k in range(len(part)):
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
