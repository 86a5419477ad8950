import json

import pytest

from wisar_planner.cli.main import main
from wisar_planner.evaluation import bench
from wisar_planner.evaluation.bench_row import BenchRow


@pytest.fixture(autouse=True)
def fake_rows(monkeypatch):
    rows = {
        "fast": lambda: BenchRow("fast", "ms", 0.5, 4.0, "peer 1.2", 8.0, {"tolerance": 1e-6}),
        "alone": lambda: BenchRow("alone", "steps/s", 123456.0),
    }
    monkeypatch.setattr(bench, "TOPICS", {"alpha": "unused"})
    monkeypatch.setattr(bench, "rows_of", lambda topic: rows)


def test_rows_are_printed_and_written(tmp_path, capsys):
    path = tmp_path / "new" / "bench.json"
    assert main(["bench", "--json", str(path)]) == 0
    content = json.loads(path.read_text())
    assert [row["name"] for row in content["rows"]] == ["fast", "alone"]
    assert content["rows"][0]["ratio"] == 8.0
    assert content["rows"][0]["tolerance"] == 1e-6
    assert content["rows"][1]["peer"] is None
    assert content["machine"]["cores"] >= 1
    text = capsys.readouterr().out
    assert "peer 1.2" in text
    assert "123,456" in text


def test_only_measures_only_that(tmp_path):
    path = tmp_path / "bench.json"
    assert main(["bench", "--only", "alone", "--json", str(path)]) == 0
    assert [row["name"] for row in json.loads(path.read_text())["rows"]] == ["alone"]


def test_list_measures_nothing(capsys):
    assert main(["bench", "--list"]) == 0
    assert capsys.readouterr().out == "alpha: fast, alone\n"


def test_unknown_row_is_a_users_mistake(capsys):
    assert main(["bench", "--only", "nothing"]) == 2
    assert "nothing" in capsys.readouterr().err
