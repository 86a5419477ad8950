"""Processes that end together, however their owner ends."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from wisar_sim.processes import ProcessDied, ProcessGroup, RosDomain, ros_arguments

SLEEPER = [sys.executable, "-c", "import time; time.sleep(600)"]
STUBBORN = [
    sys.executable,
    "-c",
    "import signal, time; signal.signal(signal.SIGINT, signal.SIG_IGN); time.sleep(600)",
]


def is_running(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    # A zombie has ended, it only waits to be reaped.
    return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"


def test_leaving_the_block_ends_them_all(tmp_path: Path) -> None:
    with pytest.raises(KeyError), ProcessGroup(tmp_path) as group:
        pids = [group.start("a", SLEEPER).pid, group.start("b", SLEEPER).pid]
        assert all(map(is_running, pids))
        raise KeyError
    assert not any(map(is_running, pids))


def test_one_that_ignores_the_interrupt_is_killed(tmp_path: Path) -> None:
    group = ProcessGroup(tmp_path)
    pid = group.start("stubborn", STUBBORN).pid
    time.sleep(0.5)
    group.stop(patience=0.5)
    assert not is_running(pid)


def test_a_dead_process_is_reported_with_the_end_of_its_log(tmp_path: Path) -> None:
    with ProcessGroup(tmp_path) as group:
        group.start("node", [sys.executable, "-c", "print('out of fuel'); raise SystemExit(3)"])
        with pytest.raises(ProcessDied, match=r"node ended with status 3(.|\n)*out of fuel"):
            for _ in range(200):
                group.check()
                time.sleep(0.05)


def test_a_killed_owner_leaves_nothing_behind(tmp_path: Path) -> None:
    owner = subprocess.Popen(
        [
            sys.executable,
            "-c",
            "import sys, time; from pathlib import Path; from wisar_sim.processes import *;"
            f"g = ProcessGroup(Path({str(tmp_path)!r})); p = g.start('a', {SLEEPER!r});"
            "print(p.pid, flush=True); time.sleep(600)",
        ],
        stdout=subprocess.PIPE,
        text=True,
    )
    assert owner.stdout is not None
    pid = int(owner.stdout.readline())
    owner.send_signal(signal.SIGKILL)
    owner.wait()
    deadline = time.monotonic() + 10.0
    while is_running(pid):
        assert time.monotonic() < deadline, "the child outlived its killed owner"
        time.sleep(0.05)


def test_a_domain_is_given_to_one_only() -> None:
    domains = [RosDomain() for _ in range(20)]
    assert len({domain.number for domain in domains}) == 20
    for domain in domains:
        domain.close()


def test_parameters_are_written_as_yaml() -> None:
    assert ros_arguments({"a": "it's", "b": True, "c": 1.0, "d": [0.5, 2.0]}, namespace="x") == [
        "--ros-args",
        *("-r", "__ns:=/x"),
        *("-p", "a:='it''s'"),
        *("-p", "b:=true"),
        *("-p", "c:=1.0"),
        *("-p", "d:=[0.5, 2.0]"),
    ]
