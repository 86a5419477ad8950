"""`wisar train`: a model, its card and its curve from a configuration."""

import json
import subprocess
import sys

import numpy as np

from wisar_planner import SearchProblem, make_planner
from wisar_planner.cli.main import main

TINY = """\
name: tiny
steps: 160
environments: 4
warm_up_steps: 32
updates: 1
batch: 8
replay: 128
validation_maps: 2
validation_every: 80
sac: {channels: 4, blocks: 1}
"""


def test_a_trained_model_can_be_planned_with_and_training_goes_on(tmp_path, capsys) -> None:
    config, out, curve = tmp_path / "tiny.yaml", tmp_path / "run", tmp_path / "curve.json"
    config.write_text(TINY)
    command = ["train", str(config), "--out", str(out), "--json", str(curve), "--threads", "1"]
    assert main(command) == 0
    printed = capsys.readouterr().out
    assert "of the bound" in printed
    assert [each["steps"] for each in json.loads(curve.read_text())] == [80, 160]
    problem = SearchProblem.paper(np.random.default_rng(0))
    path = make_planner("sac", model=str(out / "tiny.safetensors")).plan(problem)
    assert path.length > 0.0
    assert main(command) == 0
    assert "continuing" in capsys.readouterr().out


def test_configurations_of_one_name_have_folders_of_their_own(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for file, batch in (("first.yaml", 8), ("second.yaml", 16)):
        (tmp_path / file).write_text(TINY.replace("batch: 8", f"batch: {batch}"))
        assert main(["train", file, "--seed", "3", "--threads", "1"]) == 0
        assert "continuing" not in capsys.readouterr().out
    found = sorted(path.parent for path in (tmp_path / "out").rglob("tiny.safetensors"))
    assert found == [tmp_path / "out/train/first-3", tmp_path / "out/train/second-3"]


def test_mistakes_are_told_in_one_line(tmp_path, capsys) -> None:
    config = tmp_path / "tiny.yaml"
    config.write_text(TINY)
    for arguments, words in (
        ([str(tmp_path / "none.yaml")], "No such file"),
        ([str(config), "--seed", "-1"], "seed must be at least 0"),
        ([str(config), "--device", "quantum"], "--device quantum is not to be had"),
        ([str(config), "--threads", "-1"], "--threads must be at least 1"),
    ):
        assert main(["train", *arguments, "--out", str(tmp_path / "run")]) == 2
        error = capsys.readouterr().err
        assert words in error
        assert len(error.splitlines()) == 1


def test_without_pytorch_one_line_says_what_to_do(tmp_path) -> None:
    config = tmp_path / "tiny.yaml"
    config.write_text(TINY)
    code = (
        "import sys; sys.modules['torch'] = None\n"
        "from wisar_planner.cli.main import main\n"
        f"sys.exit(main(['train', {str(config)!r}]))"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert result.returncode == 2
    assert "make train-setup" in result.stderr
    assert len(result.stderr.splitlines()) == 1
