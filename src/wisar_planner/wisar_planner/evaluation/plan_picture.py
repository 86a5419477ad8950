"""Picture of a plan: the path on its map, and beside it the probability that it sees."""

from __future__ import annotations

import math
from collections.abc import Mapping
from os import PathLike
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize, PowerNorm
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.patheffects import Normal, Stroke
from shapely.plotting import patch_from_polygon

from wisar_planner.errors import FloatArray, InvalidInput
from wisar_planner.evaluation.palette import BOUND_COLOUR, looks
from wisar_planner.pdm import Grid
from wisar_planner.search import SearchPath, SearchProblem
from wisar_planner.search.bound import bound_holds, upper_bound

_CELLS = 320  # along the longer side of the map
_CURVE_POINTS = 200
_BOUND_POINTS = 24
_DISTANCE_COLOURS = "viridis"  # perceptually even, and readable without colour vision

Bounds = tuple[float, float, float, float]


def plan_picture(
    problem: SearchProblem,
    paths: Mapping[str, SearchPath],
    out_png: str | PathLike[str],
    *,
    title: str | None = None,
) -> None:
    """Draw paths on their map, and the probability that they see over the distance flown.

    A single path is coloured by the distance flown, in both panels alike; of several, each has
    the colour of its planner. Where the paths keep to a part of the area, the map shows this part,
    and a small one beside it where that lies.

    Parameters
    ----------
    problem : SearchProblem
        The map, the area and the start.
    paths : mapping of str to SearchPath
        What to draw, by the names for the legend; at least one.
    out_png : path-like
        The picture to write; another suffix gives another format.
    title : str, optional
        Line above the picture.

    Raises
    ------
    InvalidInput
        If there is no path.
    OSError
        If the picture cannot be written.
    """
    if not paths:
        raise InvalidInput("paths is empty: give at least one path to draw")
    figure = Figure(figsize=(12.0, 5.6), layout="constrained")
    chart, curves = figure.subplots(1, 2, width_ratios=(1.15, 1.0))
    view = _view(problem, paths)
    _draw_chart(chart, problem, paths, view)
    _draw_curves(curves, problem, paths)
    if view != _padded(problem.area.bounds):
        _draw_overview(curves, problem, view)
    if title:
        figure.suptitle(title, fontsize=12)
    figure.savefig(out_png, dpi=150)


def _draw_chart(
    axes: Axes, problem: SearchProblem, paths: Mapping[str, SearchPath], view: Bounds
) -> None:
    _draw_probability(axes, problem, view)
    styles = looks(list(paths))
    for name, path in paths.items():
        if len(path.waypoints) > 1:
            colour = "#31688E" if len(paths) == 1 else styles[name].colour
            swath = patch_from_polygon(path.seen_area(), facecolor=colour, alpha=0.22, linewidth=0)
            axes.add_patch(swath)
        _draw_line(axes, path.waypoints, path.distances, None if len(paths) == 1 else styles[name])
    axes.plot(
        *problem.start, "o", markersize=8, mfc="white", mec="black", mew=1.4, zorder=5,
        label="start",
    )  # fmt: skip
    axes.legend(loc="upper right", fontsize=9, framealpha=0.85)
    axes.set(xlim=view[::2], ylim=view[1::2], aspect="equal", xlabel="east, m", ylabel="north, m")
    axes.tick_params(labelsize=8)
    _draw_scale(axes, view)


def _draw_overview(axes: Axes, problem: SearchProblem, view: Bounds) -> None:
    """Show in a corner where in the whole area the map's part lies."""
    whole = _padded(problem.area.bounds)
    inset = axes.inset_axes((0.70, 0.05, 0.29, 0.33))
    _draw_probability(inset, problem, whole)
    x0, y0, x1, y1 = view
    frame = Rectangle((x0, y0), x1 - x0, y1 - y0, fill=False, edgecolor="#D55E00", linewidth=1.5)
    inset.add_patch(frame)
    inset.set(xlim=whole[::2], ylim=whole[1::2], xticks=[], yticks=[], aspect="equal")
    inset.set_title("where on the whole map", fontsize=8)


def _draw_probability(axes: Axes, problem: SearchProblem, view: Bounds) -> None:
    """Draw the probability, dark where it is high, and the border of the area."""
    x0, y0, x1, y1 = view
    grid = Grid.covering(view, max(x1 - x0, y1 - y0) / _CELLS)
    cells = problem.pdm.rasterize(grid)
    # The square root shows faint ground; the few highest cells do not set the scale alone.
    top = float(np.quantile(cells, 0.998)) or float(cells.max()) or 1.0
    left, bottom, right, up = grid.bounds
    axes.imshow(
        cells,
        origin="lower",
        extent=(left, right, bottom, up),
        cmap="Greys",
        norm=PowerNorm(0.5, vmin=0.0, vmax=1.7 * top, clip=True),
        interpolation="nearest",
    )
    border = patch_from_polygon(
        problem.area.polygon, facecolor="none", edgecolor="#555555", linewidth=1.0
    )
    axes.add_patch(border)


def _draw_line(axes: Axes, points: FloatArray, distances: FloatArray, look: Any) -> None:
    """Draw a line, coloured by distance where it has no look of its own."""
    if look is not None:
        axes.plot(*points.T, color=look.colour, linestyle=look.dash, linewidth=1.4, zorder=4)
        return
    line = LineCollection(
        list(np.stack((points[:-1], points[1:]), axis=1)),
        cmap=_DISTANCE_COLOURS,
        norm=Normalize(0.0, max(float(distances[-1]), 1e-9)),
        linewidth=2.0,
        zorder=4,
        capstyle="round",
        path_effects=[Stroke(linewidth=3.4, foreground="white"), Normal()],
    )
    line.set_array((distances[:-1] + distances[1:]) / 2.0)
    axes.add_collection(line)


def _draw_scale(axes: Axes, view: Bounds) -> None:
    """Draw a bar of a round length and an arrow to the north."""
    x0, y0, x1, y1 = view
    length = _round_down((x1 - x0) / 4.0)
    x, y = x0 + 0.04 * (x1 - x0), y0 + 0.04 * (y1 - y0)
    label = f"{length:g} m" if length < 1000 else f"{length / 1000:g} km"
    # White below black, to be read on any ground.
    for colour, width in (("white", 6.0), ("black", 3.0)):
        axes.plot((x, x + length), (y, y), color=colour, linewidth=width, solid_capstyle="butt")
    box = {"facecolor": "white", "alpha": 0.8, "linewidth": 0, "pad": 1.5}
    axes.text(
        x + length / 2, y + 0.02 * (y1 - y0), label, ha="center", va="bottom", fontsize=9, bbox=box
    )
    axes.annotate(
        "N",
        (0.955, 0.145),
        xytext=(0.955, 0.04),
        xycoords="axes fraction",
        ha="center",
        fontsize=10,
        arrowprops={"arrowstyle": "-|>", "color": "black"},
        bbox=box,
    )


def _draw_curves(axes: Axes, problem: SearchProblem, paths: Mapping[str, SearchPath]) -> None:
    reach = max(problem.max_distance, *(path.length for path in paths.values()))
    unit, name = (1000.0, "km") if reach >= 3000.0 else (1.0, "m")
    far = np.linspace(0.0, reach, _BOUND_POINTS)
    bound = problem.probability_in_area * np.array([upper_bound(problem, d) for d in far])
    axes.plot(
        far / unit,
        bound,
        "--",
        color=BOUND_COLOUR,
        label="no path in the area can see more (bound)",
    )
    styles = looks(list(paths))
    highest = float(bound[-1])
    for label, path in paths.items():
        distances = np.linspace(0.0, path.length, _CURVE_POINTS)
        seen = path.probability_over_distance(problem.pdm, distances)
        highest = max(highest, float(seen[-1]))  # a path that leaves the area may pass the bound
        points = np.column_stack((distances / unit, seen))
        _draw_line(axes, points, distances, None if len(paths) == 1 else styles[label])
        colour = "#31688E" if len(paths) == 1 else styles[label].colour
        text = f"{label}: {seen[-1]:.3f}"
        if bound_holds(problem, path):
            # Of the whole budget, as all tables have it, also where the path is shorter.
            whole = problem.probability_in_area * upper_bound(problem)
            text += f", {seen[-1] / whole:.1%} of the bound"
        axes.plot(*points[-1], "o", color=colour, markersize=5, label=text, zorder=5)
    axes.set(
        xlim=(0.0, 1.02 * reach / unit),
        ylim=(0.0, 1.08 * highest),
        xlabel=f"distance flown, {name}",
        ylabel="probability that the person has been seen",
    )
    axes.grid(alpha=0.25)
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(loc="upper left", fontsize=9, frameon=False)


def _view(problem: SearchProblem, paths: Mapping[str, SearchPath]) -> Bounds:
    """Return the part of the ground to show: that of the paths, unless most of the area is."""
    points = np.vstack([problem.start, *(path.waypoints for path in paths.values())])
    low, high = points.min(axis=0), points.max(axis=0)
    side = max(float((high - low).max()) * 1.3, 12.0 * problem.swath_radius)
    x0, y0, x1, y1 = whole = _padded(problem.area.bounds)
    if side > 0.6 * max(x1 - x0, y1 - y0):
        return whole
    x, y = (low + high) / 2.0
    return (x - side / 2, y - side / 2, x + side / 2, y + side / 2)


def _padded(bounds: Bounds) -> Bounds:
    x0, y0, x1, y1 = bounds
    margin = 0.02 * max(x1 - x0, y1 - y0)
    return (x0 - margin, y0 - margin, x1 + margin, y1 + margin)


def _round_down(length: float) -> float:
    """Return the largest of 1, 2 and 5 times a power of ten that is not above a length."""
    power = 10.0 ** math.floor(math.log10(length))
    return max(digit * power for digit in (1.0, 2.0, 5.0) if digit * power <= length * (1 + 1e-9))
