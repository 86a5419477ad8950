"""Planners in several worlds: the numbers of each, and one table of all."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations
from typing import Any

import joblib
import numpy as np

from wisar_planner.evaluation.run import RunRecord
from wisar_planner.evaluation.runner import Evaluation
from wisar_planner.evaluation.scenario import Scenario
from wisar_planner.evaluation.statistics import estimate_of
from wisar_planner.search import reachable_bound


def summarise_world(
    evaluation: Evaluation, records: Sequence[RunRecord], *, jobs: int = -1
) -> dict[str, Any]:
    """Return the numbers of one world, ready for JSON.

    Parameters
    ----------
    evaluation : Evaluation
        What was run there.
    records : sequence of RunRecord
        Its runs.
    jobs : int
        Processes; -1 for one per core.

    Returns
    -------
    dict
        ``setup``, ``steps`` of the budget, ``upper_bound`` and ``reachable_bound``, and
        ``planners``: ``e_p_mean``, ``share_of_bound``, ``share_of_reachable_bound`` (None for a
        planner that does not begin at the start), each with its interval ``_ci``, and
        ``seconds_per_plan``; and ``comparisons`` of each pair of planners map by map:
        ``planner``, ``other``, ``share_difference`` and its interval.
    """
    drone = evaluation.scenario.drone
    reachable = joblib.Parallel(n_jobs=jobs)(
        joblib.delayed(_reachable)(evaluation.scenario, evaluation.seed, index)
        for index in range(evaluation.runs)
    )
    groups = {
        spec.name: [record for record in records if record.planner == spec.name]
        for spec in evaluation.planners
    }
    bounds = [record.bound for record in next(iter(groups.values()))]
    return {
        "setup": evaluation.scenario.description(),
        "steps": math.floor(drone.max_distance / drone.step_length + 1e-9),
        "upper_bound": estimate_of("e_p_mean", bounds),
        "reachable_bound": estimate_of("e_p_mean", reachable),
        "planners": {name: _planner(runs, reachable) for name, runs in groups.items()},
        "comparisons": [
            {
                "planner": first,
                "other": second,
                **estimate_of(
                    "share_difference",
                    [a.e_p - b.e_p for a, b in zip(groups[first], groups[second], strict=True)],
                    bounds,
                ),
            }
            for first, second in combinations(groups, 2)
        ],
    }


def worlds_markdown(results: Mapping[str, Any]) -> str:
    """Return a Markdown table with a row a world and a column a planner.

    Parameters
    ----------
    results : Mapping
        ``setup``, with ``planners``, ``runs`` and ``seed``, and ``worlds``: for each name what
        `summarise_world` returned, or ``skipped`` with the reason.
    """
    names = list(results["setup"]["planners"])
    heads = ["world", "steps", "upper bound", "reachable bound", *names, "s per plan"]
    lines = [
        "| " + " | ".join(heads) + " |",
        "| --- |" + " ---: |" * (len(heads) - 1),
    ]
    for title, world in results["worlds"].items():
        if "skipped" in world:
            lines.append(f"| {title} | {world['skipped']} |" + " |" * (len(heads) - 2))
            continue
        planners = [world["planners"][name] for name in names]
        cells = [
            title,
            str(world["steps"]),
            f"{world['upper_bound']['e_p_mean']:.3f}",
            f"{world['reachable_bound']['e_p_mean']:.3f}",
            *(f"{100.0 * planner['share_of_bound']:.1f}%" for planner in planners),
            ", ".join(f"{planner['seconds_per_plan']:.2g}" for planner in planners),
        ]
        lines.append("| " + " | ".join(cells) + " |")
    setup = results["setup"]
    caption = (
        f"Runs: {setup['runs']} a world; seed {setup['seed']}. Planners: what they see as a "
        "share of the upper bound, sums over runs. The reachable bound holds for paths from the "
        "start. Time: seconds per plan, planner by planner."
    )
    return "\n\n".join(["\n".join(lines), caption, *_ahead(results)]) + "\n"


def _ahead(results: Mapping[str, Any]) -> Iterator[str]:
    """Yield in how many worlds the last planner is ahead of another one, by more than chance."""
    worlds = [world for world in results["worlds"].values() if "skipped" not in world]
    last = list(results["setup"]["planners"])[-1]
    for pairs in zip(*(world["comparisons"] for world in worlds), strict=True):
        if pairs[0]["other"] == last:
            ends = [pair["share_difference_ci"] for pair in pairs]
            known = [(low, high) for low, high in ends if None not in (low, high)]
            yield (
                f"{last} against {pairs[0]['planner']}, on the same maps, by more than chance "
                f"(95%): ahead in {sum(high < 0.0 for _, high in known)} of {len(worlds)} worlds, "
                f"behind in {sum(low > 0.0 for low, _ in known)}."
            )


def _reachable(scenario: Scenario, seed: int, index: int) -> float:
    return reachable_bound(scenario.problem(seed, index))


def _planner(runs: Sequence[RunRecord], reachable: Sequence[float]) -> dict[str, Any]:
    e_p = [run.e_p for run in runs]
    of_reachable = estimate_of("share_of_reachable_bound", e_p, reachable)
    if any(run.offset > 1e-6 for run in runs):
        of_reachable = dict.fromkeys(of_reachable)
    return {
        "runs": len(runs),
        **estimate_of("e_p_mean", e_p),
        **estimate_of("share_of_bound", e_p, [run.bound for run in runs]),
        **of_reachable,
        "seconds_per_plan": float(np.mean([run.seconds for run in runs])),
    }
