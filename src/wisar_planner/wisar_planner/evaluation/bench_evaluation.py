"""How fast a whole evaluation is: planning, measuring, drawing persons, writing nothing."""

from __future__ import annotations

import time
from collections.abc import Callable

from wisar_planner.evaluation.bench_row import BenchRow
from wisar_planner.evaluation.run import PlannerSpec, RunRecord
from wisar_planner.evaluation.runner import Evaluation, run_evaluation

CHEAP_PLANNERS = ("lawnmower", "lhc_gw_conv", "greedy")

#: Longest that 1,000 runs of the cheap planners may take on two cores, s.
TARGET_SECONDS = 180.0


_STEPS_RUNS = 100


def evaluation_steps_per_second() -> BenchRow:
    """Measure the steps of whole evaluations per second on one core."""
    records, seconds = _timed(_STEPS_RUNS, jobs=1)
    steps = sum(len(record.waypoints) - 1 for record in records)
    return BenchRow(
        name="evaluation_steps_per_second",
        unit="steps/s",
        ours=steps / seconds,
        details={
            "runs": _STEPS_RUNS,
            "planners": list(CHEAP_PLANNERS),
            "cores": 1,
            "steps": steps,
            "seconds": seconds,
        },
    )


def evaluation_1000_runs_cheap_planners() -> BenchRow:
    """Measure 1,000 runs of each of the cheap planners on two cores, workers' start included."""
    records, seconds = _timed(runs=1000, jobs=2)
    return BenchRow(
        name="evaluation_1000_runs_cheap_planners",
        unit="s",
        ours=seconds,
        details={
            "runs": len(records) // len(CHEAP_PLANNERS),
            "planners": list(CHEAP_PLANNERS),
            "cores": 2,
            "target_s": TARGET_SECONDS,
            "seconds_of_planning": sum(record.seconds for record in records),
        },
    )


def _timed(runs: int, jobs: int) -> tuple[list[RunRecord], float]:
    """Run the cheap planners, their kernels compiled beforehand, and return the time taken."""
    planners = [PlannerSpec(name) for name in CHEAP_PLANNERS]
    run_evaluation(Evaluation(planners, runs=1, persons=1), jobs=1)
    begin = time.perf_counter()
    records = run_evaluation(Evaluation(planners, runs=runs), jobs=jobs)
    return records, time.perf_counter() - begin


ROWS: dict[str, Callable[[], BenchRow]] = {
    "evaluation_steps_per_second": evaluation_steps_per_second,
    "evaluation_1000_runs_cheap_planners": evaluation_1000_runs_cheap_planners,
}
