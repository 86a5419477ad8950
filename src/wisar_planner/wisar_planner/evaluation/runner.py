"""All runs of an evaluation, in parallel, the same numbers wherever they are made."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import joblib

from wisar_planner.errors import InvalidInput
from wisar_planner.evaluation.run import (
    CURVE_STEPS,
    FIND_BINS,
    MODEL_HASH,
    PlannerSpec,
    RunRecord,
    evaluate_map,
    warm_up,
)
from wisar_planner.evaluation.scenario import RandomMaps, Scenario
from wisar_planner.evaluation.store import RunStore


@dataclass(frozen=True)
class Evaluation:
    """Which planners are compared on which maps.

    Parameters
    ----------
    planners : sequence of PlannerSpec
        Planners, each name once.
    runs : int
        Number of maps N; maps 0 to N - 1 of the seed.
    seed : int
        Seed of the maps, starts and persons.
    persons : int
        Missing persons drawn on each map.
    scenario : Scenario
        Where maps and starts come from; the paper's setup unless given.

    Raises
    ------
    InvalidInput
        If a count is not positive, the seed is negative, or a planner is named twice, unknown
        or has a wrong option.
    """

    planners: Sequence[PlannerSpec]
    runs: int
    seed: int = 0
    persons: int = 1000
    scenario: Scenario = field(default_factory=RandomMaps)

    def __post_init__(self) -> None:
        names = [spec.name for spec in self.planners]
        if not names:
            raise InvalidInput("planner: name at least one planner")
        for name in names:
            if names.count(name) > 1:
                raise InvalidInput(f"planner: {name} is named twice")
        for value, argument in ((self.runs, "runs"), (self.persons, "persons")):
            if value < 1:
                raise InvalidInput(f"{argument} must be at least 1, not {value}")
        if self.seed < 0:
            raise InvalidInput(f"seed must not be negative, not {self.seed}")
        for spec in self.planners:
            spec.make()

    def common_setup(self) -> dict[str, Any]:
        """Return what all runs share, whatever their number and the list of planners."""
        return {
            "seed": self.seed,
            "persons": self.persons,
            "curve_steps": CURVE_STEPS,
            "find_bins": FIND_BINS,
            **self.scenario.description(),
        }


def run_evaluation(
    evaluation: Evaluation,
    *,
    jobs: int = -1,
    dask: str | None = None,
    store: RunStore | None = None,
    on_records: Callable[[Sequence[RunRecord]], None] | None = None,
) -> list[RunRecord]:
    """Make all runs that are not in the store yet.

    A run depends on the setup, the seed and its index alone. So the records are the same for
    any number of jobs and any backend, except for the time that planning took, and for
    planners that work against the clock.

    Parameters
    ----------
    evaluation : Evaluation
        What to run.
    jobs : int
        Local processes; -1 for one per core. Not used with a cluster.
    dask : str, optional
        Address of a Dask scheduler, such as ``tcp://127.0.0.1:8786``, to run on its workers.
    store : RunStore, optional
        Finished runs to continue from; new ones are added to it as they come.
    on_records : callable, optional
        Called in this process with the new records of each finished map.

    Returns
    -------
    list of RunRecord
        All runs, planner by planner in the order given, then by index.

    Raises
    ------
    InvalidInput
        If a trained policy changes on the way, or a worker has another one of the same name.
    """
    order = {spec.name: position for position, spec in enumerate(evaluation.planners)}
    records = [
        record
        for record in (store.records if store else ())
        if record.planner in order and record.index < evaluation.runs
    ]
    identities = {spec.name: spec.identity() for spec in evaluation.planners}
    policies = {name: each[MODEL_HASH] for name, each in identities.items() if MODEL_HASH in each}
    tasks = _tasks(evaluation, {(record.planner, record.index) for record in records})
    if tasks:
        # Compile into the cache once here, not in every worker at the same time.
        warm_up(evaluation.scenario, evaluation.planners, evaluation.seed)
        with parallel_pool(jobs, dask) as parallel:
            for fresh in parallel(joblib.delayed(evaluate_map)(*task, policies) for task in tasks):
                records.extend(fresh)
                if store:
                    store.append(fresh)
                if on_records:
                    on_records(fresh)
    return sorted(records, key=lambda record: (order[record.planner], record.index))


def _tasks(
    evaluation: Evaluation, finished: set[tuple[str, int]]
) -> list[tuple[Scenario, tuple[PlannerSpec, ...], int, int, int]]:
    """Return the arguments of `evaluate_map` for every map that some planner still lacks."""
    tasks = []
    for index in range(evaluation.runs):
        missing = tuple(s for s in evaluation.planners if (s.name, index) not in finished)
        if missing:
            tasks.append((evaluation.scenario, missing, evaluation.seed, index, evaluation.persons))
    return tasks


@contextmanager
def parallel_pool(jobs: int, dask: str | None) -> Iterator[joblib.Parallel]:
    """Give a joblib pool on the local cores or on a Dask cluster.

    Raises
    ------
    InvalidInput
        When there would be no process, or no scheduler answers.
    """
    if dask is None:
        if jobs == 0:
            raise InvalidInput("jobs must be at least 1, or -1 for one process per core, not 0")
        yield joblib.Parallel(n_jobs=jobs, backend="loky", return_as="generator_unordered")
        return
    from distributed import Client

    try:
        client = Client(dask, timeout="10s")  # type: ignore[no-untyped-call]
    except (OSError, ValueError) as error:
        raise InvalidInput(f"dask: no scheduler answers at {dask} ({error})") from None
    with client, joblib.parallel_config(backend="dask", client=client):
        yield joblib.Parallel(n_jobs=-1, return_as="generator_unordered")
