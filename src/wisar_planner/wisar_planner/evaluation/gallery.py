"""Paths of all planners on a few of their maps, side by side."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import shapely
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch
from matplotlib.path import Path as OutlinePath
from shapely.plotting import patch_from_polygon

from wisar_planner.evaluation.palette import Look
from wisar_planner.evaluation.run import RunRecord
from wisar_planner.evaluation.scenario import Scenario
from wisar_planner.pdm import Grid
from wisar_planner.search import SearchProblem

#: Rows of the gallery: where in the order of a map's mean share of the bound it stands.
_ROWS = (("easy map", 0.95), ("median map", 0.5), ("hard map", 0.05))

_CELLS = 150
_PANEL_INCHES = 1.9


def draw_gallery(
    results: Mapping[str, Any],
    records: Sequence[RunRecord],
    scenario: Scenario,
    styles: Mapping[str, Look],
) -> Figure:
    """Return paths of all planners on an easy, a median and a hard map.

    Maps are ordered by the mean over the planners of the share of the bound that they reach.

    Parameters
    ----------
    results : Mapping
        What `summarise` returned.
    records : sequence of RunRecord
        The runs that it was made from.
    scenario : Scenario
        Where the maps come from.
    styles : Mapping
        Look of each planner.
    """
    names = list(results["planners"])
    runs = {(record.planner, record.index): record for record in records}
    chosen = choose_maps(records)
    figure = Figure(
        figsize=(0.4 + _PANEL_INCHES * len(names), 0.3 + 2.1 * len(chosen)), layout="constrained"
    )
    panels = figure.subplots(len(chosen), len(names), squeeze=False)
    for row, (label, index) in zip(panels, chosen, strict=True):
        problem = scenario.problem(results["setup"]["seed"], index)
        x0, y0, x1, y1 = problem.area.bounds
        grid = Grid.covering((x0, y0, x1, y1), max(x1 - x0, y1 - y0) / _CELLS)
        cells = problem.pdm.rasterize(grid)
        for axes, name in zip(row, names, strict=True):
            _draw_map(axes, problem, grid, cells)
            _draw_path(axes, problem, runs[name, index], styles[name])
        row[0].set_ylabel(f"{label}, number {index}", fontsize=9)
    for axes, name in zip(panels[0], names, strict=True):
        axes.set_title(f"{name}\n{axes.get_title()}", fontsize=9)
    return figure


def choose_maps(records: Sequence[RunRecord]) -> list[tuple[str, int]]:
    """Return labels and indices of the maps to show, each map once.

    Parameters
    ----------
    records : sequence of RunRecord
        All runs.
    """
    indices = sorted({record.index for record in records})
    share = dict.fromkeys(indices, 0.0)
    for record in records:
        share[record.index] += record.e_p / record.bound
    ordered = sorted(indices, key=lambda index: share[index])
    chosen: dict[int, str] = {}
    for label, level in _ROWS:
        chosen.setdefault(ordered[round(level * (len(ordered) - 1))], label)
    return [(label, index) for index, label in chosen.items()]


def _draw_map(axes: Axes, problem: SearchProblem, grid: Grid, cells: np.ndarray[Any, Any]) -> None:
    """Draw the probability, dark where it is high, and the border of the area."""
    x0, y0, x1, y1 = grid.bounds
    # A single high cell, as rasters have at the last known position, must not pale all others,
    # and the upper half of the grey scale is left to the paths.
    ordered = np.sort(cells, axis=None)[::-1]
    darkest = 1.8 * ordered[np.searchsorted(np.cumsum(ordered), 0.05 * ordered.sum())]
    axes.imshow(
        cells, origin="lower", extent=(x0, x1, y0, y1), cmap="Greys", vmin=0.0, vmax=darkest
    )
    axes.add_patch(
        patch_from_polygon(problem.area.polygon, facecolor="none", edgecolor="#777777", lw=0.6)
    )
    margin = 2.0 * problem.swath_radius
    axes.set(
        xticks=[],
        yticks=[],
        xlim=(x0 - margin, x1 + margin),
        ylim=(y0 - margin, y1 + margin),
        aspect="equal",
    )
    axes.spines[:].set_visible(False)


def _draw_path(axes: Axes, problem: SearchProblem, record: RunRecord, look: Look) -> None:
    """Draw what the path sees, the path, the start, and the efficiency in the title."""
    waypoints = np.asarray(record.waypoints)
    path = shapely.LineString(waypoints) if len(waypoints) > 1 else shapely.Point(waypoints[0])
    seen = path.buffer(problem.swath_radius)
    axes.add_patch(patch_from_polygon(seen, facecolor=look.colour, alpha=0.5, linewidth=0))
    x0, y0, x1, y1 = problem.area.bounds
    swath_points = 2.0 * problem.swath_radius / max(x1 - x0, y1 - y0) * _PANEL_INCHES * 72.0
    axes.add_patch(
        PathPatch(
            OutlinePath(waypoints),
            facecolor="none",
            edgecolor=look.colour,
            linewidth=min(0.9, 0.3 * swath_points),
        )
    )
    axes.plot(*record.start, marker="o", markersize=4, markerfacecolor="white", mec="black")
    axes.set_title(f"$e_p$ {record.e_p:.3f} of {record.bound:.3f}", fontsize=8)
