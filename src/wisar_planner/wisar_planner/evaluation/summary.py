"""From run records to the numbers that are reported, with confidence intervals."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import combinations
from typing import Any

import numpy as np

from wisar_planner.evaluation.run import CURVE_STEPS, FIND_BINS, RunRecord
from wisar_planner.evaluation.runner import Evaluation
from wisar_planner.evaluation.statistics import (
    Estimate,
    bootstrap_ratio,
    exceedance,
    histogram_quantiles,
    pooled_standard_deviation,
    standard_deviation,
)
from wisar_planner.search.path import walking_distances

#: Confidence of every interval that is reported.
CONFIDENCE = 0.95

#: Efficiencies at which the performance profile is given.
PROFILE_THRESHOLDS = np.linspace(0.0, 1.0, 201)

_QUANTILES = {"p05": 0.05, "p25": 0.25, "p50": 0.5, "p75": 0.75, "p95": 0.95}


def summarise(evaluation: Evaluation, records: Sequence[RunRecord]) -> dict[str, Any]:
    """Return the results of an evaluation, ready for JSON.

    Parameters
    ----------
    evaluation : Evaluation
        What was run.
    records : sequence of RunRecord
        Its runs.

    Returns
    -------
    dict
        ``setup``; ``planners`` with one entry per planner; ``upper_bound``; ``comparisons`` of
        each pair of planners map by map; ``distances_m`` and ``thresholds``, the abscissae of
        the curves and performance profiles. Values that do not exist (the spread of one run, the
        distance to find of nobody) are None.
    """
    groups = {
        spec.name: [record for record in records if record.planner == spec.name]
        for spec in evaluation.planners
    }
    distance = evaluation.scenario.drone.max_distance
    bounds = next(iter(groups.values()))
    result = {
        "setup": {
            "runs": evaluation.runs,
            "confidence": CONFIDENCE,
            **evaluation.common_setup(),
            "planners": {spec.name: spec.identity() for spec in evaluation.planners},
        },
        "planners": {name: _planner_summary(runs, distance) for name, runs in groups.items()},
        "upper_bound": {
            **_with_interval("e_p_mean", bootstrap_ratio([r.bound for r in bounds])),
            "e_p_std": standard_deviation([r.bound for r in bounds]),
        },
        "comparisons": [
            _comparison(a, b, groups[a], groups[b]) for a, b in combinations(groups, 2)
        ],
        "distances_m": walking_distances(distance, CURVE_STEPS).tolist(),
        "thresholds": PROFILE_THRESHOLDS.tolist(),
    }
    plain: dict[str, Any] = _json_ready(result)
    return plain


def _planner_summary(runs: Sequence[RunRecord], distance: float) -> dict[str, Any]:
    """Return the numbers of one planner."""
    e_p = np.array([r.e_p for r in runs])
    p_d = np.array([r.p_d for r in runs])
    bound = np.array([r.bound for r in runs])
    found = np.array([r.found for r in runs], dtype=np.float64)
    persons = np.array([r.persons for r in runs], dtype=np.float64)
    find_total = np.array([r.find_total for r in runs])
    seconds = np.array([r.seconds for r in runs])
    edges = np.arange(FIND_BINS + 1) / FIND_BINS * distance
    find_counts = np.sum([r.find_counts for r in runs], axis=0)
    # With those who are not found at the whole budget, a planner cannot look fast by finding only
    # the near ones (the restricted mean of survival analysis).
    flown = find_total + (persons - found) * distance
    quantiles = histogram_quantiles(find_counts, edges, list(_QUANTILES.values()))
    return {
        "runs": len(runs),
        **_with_interval("e_p_mean", bootstrap_ratio(e_p)),
        "e_p_std": standard_deviation(e_p),
        "e_p_median": float(np.median(e_p)),
        **_with_interval("p_d_mean", bootstrap_ratio(p_d)),
        "p_d_std": standard_deviation(p_d),
        **_with_interval("found_pct", bootstrap_ratio(100.0 * found, persons)),
        **_with_interval("dtf_mean_m", bootstrap_ratio(find_total, found)),
        "dtf_std_m": pooled_standard_deviation(
            found.sum(), find_total.sum(), sum(r.find_squares for r in runs)
        ),
        **_with_interval("flown_per_person_m", bootstrap_ratio(flown, persons)),
        "dtf_quantiles_m": dict(zip(_QUANTILES, quantiles.tolist(), strict=True)),
        "seconds_per_plan": float(seconds.mean()),
        "seconds_per_plan_p95": float(np.quantile(seconds, 0.95)),
        **_with_interval("share_of_bound", bootstrap_ratio(e_p, bound)),
        "length_mean_m": float(np.mean([r.length for r in runs])),
        "transit_mean_m": float(np.mean([r.transit for r in runs])),
        "first_point_from_start_mean_m": float(np.mean([r.offset for r in runs])),
        "curve": _band(bootstrap_ratio([r.curve for r in runs])),
        "performance_profile": _band(bootstrap_ratio(exceedance(e_p, PROFILE_THRESHOLDS))),
    }


def _comparison(
    a: str, b: str, runs_a: Sequence[RunRecord], runs_b: Sequence[RunRecord]
) -> dict[str, Any]:
    """Return how two planners differ on the same maps."""
    difference = np.array([x.e_p - y.e_p for x, y in zip(runs_a, runs_b, strict=True)])
    # A tie counts half, so that the two shares of a pair sum to 1.
    wins = np.where(difference == 0.0, 0.5, difference > 0.0)
    return {
        "planner": a,
        "other": b,
        **_with_interval("e_p_difference_mean", bootstrap_ratio(difference)),
        **_with_interval("share_of_maps_better", bootstrap_ratio(wins)),
    }


def _with_interval(name: str, estimate: Estimate) -> dict[str, Any]:
    """Return an estimate under its name, and its interval beside it."""
    return {
        name: float(estimate.value),
        f"{name}_ci": [float(estimate.low), float(estimate.high)],
    }


def _band(estimate: Estimate) -> dict[str, Any]:
    """Return a curve with its confidence band."""
    return {
        "mean": estimate.value.tolist(),
        "low": estimate.low.tolist(),
        "high": estimate.high.tolist(),
    }


def _json_ready(value: Any) -> Any:
    """Replace what JSON cannot say, NaN, by None."""
    if isinstance(value, dict):
        return {key: _json_ready(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_json_ready(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
