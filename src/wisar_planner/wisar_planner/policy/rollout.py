"""Whole searches flown by a policy on a problem's map."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from wisar_planner.errors import FloatArray
from wisar_planner.pdm import Grid
from wisar_planner.policy.flight_kernels import Flights, fly_step
from wisar_planner.policy.heading import GAUSSIAN
from wisar_planner.policy.model import Model
from wisar_planner.policy.observation import (
    DIRECTIONS,
    cells_per_step,
    constants,
    reference_density,
)
from wisar_planner.policy.unseen_map import BLOCK, OUTSIDE, UnseenMap, margin, window_side
from wisar_planner.search.area_raster import AreaRaster
from wisar_planner.search.problem import SearchProblem

# Cells of the largest raster of one search; a wider search gets coarser cells.
_MOST_CELLS = 1 << 22
# Cells of the rasters of all searches that are flown side by side.
_MOST_CELLS_TOGETHER = 1 << 23
# Where the policies are at home: side of the area and swath radius, in steps, of the paper's setup.
_HOME_SIDE, _HOME_RADIUS = 150.0 / 8.0, 2.5 / 8.0
# Limits of `view_scale`.
_SCALES = (0.75, 2.4)


class Terrain(NamedTuple):
    """A problem's map as the policy sees it before the first step.

    Attributes
    ----------
    density : (1, rows, columns) float32
        Density in units of the reference density.
    grid : Grid
        Where the cells lie.
    step, radius : float
        Step length and swath radius in cells.
    scale : float
        See `view_scale`.
    area : AreaRaster
        Where steps may go.
    heading : float
        First heading, rad: towards the centre of what is to be seen.
    unit : float
        Probability that a step over ground of the reference density sees.
    """

    density: npt.NDArray[np.float32]
    grid: Grid
    step: float
    radius: float
    scale: float
    area: AreaRaster
    heading: float
    unit: float

    @classmethod
    def of(cls, problem: SearchProblem) -> Terrain:
        """Return the map of a problem, as far as its budget reaches."""
        scale = view_scale(problem)
        viewed = scale * problem.step_length
        xmin, ymin, xmax, ymax = problem.area.bounds
        reach = problem.max_distance + problem.swath_radius
        low = np.maximum((xmin, ymin), problem.start - reach)
        high = np.minimum((xmax, ymax), problem.start + reach)
        cell = max(
            viewed / cells_per_step(problem.swath_radius / viewed),
            math.sqrt(math.prod(high - low) / _MOST_CELLS),
        )
        step, swath = problem.step_length / cell, problem.swath_radius / cell
        edge = margin(step, swath)
        window = window_side(step, swath)
        columns, rows = (
            BLOCK * math.ceil(max(length / cell + 2 * edge, window) / BLOCK)
            for length in high - low
        )
        grid = Grid(low[0] - edge * cell, low[1] - edge * cell, cell, columns, rows)
        visible = problem.area.polygon.buffer(problem.swath_radius)
        inside = AreaRaster.of(visible, grid).centres_inside()
        # A hair inside the border, so that rounding never puts a waypoint outside.
        within = problem.area.polygon.buffer(-1e-7 * problem.step_length)
        # At the centres, as in training: a tenth of the time of the exact mass of every cell.
        mass = (problem.pdm.density(grid.centres()[inside]) * cell**2).astype(np.float32)
        if not mass.any():
            mass[:] = 1.0
        density = np.zeros(inside.shape, dtype=np.float32)
        density[inside] = mass
        centre = [
            np.arange(len(marginal)) @ marginal / marginal.sum(dtype=np.float64)
            for marginal in (density.sum(axis=0), density.sum(axis=1))
        ]
        toward = np.array([grid.x0, grid.y0]) + cell * (np.array(centre) + 0.5) - problem.start
        density[~inside] = OUTSIDE
        single = [np.array([value], dtype=np.float32) for value in (step, swath)]
        fresh = UnseenMap(density[None], single[0], single[1], window)
        reference = reference_density(fresh, np.array([problem.steps], dtype=np.float32))
        np.divide(density, reference, out=density, where=inside)
        unit = 2.0 * swath * step * float(reference[0])
        return cls(
            density[None], grid, step, swath, scale, AreaRaster.of(within, grid),
            math.atan2(toward[1], toward[0]), unit,
        )  # fmt: skip

    @property
    def most_searches(self) -> int:
        """How many searches fit side by side in memory."""
        return max(1, _MOST_CELLS_TOGETHER // self.density.size)

    def unseen(self, count: int) -> UnseenMap:
        """Return the map for some searches side by side, none of which has seen anything yet."""
        ones = np.ones(count, dtype=np.float32)
        return UnseenMap(
            np.repeat(self.density, count, axis=0),
            ones * np.float32(self.scale * self.step),
            ones * np.float32(self.radius),
            window_side(self.step, self.radius),
        )

    def to_cells(self, points: FloatArray) -> FloatArray:
        """Return points in metres, (..., 2), as points in cells, as `UnseenMap` counts them."""
        return (points - (self.grid.x0, self.grid.y0)) / self.grid.cell


def view_scale(problem: SearchProblem) -> float:
    """Return how many steps of a problem a policy should take for one.

    A policy decides after each step, but it sees distances, the steps left and the swath radius in
    steps of this length. 1 in the paper's setup, where policies are trained most; with wider swaths
    and areas they do better when the world looks more like that one. The exponents are a fit to
    1,200 random worlds, see docs/policy.md.

    Parameters
    ----------
    problem : SearchProblem
        The problem.
    """
    side = math.sqrt(problem.area.polygon.area) / problem.step_length
    radius = problem.swath_radius / problem.step_length
    scale = math.sqrt(radius / _HOME_RADIUS) * (side / _HOME_SIDE) ** 0.25
    return min(max(scale, _SCALES[0]), _SCALES[1])


def fly(
    problem: SearchProblem,
    terrain: Terrain,
    model: Model,
    *,
    flown: FloatArray | None = None,
    count: int = 1,
    rng: np.random.Generator | None = None,
    on_step: Callable[[FloatArray], bool] | None = None,
) -> FloatArray:
    """Fly searches to the end of the budget.

    Parameters
    ----------
    problem : SearchProblem
        The problem.
    terrain : Terrain
        Its map.
    model : Model
        The policy.
    flown : (K + 1, 2) float64, optional
        The waypoints of the first K steps, in metres, from where all searches go on; the start
        alone unless given.
    count : int
        Number of searches.
    rng : numpy.random.Generator, optional
        Source of randomness; without it the most likely turns are flown.
    on_step : callable, optional
        Told after each step the probability that each search has seen, (count,); once it says
        True the searches end.

    Returns
    -------
    (count, N + 1, 2) float64
        The paths in metres; shorter than the budget where a search found no whole step that stays
        in the area, or was stopped.
    """
    if flown is None:
        flown = problem.start[None]
    # A path of one search, in cells, as paths of all.
    before = np.repeat(terrain.to_cells(flown)[:, None], count, axis=1)
    cells = list(before)
    unseen = terrain.unseen(count)
    seen = unseen.see_path(before.astype(np.float32)).astype(np.float64)
    heading = terrain.heading
    if len(flown) > 1:
        heading = math.atan2(*(flown[-1] - flown[-2])[::-1])
    position = cells[-1].copy()
    fixed = constants(np, "cpu")
    flights = Flights(
        unseen.levels_in_memory(), unseen.before, unseen.step, unseen.radius, unseen.window,
        fixed.distances, fixed.swath, position, np.full(count, heading), seen,
    )  # fmt: skip
    unit = terrain.unit / (2.0 * terrain.radius * terrain.step)
    quiet = np.zeros((count, DIRECTIONS), dtype=np.float32)
    for steps in range(len(flown) - 1, problem.steps):
        possible = fly_step(
            flights, model.ring_weights, model.distribution == GAUSSIAN, terrain.area,
            terrain.step, (problem.steps - steps) / terrain.scale,
            quiet if rng is None else model.noise(rng, count),
        )  # fmt: skip
        if not possible:
            break
        cells.append(position.copy())
        if on_step is not None and on_step(flights.seen * unit):
            break
    origin = np.array([terrain.grid.x0, terrain.grid.y0])
    waypoints = origin + terrain.grid.cell * np.stack(cells, axis=1)
    waypoints[:, : len(flown)] = flown
    return waypoints
