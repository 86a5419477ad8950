import dataclasses

import numpy as np
import pytest

from wisar_planner.errors import InvalidInput
from wisar_planner.evaluation.run import PlannerSpec
from wisar_planner.evaluation.runner import Evaluation, run_evaluation
from wisar_planner.evaluation.scenario import Drone, RandomMaps
from wisar_planner.evaluation.store import RunStore
from wisar_planner.policy.model import find_model, load_model, save_model

SPECS = (PlannerSpec("lawnmower"), PlannerSpec("lhc_gw_conv"))
SHORT = RandomMaps(drone=Drone(max_distance=160.0))
EVALUATION = Evaluation(SPECS, runs=5, seed=11, persons=50, scenario=SHORT)


def untimed(records):
    """Everything but the time that planning took."""
    return [dataclasses.replace(record, seconds=0.0) for record in records]


@pytest.fixture(scope="module")
def reference():
    return untimed(run_evaluation(EVALUATION, jobs=1))


def test_records_come_planner_by_planner_in_order_of_the_maps(reference):
    assert [(r.planner, r.index) for r in reference] == [
        (spec.name, index) for spec in SPECS for index in range(5)
    ]


def test_all_planners_of_a_map_have_the_same_map_start_and_persons(reference):
    for first, second in zip(reference[:5], reference[5:], strict=True):
        assert (first.start, first.p_a, first.bound) == (second.start, second.p_a, second.bound)


def test_two_processes_give_the_same_numbers(reference):
    assert untimed(run_evaluation(EVALUATION, jobs=2)) == reference


def test_a_dask_cluster_gives_the_same_numbers(reference):
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=2,
        threads_per_worker=1,
        processes=True,
        host="127.0.0.1",
        dashboard_address=None,
    ) as cluster:
        records = run_evaluation(EVALUATION, dask=cluster.scheduler_address)
    assert untimed(records) == reference


def test_no_scheduler_at_the_address_is_said_in_words(monkeypatch):
    distributed = pytest.importorskip("distributed")

    def unreachable(*_, **__):
        raise OSError("Timed out trying to connect")

    monkeypatch.setattr(distributed, "Client", unreachable)
    with pytest.raises(InvalidInput, match=r"no scheduler answers at tcp://127\.0\.0\.1:1"):
        run_evaluation(EVALUATION, dask="tcp://127.0.0.1:1")


def test_fewer_maps_and_planners_give_the_same_numbers(reference):
    part = dataclasses.replace(EVALUATION, planners=SPECS[1:], runs=2)
    assert untimed(run_evaluation(part, jobs=1)) == reference[5:7]


def test_another_seed_gives_other_maps(reference):
    other = dataclasses.replace(EVALUATION, seed=12, runs=1)
    assert run_evaluation(other, jobs=1)[0].start != reference[0].start


class Interrupted(KeyboardInterrupt):
    """Ctrl-C of the test."""


def test_interrupted_evaluation_continues_where_it_stopped(tmp_path, reference):
    path = tmp_path / "runs.jsonl"
    seen = []

    def interrupt(records):
        seen.extend(records)
        if len(seen) == 4:
            raise Interrupted

    with (
        RunStore(path, EVALUATION.common_setup(), SPECS) as store,
        pytest.raises(Interrupted),
    ):
        run_evaluation(EVALUATION, jobs=1, store=store, on_records=interrupt)

    fresh = []
    with RunStore(path, EVALUATION.common_setup(), SPECS) as store:
        assert len(store.records) == 4
        records = run_evaluation(EVALUATION, jobs=1, store=store, on_records=fresh.extend)
    assert len(fresh) == 6
    assert untimed(records) == reference


def test_finished_evaluation_is_extended_by_runs_and_planners(tmp_path, reference):
    path = tmp_path / "runs.jsonl"
    small = dataclasses.replace(EVALUATION, planners=SPECS[:1], runs=2)
    with RunStore(path, small.common_setup(), small.planners) as store:
        run_evaluation(small, jobs=1, store=store)
    fresh = []
    with RunStore(path, EVALUATION.common_setup(), SPECS) as store:
        records = run_evaluation(EVALUATION, jobs=1, store=store, on_records=fresh.extend)
    assert len(fresh) == 8
    assert untimed(records) == reference


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"planners": ()}, "planner"),
        ({"planners": (SPECS[0], SPECS[0])}, "lawnmower is named twice"),
        ({"planners": (PlannerSpec("nobody"),)}, "nobody"),
        ({"runs": 0}, "runs"),
        ({"persons": 0}, "persons"),
        ({"seed": -1}, "seed"),
    ],
)
def test_wrong_evaluations_are_refused(change, named):
    with pytest.raises(InvalidInput, match=named):
        dataclasses.replace(EVALUATION, **change)


def test_a_policy_that_changes_on_the_way_ends_the_evaluation(tmp_path):
    """As further training does that writes to the same path."""
    path = tmp_path / "policy.safetensors"
    policy = load_model(find_model("sac_plain"))
    save_model(path, policy.weights, policy.card)
    spec = PlannerSpec("sac", {"model": str(path)})
    evaluation = Evaluation([PlannerSpec("lawnmower"), spec], runs=3, persons=5)
    seen = []

    def trained_on(records):
        seen.extend(records)
        other = {name: value + np.float32(0.01) for name, value in policy.weights.items()}
        save_model(path, other, policy.card)

    with pytest.raises(InvalidInput, match=r"sac: the policy .* is another one than"):
        run_evaluation(evaluation, jobs=1, on_records=trained_on)
    assert {record.index for record in seen} == {0}
