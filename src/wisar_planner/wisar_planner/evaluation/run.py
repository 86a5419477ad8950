"""One run: one planner on one map, and the record of everything that is reported about it."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from wisar_planner.errors import FloatArray, InvalidInput
from wisar_planner.evaluation.scenario import Scenario, persons_in_area
from wisar_planner.planners.base import Planner
from wisar_planner.planners.registry import make_planner, planner_options
from wisar_planner.planners.sac import trained_policy
from wisar_planner.policy.model import find_model
from wisar_planner.search import SearchPath, SearchProblem, distance_to_find, upper_bound
from wisar_planner.search.path import walking_distances

#: The paper walks a path in N_steps = 50 parts (its path walking equation), both ends included.
CURVE_STEPS = 50

#: Bins of the distance to find over the longest path: a quantile is off by less than 0.4 % of it.
FIND_BINS = 256

#: What tells trained policies of one name or path apart, in `PlannerSpec.identity`.
MODEL_HASH = "model_sha256"

_MODEL_OPTION = "model"


@dataclass(frozen=True)
class PlannerSpec:
    """A planner by name and options, which any worker can turn into the planner.

    Parameters
    ----------
    name : str
        Name in the registry.
    options : Mapping
        Options that differ from their defaults.
    """

    name: str
    options: Mapping[str, Any] = field(default_factory=dict)

    def make(self) -> Planner:
        """Return the planner.

        Raises
        ------
        InvalidInput
            If the name or an option is unknown or wrong.
        """
        return make_planner(self.name, **self.options)

    def resolved(self) -> dict[str, Any]:
        """Return all options with the values that the planner uses, ready for JSON."""
        planner = self.make()
        return {name: getattr(planner, name) for name in planner_options(self.name)}

    def identity(self) -> dict[str, Any]:
        """Return `resolved` and, of a trained policy, the SHA-256 of its file as `MODEL_HASH`.

        Raises
        ------
        InvalidInput
            If the policy's file is not there.
        """
        options = self.resolved()
        if _MODEL_OPTION not in options:
            return options
        # Further training writes other weights to the same path.
        content = find_model(options[_MODEL_OPTION]).read_bytes()
        return {**options, MODEL_HASH: hashlib.sha256(content).hexdigest()}


@dataclass(frozen=True)
class RunRecord:
    """What is kept of one run; plain numbers, so that JSON gives back the same.

    Attributes
    ----------
    planner : str
        Name of the planner.
    index : int
        Number of the map.
    p_d : float
        Probability seen over the whole path (the paper's p_D).
    e_p : float
        Probability efficiency p_D / p_A (the paper's e_p at D).
    p_a : float
        Probability inside the area.
    bound : float
        Probability efficiency that no path can beat on this map.
    curve : list of float
        e_p after 0, 1, ..., 50 fiftieths of the longest distance.
    persons, found : int
        Missing persons drawn inside the area, and how many of them the path finds.
    find_total, find_squares : float
        Sum and sum of squares of the distances to find of the found, m and m^2.
    find_counts : list of int
        Histogram of these distances over the longest distance, `FIND_BINS` bins.
    seconds : float
        Time of planning, s.
    length : float
        Length of the path, m.
    transit : float
        Part of it that leads from the start to a pattern's first point, m.
    offset : float
        Distance from the start to the first waypoint, m; not 0 for a pattern that begins at its
        own first point.
    start : list of float
        The start of the problem, m.
    waypoints : list of list of float
        The path, m, to the millimetre; the figures above come from the exact path.
    """

    planner: str
    index: int
    p_d: float
    e_p: float
    p_a: float
    bound: float
    curve: list[float]
    persons: int
    found: int
    find_total: float
    find_squares: float
    find_counts: list[int]
    seconds: float
    length: float
    transit: float
    offset: float
    start: list[float]
    waypoints: list[list[float]]


def evaluate_map(
    scenario: Scenario,
    planners: Sequence[PlannerSpec],
    seed: int,
    index: int,
    persons: int,
    policies: Mapping[str, str] | None = None,
) -> list[RunRecord]:
    """Let the planners search one map and record how each of them does.

    Parameters
    ----------
    scenario : Scenario
        Where the map comes from.
    planners : sequence of PlannerSpec
        Who searches it.
    seed, index : int
        Which map.
    persons : int
        Missing persons to draw.
    policies : mapping of str to str, optional
        SHA-256 of the trained policy that a planner must have, by the planner's name.

    Raises
    ------
    InvalidInput
        If a planner has another policy.
    RuntimeError
        If a planner fails; the message says on which map.
    """
    warm_up(scenario, planners, seed)
    problem = scenario.problem(seed, index)
    bound = upper_bound(problem)
    positions = persons_in_area(problem, persons, seed, index)
    records = []
    for spec in planners:
        planner = _planner(spec)
        begin = time.perf_counter()
        try:
            path = planner.plan(problem)
        except Exception as error:
            _check_policy(spec, planner, policies)
            # Whoever looks into it needs to know which problem to make again.
            raise RuntimeError(f"{spec.name} failed on map {index} of seed {seed}") from error
        seconds = time.perf_counter() - begin
        _check_policy(spec, planner, policies)
        records.append(_record(spec.name, index, problem, bound, path, positions, seconds))
    return records


def _check_policy(spec: PlannerSpec, planner: Planner, policies: Mapping[str, str] | None) -> None:
    """Raise InvalidInput where a planner flies another trained policy than it should.

    Further training writes other weights to the same path, and the machines of a cluster may have
    other ones of the same name.
    """
    wanted = (policies or {}).get(spec.name)
    if wanted is None:
        return
    name = getattr(planner, _MODEL_OPTION)
    if trained_policy(name).card["weights_sha256"] != wanted:
        raise InvalidInput(
            f"{spec.name}: the policy {name} is another one than the evaluation began with; runs "
            "of two policies do not mix. Copy the files to a place where nothing changes them"
        )


def warm_up(scenario: Scenario, planners: Sequence[PlannerSpec], seed: int) -> None:
    """Load compiled kernels and policies in this process, once, before anything is timed."""
    kind = type(scenario).__name__  # Mixtures and rasters have kernels of their own.
    cold = [spec for spec in planners if (kind, _key(spec)) not in _warm]
    if not cold:
        return
    problem = scenario.problem(seed, 0)
    positions = persons_in_area(problem, 1, seed, 0)
    for spec in cold:
        planner = _planner(spec)
        deadline = time.perf_counter() + _WARM_UP_SECONDS

        def enough(deadline: float = deadline) -> bool:
            return time.perf_counter() > deadline

        path = planner.plan(problem, should_stop=enough)
        _record(spec.name, 0, problem, 0.0, path, positions, 0.0)
        _warm.add((kind, _key(spec)))


#: Longest that an anytime planner is let run while it is warmed up.
_WARM_UP_SECONDS = 0.5

_warm: set[tuple[str, str]] = set()
_planners: dict[str, Planner] = {}


def _key(spec: PlannerSpec) -> str:
    return f"{spec.name} {sorted(spec.options.items())}"


def _planner(spec: PlannerSpec) -> Planner:
    """Return this process's own instance, since loading a policy takes longer than a plan."""
    key = _key(spec)
    if key not in _planners:
        _planners[key] = spec.make()
    return _planners[key]


def _record(
    name: str,
    index: int,
    problem: SearchProblem,
    bound: float,
    path: SearchPath,
    persons: FloatArray,
    seconds: float,
) -> RunRecord:
    """Measure a path."""
    stops = walking_distances(problem.max_distance, CURVE_STEPS)
    seen = path.probability_over_distance(problem.pdm, stops)
    p_a = problem.probability_in_area
    finds = distance_to_find(path, persons)
    finds = finds[np.isfinite(finds)]
    bins = np.minimum(finds / problem.max_distance * FIND_BINS, FIND_BINS - 1).astype(np.int64)
    p_d = float(seen[-1])
    return RunRecord(
        planner=name,
        index=index,
        p_d=p_d,
        e_p=p_d / p_a,
        p_a=p_a,
        bound=bound,
        curve=(seen / p_a).tolist(),
        persons=len(persons),
        found=len(finds),
        find_total=float(finds.sum()),
        find_squares=float((finds**2).sum()),
        find_counts=np.bincount(bins, minlength=FIND_BINS).tolist(),
        seconds=seconds,
        length=float(path.length),
        transit=float(path.transit_length),
        offset=float(np.hypot(*(path.waypoints[0] - problem.start))),
        start=problem.start.tolist(),
        waypoints=np.round(path.waypoints, 3).tolist(),
    )
