"""Figures of an evaluation: curves, performance profile, spread, distance to find."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from wisar_planner.evaluation.gallery import draw_gallery
from wisar_planner.evaluation.palette import BOUND_COLOUR, Look, looks
from wisar_planner.evaluation.paper_results import PAPER_RESULTS
from wisar_planner.evaluation.run import RunRecord
from wisar_planner.evaluation.scenario import Scenario
from wisar_planner.evaluation.tables import is_paper_setup

_SIZE = (6.4, 4.2)
_RESOLUTION = 160


def save_figures(
    folder: Path,
    results: Mapping[str, Any],
    records: Sequence[RunRecord],
    scenario: Scenario,
) -> list[Path]:
    """Draw every figure of an evaluation into a folder.

    Parameters
    ----------
    folder : Path
        Where the pictures go; made if missing.
    results : Mapping
        What `summarise` returned.
    records : sequence of RunRecord
        The runs that it was made from.
    scenario : Scenario
        Where the maps come from, for the gallery.

    Returns
    -------
    list of Path
        The pictures.
    """
    folder.mkdir(parents=True, exist_ok=True)
    styles = looks(list(results["planners"]))
    drawings: dict[str, Callable[[], Figure]] = {
        "efficiency_over_distance": lambda: draw_curves(results, styles),
        "performance_profile": lambda: draw_profile(results, styles),
        "efficiency_box": lambda: draw_boxes(results, records, styles),
        "distance_to_find": lambda: draw_distance_to_find(results, styles),
        "gallery": lambda: draw_gallery(results, records, scenario, styles),
    }
    paths = []
    for name, draw in drawings.items():
        path = folder / f"{name}.png"
        draw().savefig(path, dpi=_RESOLUTION)
        paths.append(path)
    return paths


def draw_curves(results: Mapping[str, Any], styles: Mapping[str, Look]) -> Figure:
    """Return the mean probability efficiency over the distance flown, with 95% bands."""
    figure, axes = _figure("distance flown, m", "mean probability efficiency $e_p$ (95% band)")
    distances = results["distances_m"]
    for name in _best_first(results):
        _line(axes, distances, results["planners"][name]["curve"], styles[name], name)
    bound = results["upper_bound"]["e_p_mean"]
    axes.plot(distances[-1], bound, marker="_", markersize=12, color=BOUND_COLOUR, clip_on=False)
    axes.annotate(
        f"no path can beat {bound:.3f}",
        (distances[-1], bound),
        xytext=(-9, 0),
        textcoords="offset points",
        ha="right",
        va="center",
        color="#666666",
        fontsize=8,
    )
    axes.set_xlim(0.0, distances[-1])
    axes.set_ylim(0.0, None)
    axes.legend(frameon=False, loc="upper left")
    return figure


def draw_profile(results: Mapping[str, Any], styles: Mapping[str, Look]) -> Figure:
    """Return the share of runs whose efficiency exceeds each threshold, with 95% bands."""
    figure, axes = _figure("threshold of $e_p$ at the end", "share of runs above it (95% band)")
    thresholds = results["thresholds"]
    last = 0.0
    beyond = np.append(thresholds, thresholds[-1])
    for name in _best_first(results):
        profile = results["planners"][name]["performance_profile"]
        _line(axes, thresholds, profile, styles[name], name)
        # The first threshold that no run passes; all of them where some run passes the last.
        last = max(last, beyond[np.argmin(np.append(profile["mean"], 0.0) > 0.0)])
    axes.set_xlim(0.0, last or thresholds[-1])
    axes.set_ylim(0.0, 1.0)
    axes.yaxis.set_major_formatter(_percent)
    axes.legend(frameon=False, loc="upper right")
    return figure


def draw_boxes(
    results: Mapping[str, Any], records: Sequence[RunRecord], styles: Mapping[str, Look]
) -> Figure:
    """Return box plots of the efficiency at the end: quartiles, 5% and 95%, the rest as dots."""
    names = _best_first(results)[::-1]
    figure, axes = _figure(
        "$e_p$ at the end (5, 25, 50, 75, 95% of the runs)", "", height=0.9 + 0.5 * len(names)
    )
    values = {name: [r.e_p for r in records if r.planner == name] for name in names}
    drawn = axes.boxplot(
        list(values.values()),
        orientation="horizontal",
        whis=(5, 95),
        widths=0.55,
        patch_artist=True,
        medianprops={"color": "black", "linewidth": 1.4},
        flierprops={"marker": ".", "markersize": 2.5, "alpha": 0.5},
    )
    for name, box, flier in zip(names, drawn["boxes"], drawn["fliers"], strict=True):
        box.set(facecolor=styles[name].colour, alpha=0.75, edgecolor="black", linewidth=0.8)
        flier.set(markeredgecolor=styles[name].colour)
    if is_paper_setup(results["setup"]):
        _mark_papers_means(axes, names)
    _categories(axes, names)
    axes.set_xlim(0.0, None)
    return figure


def draw_distance_to_find(results: Mapping[str, Any], styles: Mapping[str, Look]) -> Figure:
    """Return the spread of the distance to find, and beside it the share of persons found."""
    names = _best_first(results)[::-1]
    figure = Figure(figsize=(7.6, 1.1 + 0.5 * len(names)), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True, width_ratios=(3, 2))
    for row, name in enumerate(names, start=1):
        planner = results["planners"][name]
        _find_box(left, row, planner, styles[name])
        _found_bar(right, row, planner, styles[name])
    for axes, label in (
        (left, "distance to find, m (5, 25, 50, 75, 95%; ◇ mean)"),
        (right, "persons found, % (95% interval)"),
    ):
        _plain_axes(axes)
        axes.set_xlabel(label)
        axes.grid(axis="y", visible=False)
    left.set_xlim(0.0, results["distances_m"][-1])
    right.set_xlim(0.0, None)
    right.margins(x=0.15)
    _categories(left, names)
    right.tick_params(axis="y", length=0)
    return figure


def _mark_papers_means(axes: Axes, names: Sequence[str]) -> None:
    """Mark what the paper reports for the same methods."""
    rows = [(row, name) for row, name in enumerate(names, start=1) if name in PAPER_RESULTS]
    if rows:
        axes.plot(
            [PAPER_RESULTS[name].e_p for _, name in rows],
            [row for row, _ in rows],
            linestyle="none",
            marker="D",
            markersize=6,
            markerfacecolor="white",
            markeredgecolor="black",
            label="mean in the paper",
            zorder=5,
        )
        axes.legend(frameon=False, loc="lower right")


def _find_box(axes: Axes, row: int, planner: Mapping[str, Any], look: Look) -> None:
    """Draw quantiles as a box; there are none where nobody was found."""
    quantiles = planner["dtf_quantiles_m"]
    if quantiles["p50"] is None:
        axes.text(0.0, row, " nobody found", va="center", fontsize=8)
        return
    box = {
        "whislo": quantiles["p05"],
        "q1": quantiles["p25"],
        "med": quantiles["p50"],
        "q3": quantiles["p75"],
        "whishi": quantiles["p95"],
        "mean": planner["dtf_mean_m"],
    }
    drawn = axes.bxp(
        [box],
        positions=[row],
        orientation="horizontal",
        widths=0.55,
        showfliers=False,
        showmeans=True,
        patch_artist=True,
        medianprops={"color": "black", "linewidth": 1.4},
        meanprops={"marker": "D", "markersize": 4, "markerfacecolor": "white", "mec": "black"},
    )
    drawn["boxes"][0].set(facecolor=look.colour, alpha=0.75, edgecolor="black", linewidth=0.8)


def _found_bar(axes: Axes, row: int, planner: Mapping[str, Any], look: Look) -> None:
    """Draw the share of persons found with its interval and its value."""
    found = planner["found_pct"]
    axes.barh(row, found, height=0.55, color=look.colour, alpha=0.75)
    low, high = planner["found_pct_ci"]
    if low is not None:
        axes.plot([low, high], [row, row], color="black", linewidth=1.4)
    axes.annotate(
        f"{found:.1f}",
        (high if high is not None else found, row),
        xytext=(5, 0),
        textcoords="offset points",
        va="center",
        fontsize=8,
    )


def _line(axes: Axes, x: Sequence[float], band: Mapping[str, Any], look: Look, label: str) -> None:
    """Draw a mean with its confidence band."""
    axes.plot(x, band["mean"], color=look.colour, linestyle=look.dash, linewidth=1.6, label=label)
    if band["low"][0] is not None:
        axes.fill_between(x, band["low"], band["high"], color=look.colour, alpha=0.2, linewidth=0)


def _figure(x_label: str, y_label: str, height: float = _SIZE[1]) -> tuple[Figure, Axes]:
    """Return an empty figure in the common look."""
    figure = Figure(figsize=(_SIZE[0], height), layout="constrained")
    axes = figure.subplots()
    _plain_axes(axes)
    axes.set_xlabel(x_label)
    axes.set_ylabel(y_label)
    return figure, axes


def _plain_axes(axes: Axes) -> None:
    """Leave out what carries no information."""
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(color="#E6E6E6", linewidth=0.7)
    axes.set_axisbelow(True)


def _categories(axes: Axes, names: Sequence[str]) -> None:
    """Name the rows of a horizontal plot."""
    axes.set_yticks(range(1, len(names) + 1), labels=list(names))
    axes.tick_params(axis="y", length=0)
    axes.grid(axis="y", visible=False)
    axes.set_ylim(0.4, len(names) + 0.6)


def _best_first(results: Mapping[str, Any]) -> list[str]:
    """Return the planners by mean efficiency, so that legends read like the lines."""
    planners = results["planners"]
    return sorted(planners, key=lambda name: -planners[name]["e_p_mean"])


def _percent(value: float, _position: float) -> str:
    return f"{100.0 * value:.0f}%"
