import argparse
import os
import re
import subprocess
import sys

import pytest

from wisar_planner.cli import main as cli_main
from wisar_planner.errors import InvalidInput


def run_with(monkeypatch, function):
    """Run `wisar anything` with this function as the subcommand."""
    parser = argparse.ArgumentParser()
    parser.set_defaults(func=function)
    monkeypatch.setattr(cli_main, "build_parser", lambda: parser)
    return cli_main.main([])


def raising(error):
    def function(_):
        raise error

    return function


def test_help_lists_the_commands_and_teaches_by_example(capsys):
    with pytest.raises(SystemExit) as stopped:
        cli_main.main(["--help"])
    assert stopped.value.code == 0
    text = capsys.readouterr().out
    for expected in ("evaluate", "bench", "examples:", "wisar plan map.tif"):
        assert expected in text


@pytest.mark.parametrize("command", ["evaluate", "bench"])
def test_every_option_in_the_examples_exists(capsys, command):
    with pytest.raises(SystemExit):
        cli_main.main([command, "--help"])
    usage, _, examples = capsys.readouterr().out.partition("examples:")
    for option in re.findall(r" (--[a-z-]+)", examples):
        assert option in usage


def test_help_answers_within_half_a_second():
    durations = []
    for _ in range(3):
        before = os.times()
        subprocess.run(
            [sys.executable, "-m", "wisar_planner.cli", "--help"], check=True, capture_output=True
        )
        after = os.times()
        # Processor time of the child, so that a busy machine does not fail the test.
        user = after.children_user - before.children_user
        durations.append(user + after.children_system - before.children_system)
    assert min(durations) < 0.5


def test_help_imports_no_numerical_library():
    code = (
        "import sys; from wisar_planner.cli.main import build_parser; build_parser(); "
        "print([m for m in ('numpy', 'numba', 'scipy', 'matplotlib', 'joblib', 'torch', "
        "'rasterio', 'rich') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert done.stdout.strip() == "[]"


def test_version_is_printed(capsys):
    with pytest.raises(SystemExit) as stopped:
        cli_main.main(["--version"])
    assert stopped.value.code == 0
    assert capsys.readouterr().out.startswith("wisar ")


@pytest.mark.parametrize("arguments", [[], ["nonsense"], ["evaluate", "--runs", "many"]])
def test_wrong_arguments_are_one_line_and_status_two(capsys, arguments):
    with pytest.raises(SystemExit) as stopped:
        cli_main.main(arguments)
    assert stopped.value.code == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "--help" in error


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (InvalidInput("runs must be\nat least 1"), "wisar: runs must be at least 1\n"),
        (FileNotFoundError(2, "No such file", "map.tif"), "wisar: map.tif: No such file\n"),
        (OSError("the disk is full"), "wisar: the disk is full\n"),
    ],
)
def test_a_users_mistake_is_one_line_and_status_two(monkeypatch, capsys, error, said):
    assert run_with(monkeypatch, raising(error)) == 2
    assert capsys.readouterr().err == said


def test_ctrl_c_ends_with_130_and_no_traceback(monkeypatch, capsys):
    assert run_with(monkeypatch, raising(KeyboardInterrupt())) == 130
    assert capsys.readouterr().err == "wisar: stopped\n"


def test_our_own_mistakes_keep_their_traceback(monkeypatch):
    with pytest.raises(ValueError, match="a bug"):
        run_with(monkeypatch, raising(ValueError("a bug")))


def test_a_reader_that_has_had_enough_is_no_error():
    code = (
        "from wisar_planner.cli.main import main; from wisar_planner.evaluation import bench; "
        "bench.TOPICS = {'evaluation': bench.TOPICS['evaluation']}; "
        "raise SystemExit(main(['bench', '--list']))"
    )
    child = subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    child.stdout.close()
    error = child.stderr.read().decode()
    child.stderr.close()
    assert child.wait(timeout=120) == 0, error
    assert "BrokenPipe" not in error
