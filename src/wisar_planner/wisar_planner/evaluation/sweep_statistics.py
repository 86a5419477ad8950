"""What a sweep says: regressions over the sizes, and which extractors differ."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import statsmodels.api as sm  # type: ignore[import-untyped]
from scipy import stats

from wisar_planner.errors import FloatArray
from wisar_planner.evaluation.sweep import Sweep, SweepRecord

#: What e_p is regressed on; the last one follows from the others.
SIZES = ("layers", "width", "path_features", "parameters")


def summarise(sweep: Sweep, records: Sequence[SweepRecord]) -> dict[str, Any]:
    """Return the results of a sweep, ready for JSON; what cannot be estimated is None.

    Parameters
    ----------
    sweep : Sweep
        What was run.
    records : sequence of SweepRecord
        Its samples.

    Returns
    -------
    dict
        `setup`; `samples`; `ols`, per size the regression of e_p on it alone, as in the paper;
        `ols_together`, the regression on the first three at once; `extractors`, the spread of
        each; `extractor_p_values`, of Welch's t-test between each two (the paper names no test).
    """
    e_p = np.array([each.e_p for each in records])
    columns = {name: np.array([float(getattr(r, name)) for r in records]) for name in SIZES}
    groups = {
        name: e_p[[each.path_extractor == name for each in records]]
        for name in sweep.path_extractors
    }
    return {
        "setup": {"samples": len(records), **sweep.common_setup()},
        "ols": {name: _regression(x[:, None], e_p, [name])[name] for name, x in columns.items()},
        "ols_together": _regression(
            np.column_stack([columns[name] for name in SIZES[:3]]), e_p, list(SIZES[:3])
        ),
        "extractors": {name: _spread(values) for name, values in groups.items()},
        "extractor_p_values": {
            one: {other: _welch(groups[one], groups[other]) for other in groups if other != one}
            for one in groups
        },
        "samples": [vars(each) for each in records],
    }


def _regression(x: FloatArray, y: FloatArray, names: list[str]) -> dict[str, Any]:
    """Return slope, p-value and more of each column of a least-squares fit with a constant."""
    design = np.column_stack([np.ones(len(x)), x])
    # Fewer samples than unknowns, or columns that do not vary independently, tell nothing.
    if len(y) <= design.shape[1] or np.linalg.matrix_rank(design) < design.shape[1]:
        nothing = dict.fromkeys(("slope", "intercept", "p_value", "r_squared"))
        return {name: dict(nothing) for name in names}
    fit = sm.OLS(y, design).fit()
    return {
        name: {
            "slope": _number(fit.params[column]),
            "intercept": _number(fit.params[0]),
            "p_value": _number(fit.pvalues[column]),
            "r_squared": _number(fit.rsquared),
        }
        for column, name in enumerate(names, start=1)
    }


def _welch(one: FloatArray, other: FloatArray) -> float | None:
    """Return the p-value of Welch's t-test, None where it says nothing."""
    if min(len(one), len(other)) < 2 or one.std() + other.std() == 0.0:
        return None
    return _number(stats.ttest_ind(one, other, equal_var=False).pvalue)


def _spread(values: FloatArray) -> dict[str, Any]:
    if len(values) == 0:
        return {"samples": 0, "mean": None, "median": None, "std": None}
    return {
        "samples": len(values),
        "mean": float(values.mean()),
        "median": float(np.median(values)),
        "std": float(values.std(ddof=1)) if len(values) > 1 else None,
    }


def _number(value: Any) -> float | None:
    return float(value) if math.isfinite(value) else None
