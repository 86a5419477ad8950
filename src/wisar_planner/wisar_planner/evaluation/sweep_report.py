"""A sweep as Markdown and as figures."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from wisar_planner.evaluation.palette import looks
from wisar_planner.evaluation.sweep_statistics import SIZES

_LABELS = {
    "layers": "layers of the core",
    "width": "width of the core",
    "path_features": "features of the path",
    "parameters": "parameters of the policy network",
}
#: The p-values of the paper's regressions.
PAPER_P_VALUES = {"layers": 0.00522, "width": 0.00339, "path_features": 0.393}
_RESOLUTION = 160


def markdown(results: Mapping[str, Any]) -> str:
    """Return the tables of what `summarise` returned."""
    lines = ["| e_p on | slope | R² | p-value | paper's p-value | p-value, all three at once |"]
    lines.append("| --- | ---: | ---: | ---: | ---: | ---: |")
    for name in SIZES:
        fit = results["ols"][name]
        together = results["ols_together"].get(name, {}).get("p_value")
        cells = (fit["slope"], fit["r_squared"], fit["p_value"], PAPER_P_VALUES.get(name), together)
        lines.append(f"| {name} | " + " | ".join(_cell(each) for each in cells) + " |")
    names = list(results["extractors"])
    lines += ["", "| extractor | samples | mean e_p | median e_p |"]
    lines[-1] += "".join(f" p against {name} |" for name in names)
    lines.append("| --- |" + " ---: |" * (3 + len(names)))
    for name, spread in results["extractors"].items():
        p_values = results["extractor_p_values"][name]
        cells = (spread["mean"], spread["median"], *(p_values.get(each) for each in names))
        lines.append(
            f"| {name} | {spread['samples']} | " + " | ".join(_cell(each) for each in cells) + " |"
        )
    setup = results["setup"]
    caption = (
        f"Samples: {setup['samples']}; seed {setup['seed']}; {setup['base']['steps']:,} steps of "
        f"training each; e_p on {setup['base']['validation_maps']} maps at the end. Ordinary least "
        "squares with a constant, on each size alone; Welch's t-test between extractors."
    )
    return "\n".join([*lines, "", caption]) + "\n"


def save_figures(folder: Path, results: Mapping[str, Any]) -> list[Path]:
    """Draw every figure of a sweep into a folder; return the pictures."""
    folder.mkdir(parents=True, exist_ok=True)
    figures = {name: _draw_size(results, name) for name in SIZES}
    figures["path_extractor"] = _draw_extractors(results)
    figures["path_extractor_p_values"] = _draw_p_values(results)
    paths = []
    for name, figure in figures.items():
        path = folder / f"{name}.png"
        figure.savefig(path, dpi=_RESOLUTION)
        paths.append(path)
    return paths


def _draw_size(results: Mapping[str, Any], name: str) -> Figure:
    """Return e_p over a size, a mark per sample, and the fitted line."""
    figure, axes = _figure(_LABELS[name], "mean $e_p$ at the end")
    styles = looks(list(results["extractors"]))
    for (extractor, look), marker in zip(styles.items(), "osD^v", strict=False):
        chosen = [each for each in results["samples"] if each["path_extractor"] == extractor]
        axes.plot(
            [each[name] for each in chosen],
            [each["e_p"] for each in chosen],
            linestyle="none",
            marker=marker,
            color=look.colour,
            label=extractor,
        )
    fit = results["ols"][name]
    if fit["slope"] is not None:
        values = [each[name] for each in results["samples"]]
        ends = np.array([min(values), max(values)])
        label = "least squares" + ("" if fit["p_value"] is None else f", p = {fit['p_value']:.3g}")
        line = fit["intercept"] + fit["slope"] * ends
        axes.plot(ends, line, color="black", linewidth=1.2, label=label)
    axes.legend(frameon=False, fontsize=8)
    return figure


def _draw_extractors(results: Mapping[str, Any]) -> Figure:
    """Return box plots of e_p per extractor: quartiles, 5% and 95%."""
    figure, axes = _figure("", "mean $e_p$ at the end")
    styles = looks(list(results["extractors"]))
    values = [
        [each["e_p"] for each in results["samples"] if each["path_extractor"] == name]
        for name in styles
    ]
    drawn = axes.boxplot(values, whis=(5, 95), patch_artist=True, medianprops={"color": "black"})
    for box, look in zip(drawn["boxes"], styles.values(), strict=True):
        box.set(facecolor=look.colour, alpha=0.75)
    axes.set_xticks(range(1, len(styles) + 1), labels=list(styles))
    return figure


def _draw_p_values(results: Mapping[str, Any]) -> Figure:
    """Return the matrix of p-values between extractors."""
    names = list(results["extractors"])
    table = results["extractor_p_values"]
    values = np.array(
        [[np.nan if (p := table[a].get(b)) is None else p for b in names] for a in names]
    )
    figure, axes = _figure("", "")
    axes.grid(visible=False)
    axes.imshow(values, vmin=0.0, vmax=1.0, cmap="cividis")
    for (row, column), p in np.ndenumerate(values):
        text = "–" if np.isnan(p) else f"{p:.3g}"
        colour = "black" if np.isnan(p) or p > 0.5 else "white"
        axes.text(column, row, text, ha="center", va="center", color=colour)
    axes.set_xticks(range(len(names)), labels=names)
    axes.set_yticks(range(len(names)), labels=names)
    axes.set_title("p-value of Welch's t-test", fontsize=10)
    return figure


def _figure(x_label: str, y_label: str) -> tuple[Figure, Axes]:
    figure = Figure(figsize=(5.6, 3.8), layout="constrained")
    axes = figure.subplots()
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(color="#E6E6E6", linewidth=0.7)
    axes.set_axisbelow(True)
    axes.set_xlabel(x_label)
    axes.set_ylabel(y_label)
    return figure, axes


def _cell(value: float | None) -> str:
    return "–" if value is None else f"{value:.3g}"
