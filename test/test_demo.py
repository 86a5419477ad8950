"""`make demo` as a person runs it: it ends by itself, and nothing is left running."""

from __future__ import annotations

import functools
import importlib
import io
import json
import os
import signal
import subprocess
import sys
import time
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
import shapely
from matplotlib import image
from rich.console import Console

ROOT = Path(__file__).resolve().parent.parent
DEMO = [sys.executable, str(ROOT / "scripts" / "demo.py"), "--planner", "lhc_gw_conv"]

MAKE_MAP = ROOT / "scripts" / "make_demo_map.py"


@pytest.fixture
def out(tmp_path: Path) -> Path:
    return tmp_path / "out"


@functools.cache
def load_demo() -> ModuleType:
    """Return the script as a module, for what it refuses before it starts anything."""
    sys.path.insert(0, str(ROOT / "scripts"))
    try:
        return importlib.import_module("demo")
    finally:
        sys.path.pop(0)


def nodes_of(out: Path) -> dict[int, str]:
    """Return pid and command line of the processes that were started for this demo."""
    mine = {}
    for process in Path("/proc").glob("[0-9]*"):
        try:
            if f"WISAR_DEMO={out}".encode() in (process / "environ").read_bytes().split(b"\0"):
                command = (process / "cmdline").read_text().replace("\0", " ")
                mine[int(process.name)] = command
        except OSError:
            continue
    return mine


def start(out: Path, *arguments: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [*DEMO, "--out", str(out), *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        # The mark that all its processes inherit.
        env={**os.environ, "WISAR_DEMO": str(out)},
    )


def wait_for_node(out: Path, name: str) -> int:
    """Wait until the demo has started a node; return its pid."""
    deadline = time.monotonic() + 60.0
    while time.monotonic() < deadline:
        for pid, command in nodes_of(out).items():
            if f"/{name} " in command:
                return pid
        time.sleep(0.05)
    pytest.fail(f"{name} was not started")


def test_it_goes_from_a_map_to_a_mission(out: Path) -> None:
    demo = start(out, "--budget", "3000")
    stdout, stderr = demo.communicate(timeout=170)
    assert demo.returncode == 0, stderr
    assert nodes_of(out) == {}
    assert "items accepted by PX4, read back and equal" in " ".join(stdout.split())
    numbers = json.loads((out / "numbers.json").read_text())
    plan, flight, mission = numbers["plan"], numbers["flight"], numbers["mission"]
    assert 0.0 < plan["probability_efficiency"] <= plan["upper_bound"]
    assert plan["length_m"] <= 3000.0
    assert flight["distance_m"] == pytest.approx(plan["length_m"])
    assert abs(flight["difference_to_plan"]) < 1e-3
    assert mission["items_accepted"] == plan["waypoints"] + 3

    geojson = json.loads((out / "plan.geojson").read_text())
    lines = [shapely.geometry.shape(f["geometry"]) for f in geojson["features"]]
    assert any(line.geom_type == "LineString" for line in lines)
    west, south, east, north = shapely.total_bounds(lines)
    assert -8.0 < west < east < 0.0  # the Scottish Highlands
    assert 56.0 < south < north < 59.0
    qgc = json.loads((out / "plan.plan").read_text())
    assert qgc["fileType"] == "Plan"
    assert len(qgc["mission"]["items"]) == mission["items_accepted"]
    picture = image.imread(out / "picture.png")
    assert picture.shape[1] > 1000
    assert picture[..., :3].std() > 0.05  # not blank


def test_the_files_of_the_user_are_kept(out: Path) -> None:
    out.mkdir()
    subprocess.run([sys.executable, MAKE_MAP, "--out", out / "map.tif", "--seed", "1"], check=True)
    before = (out / "map.tif").read_bytes()
    # A demo without --map makes one of another name.
    assert load_demo().parse(["--out", str(out)]).map not in out.iterdir()
    logs = out / "logs"
    logs.mkdir()
    (logs / "search.log").write_text("a day's work")
    (logs / "planner.log").write_text("of the last demo\n")
    demo = start(out, "--map", str(out / "map.tif"))
    wait_for_node(out, "sim_drone")  # the last to be started
    demo.send_signal(signal.SIGINT)
    _, stderr = demo.communicate(timeout=30)
    assert demo.returncode == 130, stderr
    assert (out / "map.tif").read_bytes() == before
    assert (logs / "search.log").read_text() == "a day's work"
    assert "of the last demo" not in (logs / "planner.log").read_text()
    # Every log that a demo writes is one that the next removes.
    own = {f"{node}.log" for node in load_demo().NODES}
    assert {file.name for file in logs.iterdir()} == {"search.log", *own}


@pytest.mark.parametrize("name", ["plan.geojson", "numbers.json"])
def test_a_map_that_would_be_overwritten_is_refused(
    name: str, out: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out.mkdir()
    path = out / name
    path.write_text("{}")
    assert load_demo().main(["--map", str(path), "--out", str(out)]) == 2
    error = capsys.readouterr().err
    assert f"--map: the demo would overwrite {path}" in error
    assert error.count("\n") == 1
    assert [file.name for file in out.iterdir()] == [name]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--step", "0"), "--step"),
        (("--step", "nan"), "--step"),
        (("--speed", "0"), "--speed"),
        (("--speed", "inf"), "--speed"),
        (("--swath-radius", "-1"), "--swath-radius"),
        (("--altitude", "0"), "--altitude"),
        (("--budget", "inf"), "--budget"),
        (("--budget", "49.9"), "--step"),
    ],
)
def test_numbers_that_cannot_be_are_refused_before_anything_is_started(
    options: tuple[str, str], words: str, out: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert load_demo().main([*options, "--out", str(out)]) == 2
    error = capsys.readouterr().err
    assert words in error
    assert error.count("\n") == 1
    assert not out.exists()


def blocked_folder(out: Path) -> str:
    out.write_text("no folder")
    return "--out"


def blocked_map(out: Path) -> str:
    (out / "demo_map.tif").mkdir(parents=True)
    return "--map"


@pytest.mark.parametrize("block", [blocked_folder, blocked_map])
def test_a_folder_that_cannot_be_used_is_told_in_one_line(
    block: Callable[[Path], str], out: Path
) -> None:
    words = block(out)
    demo = start(out)
    _, stderr = demo.communicate(timeout=60)
    assert demo.returncode == 1
    assert words in stderr
    assert stderr.count("\n") == 1
    assert not list(out.glob("logs/*.log"))  # nothing was started


def test_names_with_brackets_are_shown_as_they_are() -> None:
    numbers: dict[str, Any] = defaultdict(float)
    summary = {
        "map": {"file": "/maps/glen [bold] [0].tif", "components": 3},
        "plan": numbers | {"planner": "greedy"},
        "flight": numbers,
        "mission": {"items_accepted": 5, "autopilot": "PX4"},
        "files": {"Picture": "out[/0]/picture.png"},
        "elapsed_s": 1.0,
    }
    console = Console(width=200, record=True, file=io.StringIO())
    console.print(load_demo().last_screen(summary))
    text = console.export_text()
    assert "glen [bold] [0].tif, 3 components" in text
    assert "out[/0]/picture.png" in text


def test_ctrl_c_leaves_nothing_running(out: Path) -> None:
    demo = start(out)
    wait_for_node(out, "mavlink_bridge")
    demo.send_signal(signal.SIGINT)
    stdout, stderr = demo.communicate(timeout=30)
    assert demo.returncode == 130, stderr
    assert "Traceback" not in stderr
    assert "nothing is left running" in stdout
    assert nodes_of(out) == {}


def test_a_node_that_dies_ends_the_demo_with_its_name(out: Path) -> None:
    demo = start(out)
    os.kill(wait_for_node(out, "planner"), signal.SIGKILL)
    stdout, stderr = demo.communicate(timeout=60)
    assert demo.returncode == 1, stdout
    assert "planner ended with status -9" in stderr
    assert "Traceback" not in stderr
    assert nodes_of(out) == {}
