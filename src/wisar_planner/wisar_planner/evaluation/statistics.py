"""Estimates over runs, with bootstrap confidence intervals.

One run, that is one map, is the unit of resampling: the persons of one map and the
distances along one path are not independent of each other. Every figure in the
tables is a ratio of two sums over runs (a mean is one whose denominators are 1), so
one vectorised bootstrap serves them all.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import special

from wisar_planner.errors import InvalidInput

Array = NDArray[np.float64]

#: Elements of the resampling matrix that are held at once (64 MB of float64).
_BATCH_ELEMENTS = 8_000_000


@dataclass(frozen=True)
class Estimate:
    """A value with its confidence interval; arrays of one shape, or floats.

    Attributes
    ----------
    value
        The point estimate.
    low, high
        Ends of the interval; NaN where one run cannot give one.
    """

    value: Array
    low: Array
    high: Array


def bootstrap_ratio(
    numerators: ArrayLike,
    denominators: ArrayLike | None = None,
    *,
    confidence: float = 0.95,
    resamples: int = 2000,
    seed: int = 0,
) -> Estimate:
    """Return ratios of sums over runs with bias-corrected, accelerated intervals.

    The interval is the BCa bootstrap of Efron (1987), "Better bootstrap confidence
    intervals", JASA 82(397). The runs are resampled once for all columns, so that
    columns stay comparable.

    Parameters
    ----------
    numerators
        One row per run, any trailing shape, `(n, ...)`.
    denominators
        The same shape, or None for a mean.
    confidence
        Probability that the interval is to cover, between 0 and 1.
    resamples
        Number of bootstrap samples.
    seed
        Seed of the resampling; the same for all columns.

    Raises
    ------
    InvalidInput
        If there are no runs, shapes differ, or `confidence` is not in (0, 1).
    """
    top = np.asarray(numerators, dtype=np.float64)
    bottom = np.ones_like(top) if denominators is None else np.asarray(denominators, np.float64)
    if top.ndim == 0 or len(top) == 0:
        raise InvalidInput("numerators: there is no run to make an estimate from")
    if bottom.shape != top.shape:
        raise InvalidInput(f"denominators: shape {bottom.shape} differs from {top.shape}")
    if not 0.0 < confidence < 1.0:
        raise InvalidInput(f"confidence: {confidence} is not between 0 and 1")
    shape = top.shape[1:]
    top, bottom = top.reshape(len(top), -1), bottom.reshape(len(top), -1)
    value = _ratio(top.sum(axis=0), bottom.sum(axis=0))
    if len(top) == 1:
        low = high = np.full_like(value, np.nan)
    else:
        samples = np.concatenate(
            [
                _ratio(counts @ top, counts @ bottom)
                for counts in _resampling_counts(len(top), resamples, seed)
            ]
        )
        low, high = _bca_interval(samples, value, _acceleration(top, bottom), confidence)
    return Estimate(value.reshape(shape), low.reshape(shape), high.reshape(shape))


def estimate_of(
    name: str, numerators: ArrayLike, denominators: ArrayLike | None = None
) -> dict[str, Any]:
    """Return a ratio of sums over runs, one number, under its name and its interval beside it.

    The interval is called ``NAME_ci``; its ends are None where one run cannot give one, so that
    all is ready for JSON.
    """
    estimate = bootstrap_ratio(numerators, denominators)
    ends = (float(estimate.low), float(estimate.high))
    return {
        name: float(estimate.value),
        f"{name}_ci": [end if np.isfinite(end) else None for end in ends],
    }


def standard_deviation(values: ArrayLike) -> float:
    """Return the sample standard deviation (divisor n - 1); NaN for fewer than two values."""
    array = np.asarray(values, dtype=np.float64)
    return float(np.std(array, ddof=1)) if len(array) > 1 else float("nan")


def pooled_standard_deviation(count: float, total: float, total_of_squares: float) -> float:
    """Return the sample standard deviation from a count, a sum and a sum of squares."""
    if count < 2:
        return float("nan")
    variance = (total_of_squares - total * total / count) / (count - 1)
    return float(np.sqrt(max(variance, 0.0)))


def exceedance(values: ArrayLike, thresholds: ArrayLike) -> Array:
    """Return per run and threshold whether the value exceeds it, as 0.0 or 1.0, `(n, m)`.

    Its mean over the runs is the performance profile (score distribution) of Agarwal
    et al. (2021), "Deep reinforcement learning at the edge of the statistical
    precipice", NeurIPS 34.
    """
    above = np.asarray(values, np.float64)[:, None] > np.asarray(thresholds, np.float64)[None, :]
    return above.astype(np.float64)


def histogram_quantiles(counts: ArrayLike, edges: ArrayLike, levels: ArrayLike) -> Array:
    """Return quantiles of binned values, linear within a bin.

    Parameters
    ----------
    counts
        Values per bin, `(b,)`.
    edges
        Bin edges, increasing, `(b + 1,)`.
    levels
        Probabilities in [0, 1], `(q,)`.

    Returns
    -------
    Array
        The quantiles, `(q,)`, in the unit of `edges` and at most one bin from the
        quantile of the unbinned values; NaN where nothing was counted.
    """
    bins = np.asarray(counts, dtype=np.float64)
    bounds = np.asarray(edges, dtype=np.float64)
    wanted = np.asarray(levels, dtype=np.float64)
    if bins.sum() == 0:
        return np.full(wanted.shape, np.nan)
    filled = np.flatnonzero(bins)
    cumulative = np.cumsum(bins[filled])
    target = wanted * cumulative[-1]
    # Empty bins are left out, so that a level on the border between two filled bins
    # does not fall anywhere in the gap between them.
    position = np.minimum(np.searchsorted(cumulative, target), len(filled) - 1)
    chosen = filled[position]
    inside = 1.0 - (cumulative[position] - target) / bins[chosen]
    return bounds[chosen] + inside * (bounds[chosen + 1] - bounds[chosen])


def _ratio(top: Array, bottom: Array) -> Array:
    """Divide, NaN where the denominator is zero (for example nobody was found)."""
    return np.divide(top, bottom, out=np.full_like(top, np.nan), where=bottom != 0)


def _resampling_counts(runs: int, resamples: int, seed: int) -> Iterator[Array]:
    """Yield blocks `(b, runs)` of how often each run occurs in each bootstrap sample."""
    rng = np.random.default_rng(seed)
    block = max(1, _BATCH_ELEMENTS // runs)
    for first in range(0, resamples, block):
        rows = min(block, resamples - first)
        drawn = rng.integers(runs, size=(rows, runs)) + runs * np.arange(rows)[:, None]
        counts = np.bincount(drawn.ravel(), minlength=rows * runs)
        yield counts.reshape(rows, runs).astype(np.float64)


def _acceleration(top: Array, bottom: Array) -> Array:
    """Return the BCa acceleration of each column from its jackknife values."""
    left_out = _ratio(top.sum(axis=0) - top, bottom.sum(axis=0) - bottom)
    # A run without which there is no ratio says nothing about its skewness.
    known = np.isfinite(left_out)
    centre = _ratio(np.where(known, left_out, 0.0).sum(axis=0), known.sum(axis=0))
    deviation = np.where(known, centre - left_out, 0.0)
    spread = (deviation**2).sum(axis=0) ** 1.5
    return np.divide(
        (deviation**3).sum(axis=0), 6.0 * spread, out=np.zeros(top.shape[1]), where=spread > 0
    )


def _bca_interval(
    samples: Array, value: Array, acceleration: Array, confidence: float
) -> tuple[Array, Array]:
    """Return the BCa interval of each column of the bootstrap `samples`, `(resamples, m)`."""
    # Ties count half, so that a value on a lattice (a share of few runs) is not biased.
    below = ((samples < value).sum(axis=0) + (samples <= value).sum(axis=0)) / 2.0
    # Samples without a ratio say nothing of where the others lie.
    usable = np.maximum(np.isfinite(samples).sum(axis=0), 1)
    z0 = special.ndtri(np.clip(below / usable, 0.5 / usable, 1.0 - 0.5 / usable))
    ends = []
    for tail in ((1.0 - confidence) / 2.0, (1.0 + confidence) / 2.0):
        z = z0 + special.ndtri(tail)
        level = special.ndtr(z0 + z / (1.0 - acceleration * z))
        ends.append(_quantile_per_column(samples, level))
    return ends[0], ends[1]


def _quantile_per_column(samples: Array, levels: Array) -> Array:
    """Return for each column of `samples` the quantile at the level of that column."""
    # Samples in which nobody was found have no ratio; sorting puts their NaN last.
    ordered = np.sort(samples, axis=0)
    usable = np.isfinite(ordered).sum(axis=0)
    position = levels * np.maximum(usable - 1, 0)
    lower = np.floor(position).astype(np.int64)
    upper = np.minimum(lower + 1, np.maximum(usable - 1, 0))
    columns = np.arange(samples.shape[1])
    fraction = position - lower
    return ordered[lower, columns] * (1.0 - fraction) + ordered[upper, columns] * fraction
