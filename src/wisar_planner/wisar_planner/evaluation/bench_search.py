"""Benchmark of the seen probability: against the paper's own library, and over long paths."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import numpy as np
from scipy.optimize import approx_fprime

from wisar_planner.errors import FloatArray
from wisar_planner.evaluation.bench_row import BenchRow
from wisar_planner.pdm import GaussianMixture
from wisar_planner.pdm.closed_form import mixture_in_polygon
from wisar_planner.search.gradient import seen_with_gradient
from wisar_planner.search.path import SearchPath
from wisar_planner.search.problem import SearchProblem
from wisar_planner.search.seen_area import SeenArea, probability_seen

_TOLERANCE = 1e-6


def seen_probability_64_waypoints(
    paths: int = 20, repeats: int = 5, references: int = 2, quad_segs: int = 1024
) -> BenchRow:
    """Time the seen probability of random paths of the paper's size, on one core.

    Ours and the peer take the same maps and paths in turn. The relative error of ours is against
    the closed form over a finely buffered polygon; with 1024 segments per quarter circle it lacks
    less than 1e-7 of the true area.

    Parameters
    ----------
    paths : int
        Number of random maps and paths.
    repeats : int
        Times that each is timed; the least counts.
    references : int
        Number of paths that are compared with the reference.
    quad_segs : int
        Segments per quarter circle of the reference.
    """
    cases = [_random_case(np.random.default_rng(seed)) for seed in range(paths)]
    peer = _jpathgen()
    ours_s, peer_s, differences = [], [], []
    for mixture, path in cases:
        ours_s.append(_least_time(partial(path.seen_probability, mixture), repeats))
        if peer is not None:
            integrate = peer(mixture, path)
            peer_s.append(_least_time(integrate, repeats))
            differences.append(abs(integrate() / path.seen_probability(mixture) - 1.0))
    errors = []
    for mixture, path in cases[:references]:
        reference = mixture_in_polygon(mixture, path.seen_area(quad_segs))
        errors.append(abs(path.seen_probability(mixture) / reference - 1.0))
    ours = 1e3 * float(np.mean(ours_s))
    theirs = 1e3 * float(np.mean(peer_s)) if peer_s else None
    return BenchRow(
        name="seen_probability_64_waypoints",
        unit="ms per path",
        ours=ours,
        peer=theirs,
        peer_name=f"libjpathgen {version('libjpathgen')}" if peer_s else None,
        ratio=theirs / ours if theirs is not None else None,
        details={
            "paths": paths,
            "tolerance": _TOLERANCE,
            "relative_error": max(errors),
            "peer_relative_difference": max(differences) if differences else None,
        },
    )


def incremental_step_growth_50_to_5000(repeats: int = 30) -> BenchRow:
    """Time one more step after 5,000 and after 50 steps of a path with overlapping lanes.

    Parameters
    ----------
    repeats : int
        Times that a lane of 20 steps is added to a copy of either area; the median step counts.
    """
    problem = SearchProblem.paper(np.random.default_rng(0))
    lane = 20
    waypoints = _meander(5000 + 2 * lane, lane, problem.step_length, 1.6 * problem.swath_radius)
    area = SeenArea(problem.pdm, problem.swath_radius)
    snapshots: dict[int, SeenArea] = {}
    for i in range(5001):
        if i in (50, 5000):
            snapshots[i] = area.copy()
        area.add(waypoints[i], waypoints[i + 1])
    costs: dict[int, list[float]] = {50: [], 5000: []}
    for repeat in range(repeats):
        for steps in (50, 5000) if repeat % 2 else (5000, 50):
            trial = snapshots[steps].copy()
            for i in range(steps, steps + lane):
                begin = time.perf_counter()
                trial.add(waypoints[i], waypoints[i + 1])
                costs[steps].append(time.perf_counter() - begin)
    early, late = (1e6 * float(np.median(costs[steps])) for steps in (50, 5000))
    return BenchRow(
        name="incremental_step_growth_50_to_5000",
        unit="cost of a step after 5,000 steps over that after 50",
        ours=late / early,
        details={"after_50_us": early, "after_5000_us": late},
    )


def gradient_64_waypoints(paths: int = 20, repeats: int = 5) -> BenchRow:
    """Time the gradient of the seen probability of random paths of the paper's size, on one core.

    Ours has the value beside it. The peer takes forward differences of our seen probability.

    Parameters
    ----------
    paths : int
        Number of random maps and paths.
    repeats : int
        Times that each is timed; the least counts.
    """
    ours_s, peer_s, value_s, errors = [], [], [], []
    for seed in range(paths):
        pdm, path = _random_case(np.random.default_rng(seed))
        points, radius = path.waypoints, path.swath_radius
        steps = len(points) - 1

        def value(flat: FloatArray, pdm: Any = pdm, radius: float = radius) -> float:
            return probability_seen(pdm, flat.reshape(-1, 2), radius)

        ours = partial(seen_with_gradient, pdm, points, radius, [steps], [1.0])
        peer = partial(approx_fprime, points.ravel(), value, 1e-6)
        ours_s.append(_least_time(ours, repeats))
        peer_s.append(_least_time(peer, 1))
        value_s.append(_least_time(partial(value, points), repeats))
        gradient, differences = ours()[1].ravel(), peer()
        errors.append(float(np.abs(gradient - differences).max() / np.abs(differences).max()))
    means = [1e3 * float(np.mean(each)) for each in (ours_s, peer_s, value_s)]
    return BenchRow(
        name="gradient_64_waypoints",
        unit="ms per path",
        ours=means[0],
        peer=means[1],
        peer_name=f"scipy {version('scipy')} approx_fprime",
        ratio=means[1] / means[0],
        details={
            "paths": paths,
            "value_alone_ms": means[2],
            "relative_difference_median": float(np.median(errors)),
        },
    )


ROWS: dict[str, Callable[[], BenchRow]] = {
    "seen_probability_64_waypoints": seen_probability_64_waypoints,
    "gradient_64_waypoints": gradient_64_waypoints,
    "incremental_step_growth_50_to_5000": incremental_step_growth_50_to_5000,
}


def _random_case(rng: np.random.Generator) -> tuple[GaussianMixture, SearchPath]:
    """Return a map of the paper's setup and a random walk of its steps inside the area."""
    problem = SearchProblem.paper(rng)
    assert isinstance(problem.pdm, GaussianMixture)
    points = [problem.start]
    while len(points) <= problem.steps:
        angle = rng.uniform(0.0, 2.0 * np.pi)
        step = problem.step_length * np.array([np.cos(angle), np.sin(angle)])
        if problem.area.contains([points[-1] + step])[0]:
            points.append(points[-1] + step)
    return problem.pdm, SearchPath(np.array(points), problem.swath_radius)


def _meander(steps: int, lane: int, step: float, spacing: float) -> FloatArray:
    """Return waypoints up and down lanes of `lane` steps; a step also leads to the next lane."""
    index = np.arange(steps + 1)
    number, along = np.divmod(index, lane + 1)
    x = np.where(number % 2 == 0, along, lane - along) * step
    return np.column_stack([x, number * spacing])


def _jpathgen() -> Callable[[GaussianMixture, SearchPath], Callable[[], float]] | None:
    """Return how the peer integrates a mixture over a path; None where it is not installed."""
    try:
        import libjpathgen as peer

        version("libjpathgen")
    except (ImportError, PackageNotFoundError):
        return None

    def prepare(mixture: GaussianMixture, path: SearchPath) -> Callable[[], float]:
        stacked = np.ascontiguousarray(mixture.covariances.reshape(-1, 2))
        density: Any = peer.MultiModalBivariateGaussian(mixture.means.copy(), stacked)
        arguments = peer.ContinuousArgs(path.swath_radius, 0.0, _TOLERANCE, 100_000)
        waypoints = path.waypoints.copy()
        return lambda: float(peer.continuous_integration_over_path(density, waypoints, arguments))

    return prepare


def _least_time(task: Callable[[], object], repeats: int) -> float:
    """Return the least wall-clock time of a task in seconds."""
    task()
    times = []
    for _ in range(repeats):
        begin = time.perf_counter()
        task()
        times.append(time.perf_counter() - begin)
    return min(times)
