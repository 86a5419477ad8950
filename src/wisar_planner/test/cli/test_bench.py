import json
import sys

import pytest

from wisar_planner.cli.bench import _NEED_TORCH
from wisar_planner.cli.main import main
from wisar_planner.evaluation import bench, bench_training
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


def never():
    raise AssertionError("measured in vain")


def one_line(capsys):
    (line,) = capsys.readouterr().err.splitlines()
    return line


def test_a_file_that_cannot_be_written_is_refused_before_measuring(monkeypatch, capsys):
    monkeypatch.setattr(bench, "rows_of", lambda topic: {"slow": never})
    assert main(["bench", "--json", "/proc/x/y"]) == 2
    assert "wisar: --json: /proc/x/y cannot be written" in one_line(capsys)


def test_a_row_that_needs_pytorch_is_refused_before_measuring_without_it(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "torch", None)
    monkeypatch.setattr(bench, "TOPICS", {"alpha": "unused", "training": "unused"})
    rows = {"alpha": {"slow": never}, "training": {"training_samples": never}}
    monkeypatch.setattr(bench, "rows_of", rows.__getitem__)
    assert main(["bench"]) == 2
    assert "--only alpha) needs PyTorch" in one_line(capsys)


def test_no_other_row_of_training_needs_pytorch(monkeypatch):
    monkeypatch.setitem(sys.modules, "torch", None)
    assert set(_NEED_TORCH) < set(bench_training.ROWS)
    for name in _NEED_TORCH:
        with pytest.raises(ImportError):
            bench_training.ROWS[name]()
    assert set(bench_training.ROWS) - set(_NEED_TORCH) == {"training_gain_error"}
    assert bench_training.training_gain_error(paths=1).ours > 0.0


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
