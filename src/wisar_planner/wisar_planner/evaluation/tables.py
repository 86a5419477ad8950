"""The table of results, for Markdown and for the terminal."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from wisar_planner.evaluation.paper_results import PAPER_RESULTS
from wisar_planner.evaluation.scenario import RandomMaps

# Mean efficiencies that differ by less are level.
_LEVEL = 1e-9

HEADERS = (
    "planner",
    "p_D",
    "e_p at D",
    "95% interval",
    "of bound",
    "found %",
    "distance to find, m",
    "flown per person, m",
    "s per plan",
    "begins",
)


def table_rows(results: Mapping[str, Any]) -> Iterator[tuple[str, ...]]:
    """Yield the rows under `HEADERS`, the paper's line after ours where it has one.

    Parameters
    ----------
    results : Mapping
        What `summarise` returned.
    """
    compare = is_paper_setup(results["setup"])
    for name, planner in results["planners"].items():
        yield (
            name,
            _with_spread(planner["p_d_mean"], planner["p_d_std"], 3),
            _with_spread(planner["e_p_mean"], planner["e_p_std"], 3),
            _interval(planner["e_p_mean_ci"], 4),
            f"{100.0 * planner['share_of_bound']:.1f}%",
            f"{planner['found_pct']:.2f}",
            _with_spread(planner["dtf_mean_m"], planner["dtf_std_m"], 1),
            f"{planner['flown_per_person_m']:.1f}",
            _seconds(planner["seconds_per_plan"]),
            _begins(planner),
        )
        if compare and name in PAPER_RESULTS:
            paper = PAPER_RESULTS[name]
            yield (
                f"paper's {paper.method}",
                _with_spread(paper.p_d, paper.p_d_std, 2),
                _with_spread(paper.e_p, paper.e_p_std, 2),
                "",
                "",
                f"{paper.found_pct:.2f}",
                _with_spread(paper.dtf_m, paper.dtf_std_m, 1),
                f"{paper.flown_per_person_m(results['setup']['max_distance_m']):.1f}",
                "",
                "",
            )
    bound = results["upper_bound"]
    yield (
        "upper bound",
        "",
        _with_spread(bound["e_p_mean"], bound["e_p_std"], 3),
        _interval(bound["e_p_mean_ci"], 4),
        *("",) * 6,
    )


def markdown(results: Mapping[str, Any]) -> str:
    """Return the table and what it was measured on as Markdown."""
    lines = [
        "| " + " | ".join(HEADERS) + " |",
        "| --- |" + " ---: |" * (len(HEADERS) - 2) + " --- |",
        *("| " + " | ".join(row) + " |" for row in table_rows(results)),
    ]
    text = "\n".join(lines) + "\n\n" + caption(results) + "\n"
    return text + "\n" + best_markdown(results) if len(results["planners"]) > 1 else text


def best_markdown(results: Mapping[str, Any]) -> str:
    """Return how far the best planner is ahead of each other one, map by map, as Markdown.

    The interval of a difference on the same maps says whether one planner is better than another;
    the spread over maps, which differ far more than planners, does not.

    Parameters
    ----------
    results : Mapping
        What `summarise` returned, of two planners or more.
    """
    planners = results["planners"]
    best = max(planners, key=lambda name: float(planners[name]["e_p_mean"]))
    lines = [
        f"{best} against the others, on the same maps:",
        "",
        "| other | sees more, e_p | 95% interval | better on | other ahead until, m | by up to |",
        "| --- | ---: | ---: | ---: | ---: | ---: |",
    ]
    for pair in results["comparisons"]:
        if best not in (pair["planner"], pair["other"]):
            continue
        difference, (low, high) = pair["e_p_difference_mean"], pair["e_p_difference_mean_ci"]
        wins, other = pair["share_of_maps_better"], pair["other"]
        if other == best:
            other, wins = pair["planner"], 1.0 - wins
            difference, low, high = (
                None if each is None else -each for each in (difference, high, low)
            )
        lead = np.subtract(planners[other]["curve"]["mean"], planners[best]["curve"]["mean"])
        ahead = np.flatnonzero(lead > _LEVEL)
        cells = (
            other,
            f"{difference:.4f}",
            _interval((low, high), 4),
            f"{100.0 * wins:.0f}% of maps",
            f"{results['distances_m'][ahead[-1]]:.0f}" if len(ahead) else "–",
            f"{lead.max():.4f}" if len(ahead) else "–",
        )
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def caption(results: Mapping[str, Any]) -> str:
    """Return in words what the table was measured on."""
    setup = results["setup"]
    return (
        f"Runs: {setup['runs']}; seed {setup['seed']}; maps: {setup['maps']}, the same maps and "
        f"starts for all planners; start: {setup['start']}; {setup['max_distance_m']:g} m in "
        f"steps of {setup['step_length_m']:g} m, swath radius {setup['swath_radius_m']:g} m; "
        f"{setup['persons']} persons per run, drawn inside the area. p_D and e_p count what the "
        "swath sees beyond the border of the area too, so that the share of persons found may be "
        "smaller. Flown per person: until the person is found or the budget is spent. ± is the "
        "standard deviation, over runs or over found persons; intervals are BCa bootstrap over "
        "runs. A leg from the start, where a planner flies one, counts as part of the path."
    )


def is_paper_setup(setup: Mapping[str, Any]) -> bool:
    """Tell whether results were measured on the paper's setup."""
    return all(setup.get(key) == value for key, value in RandomMaps().description().items())


def _begins(planner: Mapping[str, Any]) -> str:
    """Say how the paths begin, which decides whether two planners can be compared."""
    if planner["transit_mean_m"] > 0.0:
        return f"start, leg of {planner['transit_mean_m']:.0f} m"
    if planner["first_point_from_start_mean_m"] > 1e-6:
        return "own first point"
    return "start"


def _with_spread(value: float | None, spread: float | None, digits: int) -> str:
    if value is None:
        return "–"
    return f"{value:.{digits}f}" + ("" if spread is None else f" ± {spread:.{digits}f}")


def _interval(ends: tuple[float | None, float | None], digits: int) -> str:
    low, high = ends
    return "–" if low is None or high is None else f"{low:.{digits}f} to {high:.{digits}f}"


def _seconds(value: float) -> str:
    return f"{value:.2g}" if value < 10.0 else f"{value:.0f}"
