"""Ctrl-C ends a node in order and without a traceback; wrong ROS arguments end it with a line."""

from __future__ import annotations

import contextlib
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

INTERRUPT = "import os, signal, time; os.kill(os.getpid(), signal.SIGINT); time.sleep(30)"
NODE = """
import rclpy
from rclpy.node import Node
from wisar_planner.nodes.runtime import spin

class Interrupted(Node):
    def __init__(self):
        super().__init__("interrupted")
        {early}

    def close(self):
        {late}
        print("closed", flush=True)

def main():
    return spin(Interrupted)
"""
WHEN_IDLE = "self.create_timer(0.1, lambda: os.kill(os.getpid(), signal.SIGINT))"
CASES = {
    "import": (f"{INTERRUPT}\n", ""),
    "construction": (NODE.format(early=INTERRUPT, late="pass"), ""),
    "spinning": (NODE.format(early=f"import os, signal; {WHEN_IDLE}", late="pass"), "closed\n"),
    "terminated": (
        NODE.format(early=f"import os, signal; {WHEN_IDLE}".replace("INT", "TERM"), late="pass"),
        "closed\n",
    ),
    "working": (
        NODE.format(
            early="""
        from std_msgs.msg import Empty
        publisher = self.create_publisher(Empty, "done", 1)

        def work():
            import os, signal, time
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(0.5)
            publisher.publish(Empty())
            print("worked", flush=True)

        self.create_timer(0.1, work)""",
            late="pass",
        ),
        "closed\nworked\n",
    ),
    "busy": (  # other callbacks go on coming while one is at work
        NODE.format(
            early="""
        import os, signal, time
        from rclpy.callback_groups import ReentrantCallbackGroup

        def work():
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(0.5)
            print("worked", flush=True)

        group = ReentrantCallbackGroup()
        self.create_timer(0.002, lambda: None, callback_group=group)
        self.timer = self.create_timer(0.1, lambda: (self.timer.cancel(), work()))""",
            late="pass",
        ),
        "closed\nworked\n",
    ),
    "closing": (
        NODE.format(
            early=f"import os, signal; {WHEN_IDLE}",
            late="import os, signal; os.kill(os.getpid(), signal.SIGINT)",
        ),
        "closed\n",
    ),
}


@pytest.mark.parametrize("when", CASES)
def test_ctrl_c_is_quiet(tmp_path: Path, when: str) -> None:
    source, output = CASES[when]
    (tmp_path / "interrupted.py").write_text(source)
    done = subprocess.run(
        [
            sys.executable,
            "-c",
            # Whoever started these tests may have them ignore Ctrl-C.
            "import signal; signal.signal(signal.SIGINT, signal.default_int_handler); "
            f"import sys; sys.path.insert(0, {str(tmp_path)!r}); "
            "from wisar_planner.nodes.entry import run; sys.exit(run('interrupted'))",
        ],
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, output, "")


# A message to itself, and nothing that becomes ready after it.
ONE_MESSAGE = """
        import os, threading, time
        from std_msgs.msg import Empty
        topic = f"to_{{os.getpid()}}"
        publisher = self.create_publisher(Empty, topic, 1)
        self.create_subscription(Empty, topic, lambda _: time.sleep(0.5) or {callback}, 1)
        threading.Timer(2.0, lambda: publisher.publish(Empty())).start()"""


@pytest.mark.parametrize(
    ("early", "error"),
    [
        ("self.create_timer(0.1, lambda: 1 / 0)", "ZeroDivisionError"),
        (ONE_MESSAGE.format(callback="1 / 0"), "ZeroDivisionError"),
        (ONE_MESSAGE.format(callback="exit('enough')"), "enough"),
    ],
)
def test_a_callback_that_fails_ends_the_node_and_says_why(
    tmp_path: Path, early: str, error: str
) -> None:
    (tmp_path / "failing.py").write_text(NODE.format(early=early, late="pass"))
    script = f"import sys; sys.path.insert(0, {str(tmp_path)!r}); import failing; failing.main()"
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, timeout=60
    )
    assert (done.returncode, done.stdout) == (1, "closed\n")
    assert error in done.stderr


AT_WORK = 'print("at work", flush=True) or time.sleep(60)'
ENDLESS = {
    "a callback": (f"import time; self.create_timer(0.1, lambda: {AT_WORK})", "pass"),
    "its end": (
        "self.create_timer(0.1, lambda: print('at work', flush=True))",
        "import time; time.sleep(60)",
    ),
    "a callback beside one that fails": (
        f"""
        import time
        from rclpy.callback_groups import ReentrantCallbackGroup
        group = ReentrantCallbackGroup()
        self.long = self.create_timer(
            0.1, lambda: self.long.cancel() or {AT_WORK}, callback_group=group
        )
        self.create_timer(0.5, lambda: 1 / 0, callback_group=group)""",
        "pass",
    ),
}


@contextlib.contextmanager
def started(folder: Path, source: str) -> Iterator[subprocess.Popen[str]]:
    """Start a node as a process that is gone afterwards."""
    (folder / "started.py").write_text(source)
    script = (
        "import signal; signal.signal(signal.SIGINT, signal.default_int_handler); "
        f"import sys; sys.path.insert(0, {str(folder)!r}); import started; sys.exit(started.main())"
    )
    pipe = subprocess.PIPE
    with subprocess.Popen(
        [sys.executable, "-c", script], stdout=pipe, stderr=pipe, text=True
    ) as process:
        try:
            yield process
        finally:
            process.kill()


@pytest.mark.parametrize("what", ENDLESS)
def test_a_node_ends_in_which_something_does_not_end(tmp_path: Path, what: str) -> None:
    early, late = ENDLESS[what]
    fails = "fails" in what  # which ends a node as Ctrl-C does
    with started(tmp_path, NODE.format(early=early, late=late)) as process:
        assert process.stdout.readline() == "at work\n"
        began = time.monotonic()
        if not fails:
            process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=50)
        assert time.monotonic() - began < 10.0
    assert process.returncode == int(fails)
    assert "told to end, the node still had work to do after 4 s" in errors
    assert ("ZeroDivisionError" in errors) == fails


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--params-file", "missing.yaml"], "missing.yaml"),
        (["--nonsense"], "--nonsense"),
        (["-p", "foo"], "-p foo"),
    ],
)
def test_wrong_ros_arguments_are_named(arguments: list[str], words: str) -> None:
    done = run_node("--ros-args", *arguments)
    assert done.returncode == 2
    assert words in done.stderr.splitlines()[-1]
    assert "Traceback" not in done.stderr


def run_node(*arguments: str) -> subprocess.CompletedProcess[str]:
    script = "import sys; from wisar_planner.nodes.runtime import spin; sys.exit(spin(object))"
    return subprocess.run(
        [sys.executable, "-c", script, *arguments], capture_output=True, text=True, timeout=60
    )


@pytest.mark.parametrize(
    "arguments",
    [
        ["-p", "map:=map.tif"],
        ["map:=map.tif"],
        ["map.tif", "--ros-args", "-p", "grid_cell:=5.0"],
        ["--ros-args", "-p", "grid_cell:=5.0", "--", "map.tif"],
    ],
)
def test_arguments_without_ros_args_are_refused(arguments: list[str]) -> None:
    done = run_node(*arguments)
    assert (done.returncode, done.stdout) == (2, "")
    (line,) = done.stderr.splitlines()
    assert "map.tif" in line
    assert "--ros-args" in line


def test_help_tells_what_the_node_does() -> None:
    script = "import sys; from wisar_planner.nodes.entry import pdm_server; sys.exit(pdm_server())"
    done = subprocess.run(
        [sys.executable, "-c", script, "--help"], capture_output=True, text=True, timeout=60
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith("usage: ")
    assert "--ros-args" in done.stdout
    assert "Publishes a probability map" in done.stdout


HEAVY = (
    "scipy.linalg",
    "scipy.ndimage",
    "scipy.optimize",
    "scipy.sparse",
    "scipy.special",
    "rasterio",
    "matplotlib",
    "torch",
)


@pytest.mark.parametrize("name", ["mavlink_bridge", "pdm_server", "planner"])
def test_a_node_starts_without_what_takes_long_to_import(name: str) -> None:
    """Each of these takes a node as long to import as half of all else together, or longer."""
    code = f"import sys, wisar_planner.nodes.{name}; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert set(HEAVY) & set(done.stdout.split()) == set()
