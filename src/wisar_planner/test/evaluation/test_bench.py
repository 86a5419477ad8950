import json
import sys
from types import SimpleNamespace

import pytest

from wisar_planner.errors import InvalidInput
from wisar_planner.evaluation import bench, bench_evaluation
from wisar_planner.evaluation.bench_row import BenchRow


def fake_topics(monkeypatch):
    """Two topics whose modules count how often they are measured."""
    counts = {}

    def row(name):
        def measure():
            counts[name] = counts.get(name, 0) + 1
            return BenchRow(name, "s", 1.0, 2.0, "peer 1.0", 2.0, {"runs": 3})

        return measure

    monkeypatch.setattr(bench, "TOPICS", {"alpha": "fake_alpha", "beta": "fake_beta"})
    monkeypatch.setitem(
        sys.modules, "fake_alpha", SimpleNamespace(ROWS={n: row(n) for n in ("a1", "a2")})
    )
    monkeypatch.setitem(sys.modules, "fake_beta", SimpleNamespace(ROWS={"b1": row("b1")}))
    return counts


@pytest.mark.parametrize(
    ("only", "expected"),
    [
        ([], ["a1", "a2", "b1"]),
        (["beta"], ["b1"]),
        (["a2"], ["a2"]),
        (["beta", "a1"], ["b1", "a1"]),
    ],
)
def test_topics_and_rows_are_selected_and_measured_once(monkeypatch, only, expected):
    counts = fake_topics(monkeypatch)
    assert [row.name for row in bench.measure(bench.select_rows(only))] == expected
    assert counts == dict.fromkeys(expected, 1)


def test_a_topic_is_not_loaded_for_another_ones_sake(monkeypatch):
    fake_topics(monkeypatch)
    monkeypatch.delitem(sys.modules, "fake_alpha")
    assert list(bench.select_rows(["beta"])) == ["b1"]


def test_unknown_names_are_refused_with_the_known_ones(monkeypatch):
    fake_topics(monkeypatch)
    with pytest.raises(InvalidInput, match=r"'gamma'.*alpha, beta, a1, a2, b1"):
        bench.select_rows(["gamma"])
    with pytest.raises(InvalidInput, match="topic"):
        bench.rows_of("gamma")


def test_details_stand_beside_the_fixed_keys_in_json():
    row = BenchRow("n", "s", 1.0, details={"uploads": 100})
    assert json.loads(json.dumps(bench.row_to_json(row))) == {
        "name": "n",
        "unit": "s",
        "ours": 1.0,
        "peer": None,
        "peer_name": None,
        "ratio": None,
        "uploads": 100,
    }


def test_the_machine_is_described():
    assert set(bench.machine()) == {"processor", "cores", "python", "system"}
    assert all(bench.machine().values())


def test_rows_of_the_evaluation_measure_what_they_say(monkeypatch):
    monkeypatch.setattr(bench_evaluation, "CHEAP_PLANNERS", ("lawnmower", "lhc_gw_conv"))
    monkeypatch.setattr(bench_evaluation, "_STEPS_RUNS", 3)
    row = bench_evaluation.evaluation_steps_per_second()
    assert row.name == "evaluation_steps_per_second"
    assert row.ours * row.details["seconds"] == pytest.approx(row.details["steps"])
    assert set(bench_evaluation.ROWS) == {
        "evaluation_steps_per_second",
        "evaluation_1000_runs_cheap_planners",
    }
