"""What search would do where a policy comes to, for the policy to learn."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import torch

from wisar_planner.errors import FloatArray
from wisar_planner.planners.cell_vectors import PERIODS
from wisar_planner.planners.random_kernels import random_state
from wisar_planner.planners.refine import Schedule, annealing
from wisar_planner.planners.search_raster import FINE, SearchRaster
from wisar_planner.planners.swath_kernels import ADD, REMOVE, paint_path
from wisar_planner.policy.heading import wrapped
from wisar_planner.policy.model import Model
from wisar_planner.policy.observation import DIRECTIONS, NUMBERS, VIEW_WIDTH, observe
from wisar_planner.policy.rollout import Terrain, fly
from wisar_planner.search.problem import SearchProblem
from wisar_planner.training.expert_iteration.config import ExpertConfig
from wisar_planner.training.problems import random_problems

# Fewest steps that are left to search.
_FEWEST_STEPS = 8
# Share of the flights whose turns are random, so that states differ more.
_RANDOM_SHARE = 0.5


class Labels(NamedTuple):
    """What search does in n states.

    Attributes
    ----------
    view, numbers
        See `Observation`; the view in half precision.
    turn : (n,) float32
        Turns of the path that search found, in units of pi.
    """

    view: npt.NDArray[np.float16]
    numbers: npt.NDArray[np.float32]
    turn: npt.NDArray[np.float32]

    @classmethod
    def joined(cls, parts: Sequence[Labels]) -> Labels:
        """Return the labels of all parts."""
        none = cls(
            np.empty((0, DIRECTIONS, VIEW_WIDTH), np.float16),
            np.empty((0, NUMBERS), np.float32),
            np.empty(0, np.float32),
        )
        return cls(*(np.concatenate(each) for each in zip(none, *parts, strict=True)))


class Lesson(NamedTuple):
    """Labels of some flights, and what search brought there.

    Attributes
    ----------
    labels : Labels
        The labels.
    seen, found : float
        What the policy saw on the steps that were labelled, in steps over the most probable
        ground, and what search saw instead; sums over the flights.
    """

    labels: Labels
    seen: float
    found: float


def lesson(
    config: ExpertConfig, model: Model, flights: tuple[int, int], seed: tuple[int, ...]
) -> Lesson:
    """Let search label flights of a policy in random worlds.

    The same arguments give the same lesson, whatever the machine's speed.

    Parameters
    ----------
    config : ExpertConfig
        The configuration.
    model : Model
        The policy.
    flights : (int, int)
        Number of flights in the paper's setup and in other worlds.
    seed : tuple of int
        Seed of the worlds, the flights and the search.
    """
    rng = np.random.default_rng(seed)
    generator = torch.Generator().manual_seed(int(rng.integers(2**31)))
    parts, seen, found = [], 0.0, 0.0
    for problem in random_problems(*flights, config.worlds, generator):
        terrain = Terrain.of(problem)
        first = int(rng.integers(0, max(1, problem.steps - _FEWEST_STEPS + 1)))
        flown = _beginning(problem, terrain, model, first, rng)
        own = fly(problem, terrain, model, flown=flown)[0]
        if len(own) <= problem.steps:
            continue
        raster = _unseen_after(problem, flown)
        rest = raster.to_cells(own[first:])
        seen += _weight(raster, rest) * raster.unit / terrain.unit
        if config.tries:
            rest = _best_try(problem, terrain, model, flown, raster, rest, config.tries, rng)
        for now in annealing(
            raster, rest, Schedule(), random_state(rng),
            iterations=config.moves * (len(rest) - 1), early_weight=config.early_weight,
        ):  # fmt: skip
            rest = now.points
        found += now.probability / terrain.unit
        parts.append(_along(terrain, flown, raster.to_metres(rest)))
    return Lesson(Labels.joined(parts), seen, found)


def _beginning(
    problem: SearchProblem, terrain: Terrain, model: Model, steps: int, rng: np.random.Generator
) -> FloatArray:
    """Return the first steps of a policy's flight, with random turns or without."""
    if steps == 0:
        return problem.start[None]
    flown = itertools.count(1)
    return fly(
        problem, terrain, model, rng=rng if rng.random() < _RANDOM_SHARE else None,
        on_step=lambda _: next(flown) == steps,
    )[0]  # fmt: skip


def _best_try(
    problem: SearchProblem, terrain: Terrain, model: Model, flown: FloatArray,
    raster: SearchRaster, rest: FloatArray, tries: int, rng: np.random.Generator,
) -> FloatArray:  # fmt: skip
    """Return, of a way on in cells and of ways with random turns, the one that sees the most."""
    ways = fly(problem, terrain, model, flown=flown, count=tries, rng=rng)[:, len(flown) - 1 :]
    if ways.shape[1] < len(rest):
        return rest
    return max(rest, *(raster.to_cells(each) for each in ways), key=partial(_weight, raster))


def _unseen_after(problem: SearchProblem, flown: FloatArray) -> SearchRaster:
    """Return the raster of what a path leaves unseen."""
    # On a coarser one annealing finds mostly what only that raster sees.
    raster = SearchRaster(problem, FINE)
    points, tally = raster.to_cells(flown), np.zeros(PERIODS, np.int64)
    arguments = (raster.canvas, points, 0, len(flown) - 1, raster.radius)
    paint_path(*arguments, ADD, tally)
    raster.canvas.weights[raster.canvas.counts > 0] = 0
    paint_path(*arguments, REMOVE, tally)
    return raster


def _weight(raster: SearchRaster, points: FloatArray) -> int:
    """Return the weight that a path in cells sees."""
    tally = np.zeros((2, PERIODS), np.int64)
    arguments = (raster.canvas, points, 0, len(points) - 1, raster.radius)
    paint_path(*arguments, ADD, tally[0])
    paint_path(*arguments, REMOVE, tally[1])
    return int(tally[0, -1])


def _along(terrain: Terrain, flown: FloatArray, rest: FloatArray) -> Labels:
    """Return what a policy would be shown before each step of a path's rest, and its turns there.

    Parameters
    ----------
    terrain : Terrain
        The problem's map.
    flown : (K + 1, 2) float64
        The waypoints until there, m.
    rest : (n + 1, 2) float64
        The waypoints from there on, m; to the end of the budget.
    """
    unseen = terrain.unseen(1)
    unseen.see_path(terrain.to_cells(flown).astype(np.float32)[:, None])
    after = terrain.to_cells(rest).astype(np.float32)[:, None]
    moves = np.diff(np.concatenate([flown[-2:-1], rest]), axis=0)
    headings = np.arctan2(moves[:, 1], moves[:, 0])
    if len(flown) == 1:
        headings = np.concatenate([[terrain.heading], headings])
    steps = len(rest) - 1
    views = np.empty((steps, DIRECTIONS, VIEW_WIDTH), np.float16)
    numbers = np.empty((steps, NUMBERS), np.float32)
    left = (np.arange(steps, 0, -1, dtype=np.float32) / np.float32(terrain.scale))[:, None]
    ahead = headings[:-1].astype(np.float32)[:, None]
    for k in range(steps):
        shown = observe(unseen, after[k], ahead[k], left[k])
        views[k], numbers[k] = shown.view[0], shown.numbers[0]
        unseen.see(after[k], after[k + 1])
    turns = wrapped(np.diff(headings) / math.pi)
    return Labels(views, numbers, turns.astype(np.float32))
