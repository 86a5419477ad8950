r"""What keeps a path from the upper bound, part by part.

The bound takes the most probable ground S of A = 2 R L + pi R^2 square metres: what a path of
length L with swath radius R sweeps at most. Every square metre of that sweep is put into one class:

- *best*: in S and not seen before; nothing is lost on it,
- *transit*: outside S and not seen before, on the steps before the first that reaches S,
- *crossing*: the same on later steps that do not reach S, from one part of S to the next,
- *low ground*: the same on steps that reach S, at its fringe,
- *turns*: seen by the leg before, on the inside of a turn,
- *overlap*: seen by an earlier leg,
- *unused*: not swept, since the path is shorter than the longest distance.

A step reaches S when at least half of what it newly sees lies in S. All classes but the first are
waste, W square metres together. Had they been spent on S, they would have seen what is left of it:
the bound's mass B less the mass G that the path saw in S. So a wasted square metre is charged the
mean of that,

.. math:: \mu = (B - G) / W,

less the probability that was seen on it instead. With M the mass seen outside S, the charges add up
to :math:`\mu W - M = B - (G + M)`, the gap between the bound and what the path sees, exactly and
whatever S is. S comes from a raster, so a charge can be off by what is lost there: cells of half
a swath radius, or wider where that would take more than 250,000.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import joblib
import numpy as np

from wisar_planner.errors import FloatArray
from wisar_planner.evaluation.run import RunRecord
from wisar_planner.evaluation.runner import Evaluation
from wisar_planner.evaluation.scenario import Scenario
from wisar_planner.evaluation.statistics import estimate_of
from wisar_planner.pdm import Grid, ProbabilityMap, RasterMap
from wisar_planner.pdm.boundary import polygon_edges
from wisar_planner.pdm.coverage_kernels import coverage
from wisar_planner.search import SearchPath, SearchProblem, reachable_bound, upper_bound
from wisar_planner.search.seen_area import gains_along

#: The classes of waste, in the order of the tables.
PARTS = ("transit", "crossing", "low_ground", "turns", "overlap", "unused")

# Cells of the raster that tells the most probable ground.
_MOST_CELLS = 250_000


def gap_parts(
    problem: SearchProblem, path: SearchPath, bound: float | None = None
) -> dict[str, float]:
    """Return what each class of waste costs a path, as probability efficiency.

    Parameters
    ----------
    problem : SearchProblem
        The problem.
    path : SearchPath
        The path.
    bound : float, optional
        The problem's `upper_bound`, where it is at hand.

    Returns
    -------
    dict
        `PARTS` and their values, whose sum is the bound less the path's efficiency. A part can be
        slightly negative where the raster is coarse.
    """
    radius, points = path.swath_radius, path.waypoints
    bound = upper_bound(problem) if bound is None else bound
    best_area, best_mass = _most_probable_ground(problem)
    everywhere, unit = _even_map(problem)
    # By step, the disc about the first point being step 0.
    area = gains_along(everywhere, points, radius) * unit
    good_area = np.minimum(gains_along(best_area, points, radius) * unit, area)
    low_area = area - good_area
    low_mass = gains_along(problem.pdm, points, radius) - gains_along(best_mass, points, radius)
    swept = 2.0 * radius * np.diff(path.distances, prepend=0.0)
    swept[0] = math.pi * radius**2
    turns = _turns(everywhere, points, radius, swept, unit)

    reaching = (good_area >= 0.5 * area) & (good_area > 0.0)
    reached = np.logical_or.accumulate(reaching)
    steps = {"transit": ~reached, "crossing": reached & ~reaching, "low_ground": reaching}
    waste = {name: float(low_area[chosen].sum()) for name, chosen in steps.items()}
    waste["turns"] = turns
    waste["overlap"] = float((swept - area).sum()) - turns
    waste["unused"] = 2.0 * radius * (problem.max_distance - path.length)
    seen_instead = {name: float(low_mass[chosen].sum()) for name, chosen in steps.items()}

    gap = bound * problem.probability_in_area - path.seen_probability(problem.pdm)
    total = sum(waste.values())
    if total < 1e-6 * math.pi * radius**2:
        # A straight flight over the best ground: what is left is the slack of the bound.
        waste, total, seen_instead = {"low_ground": 1.0}, 1.0, {}
    charge = (gap + sum(seen_instead.values())) / total
    return {
        name: (charge * waste.get(name, 0.0) - seen_instead.get(name, 0.0))
        / problem.probability_in_area
        for name in PARTS
    }


def summarise_gap(
    evaluation: Evaluation, records: Sequence[RunRecord], *, jobs: int = -1
) -> dict[str, Any]:
    """Return the parts of the gap and the reachable bound over all runs, ready for JSON.

    Parameters
    ----------
    evaluation : Evaluation
        What was run.
    records : sequence of RunRecord
        Its runs.
    jobs : int
        Processes; -1 for one per core.

    Returns
    -------
    dict
        ``reachable_bound``, the mean `reachable_bound` with its interval, and ``planners``: for
        each planner ``share_of_bound``; the parts, each as a share of the sum of the upper bounds,
        so that all of these sum to 1; and ``share_of_reachable_bound``, None for a planner that
        does not begin at the start. Each has its interval beside it, ``_ci``.
    """
    by_map = [
        [record for record in records if record.index == index] for index in range(evaluation.runs)
    ]
    found = joblib.Parallel(n_jobs=jobs)(
        joblib.delayed(_of_map)(evaluation.scenario, evaluation.seed, index, runs)
        for index, runs in enumerate(by_map)
    )
    reachable = [bound for bound, _ in found]
    parts: dict[str, list[dict[str, float]]] = {spec.name: [] for spec in evaluation.planners}
    for runs, (_, of_runs) in zip(by_map, found, strict=True):
        for record, values in zip(runs, of_runs, strict=True):
            parts[record.planner].append(values)
    return {
        "reachable_bound": estimate_of("e_p_mean", reachable),
        "planners": {
            name: _planner(
                [record for record in records if record.planner == name], values, reachable
            )
            for name, values in parts.items()
        },
    }


def gap_markdown(gap: Mapping[str, Any]) -> str:
    """Return what `summarise_gap` returned as a Markdown table."""
    heads = [name.replace("_", " ") for name in PARTS]
    lines = [
        "| planner | of bound | " + " | ".join(heads) + " | of reachable bound |",
        "| --- |" + " ---: |" * (len(PARTS) + 2),
    ]
    for name, planner in gap["planners"].items():
        shares = [planner["share_of_bound"], *(planner[part] for part in PARTS)]
        cells = [_percent(share) for share in (*shares, planner["share_of_reachable_bound"])]
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    return "\n".join(lines) + (
        "\n\nShares of the upper bound: what is seen, and what is lost to each kind of waste; a "
        "row sums to 100%. Transit, crossing, low ground: new ground outside the most probable, "
        "before the first step that reaches it, on later steps that do not, at its fringe. Turns, "
        "overlap: ground seen before, by the leg before or by others. Unused: distance not flown. "
        f"The reachable bound, {gap['reachable_bound']['e_p_mean']:.4f} on average, holds for "
        "paths from the start.\n"
    )


def _of_map(
    scenario: Scenario, seed: int, index: int, records: Sequence[RunRecord]
) -> tuple[float, list[dict[str, float]]]:
    """Return the reachable bound of a map and the parts of the gap of its runs."""
    problem = scenario.problem(seed, index)
    parts = []
    for record in records:
        # Records keep millimetres, in which a tiny step may vanish.
        points = np.asarray(record.waypoints)
        moved = np.append(True, (np.diff(points, axis=0) != 0.0).any(axis=1))
        path = SearchPath(points[moved], problem.swath_radius)
        parts.append(gap_parts(problem, path, record.bound))
    return reachable_bound(problem), parts


def _planner(
    runs: Sequence[RunRecord], parts: Sequence[Mapping[str, float]], reachable: Sequence[float]
) -> dict[str, Any]:
    bounds = [run.bound for run in runs]
    lost = np.array([[part[name] for name in PARTS] for part in parts])
    seen = bounds - lost.sum(axis=1)
    from_start = all(run.offset <= 1e-6 for run in runs)
    summary = estimate_of("share_of_bound", seen, bounds)
    for name, column in zip(PARTS, lost.T, strict=True):
        summary |= estimate_of(name, column, bounds)
    of_reachable = estimate_of("share_of_reachable_bound", seen, reachable)
    return summary | (of_reachable if from_start else dict.fromkeys(of_reachable))


def _percent(share: float | None) -> str:
    # Adding zero makes a rounded -0.0 positive.
    return "–" if share is None else f"{round(100.0 * share, 1) + 0.0:.1f}%"


def _grid(problem: SearchProblem) -> Grid:
    """Return a grid over all that can be seen from the area."""
    xmin, ymin, xmax, ymax = problem.area.bounds
    radius = problem.swath_radius
    bounds = (xmin - radius, ymin - radius, xmax + radius, ymax + radius)
    size = (xmax - xmin + 2.0 * radius) * (ymax - ymin + 2.0 * radius)
    return Grid.covering(bounds, max(0.5 * radius, math.sqrt(size / _MOST_CELLS)))


def _most_probable_ground(problem: SearchProblem) -> tuple[ProbabilityMap, ProbabilityMap]:
    """Return the most probable ground as maps of its area, in units of the grid, and its mass."""
    grid = _grid(problem)
    mass = problem.pdm.rasterize(grid)
    visible = problem.area.polygon.buffer(problem.swath_radius, join_style="mitre")
    edges = polygon_edges(visible)
    covered = coverage(edges, grid.x0, grid.y0, grid.cell, grid.rows, grid.columns)
    covered = np.clip(covered, 0.0, 1.0).ravel()
    order = np.argsort(-np.where(covered > 0.0, mass.ravel(), -1.0), kind="stable")
    radius = problem.swath_radius
    wanted = (2.0 * radius * problem.max_distance + math.pi * radius**2) / grid.cell**2
    sizes = covered[order]
    taken = np.clip(wanted - (np.cumsum(sizes) - sizes), 0.0, sizes)
    best = np.zeros(mass.size)
    best[order] = np.divide(taken, sizes, out=np.zeros_like(taken), where=sizes > 0.0)
    share = best.reshape(mass.shape)
    return RasterMap(share / mass.size, grid), RasterMap(share * mass, grid)


def _even_map(problem: SearchProblem) -> tuple[ProbabilityMap, float]:
    """Return a map of even density on which probability measures area, and its area, m^2."""
    grid = _grid(problem)
    even = np.full((grid.rows, grid.columns), 1.0 / (grid.rows * grid.columns))
    return RasterMap(even, grid), grid.rows * grid.columns * grid.cell**2


def _turns(
    everywhere: ProbabilityMap, points: FloatArray, radius: float, swept: FloatArray, unit: float
) -> float:
    """Return the area that legs sweep where the leg before has swept, m^2."""
    new = [gains_along(everywhere, points[i : i + 3], radius)[2] for i in range(len(points) - 2)]
    return float(swept[2:].sum() - sum(new) * unit)
