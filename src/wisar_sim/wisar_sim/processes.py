"""Starting the suite's executables as processes, and leaving none of them behind."""

from __future__ import annotations

import contextlib
import ctypes
import fcntl
import os
import random
import signal
import socket
import subprocess
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

from ament_index_python.packages import get_package_prefix

_PR_SET_PDEATHSIG = 1  # linux/prctl.h
_LIBC = ctypes.CDLL(None, use_errno=True)


class ProcessDied(RuntimeError):  # noqa: N818 - an event, not an error of the caller
    """A process ended that was to run on; the text names it and shows the end of its log."""


@contextlib.contextmanager
def only_one(name: str) -> Iterator[None]:
    """Wait until no other process holds this name, and hold it: for tests that share a thing."""
    with (Path(tempfile.gettempdir()) / f"wisar-{name}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def executable(package: str, name: str) -> Path:
    """Return where a package's executable is installed, as `ros2 run` would find it.

    Raises
    ------
    FileNotFoundError
        When the package has no such executable.
    """
    path = Path(get_package_prefix(package)) / "lib" / package / name
    if not path.is_file():
        raise FileNotFoundError(f"{package} has no executable {name}: run `make setup` ({path})")
    return path


def ros_arguments(
    parameters: Mapping[str, Any] | None = None,
    *,
    namespace: str | None = None,
    parameter_file: Path | None = None,
) -> list[str]:
    """Return command-line arguments that set a node's parameters and namespace."""
    arguments = ["--ros-args"]
    if namespace:
        arguments += ["-r", f"__ns:=/{namespace.strip('/')}"]
    if parameter_file is not None:
        arguments += ["--params-file", str(parameter_file)]
    for name, value in (parameters or {}).items():
        arguments += ["-p", f"{name}:={_yaml(value)}"]
    return arguments


def _yaml(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return "'" + value.replace("'", "''") + "'"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_yaml(v) for v in value) + "]"
    return repr(value)


#: Environment of processes that come and go, and may be killed: no shared memory between them. Fast
#: DDS finds the remains of killed participants there, and now and then a message is lost to them.
WITHOUT_SHARED_MEMORY = {"FASTDDS_BUILTIN_TRANSPORTS": "UDPv4"}


class RosDomain:
    """A ROS domain of this machine that nobody else uses while this object is open.

    Attributes
    ----------
    number : int
        The ROS_DOMAIN_ID, from 1 to 100; domains above 101 reach into Linux's ephemeral ports.
    """

    # RTPS 2.2, 9.6.1.1: a domain has the ports 7400 + 250 * domain and up. Participants count
    # from 10 on; the last one is far from ever being taken and serves as the reservation.
    _BASE, _PORTS_PER_DOMAIN = 7400, 250

    def __init__(self) -> None:
        numbers = list(range(1, 101))
        random.SystemRandom().shuffle(numbers)
        for self.number in numbers:
            self._reservation = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            first = self._BASE + self._PORTS_PER_DOMAIN * self.number
            try:
                self._reservation.bind(("127.0.0.1", first + self._PORTS_PER_DOMAIN - 1))
                return
            except OSError:
                self._reservation.close()
        raise RuntimeError("all ROS domains from 1 to 100 are in use on this machine")

    def close(self) -> None:
        """Give the domain back."""
        self._reservation.close()


def free_udp_port() -> int:
    """Return a UDP port of 127.0.0.1 that nobody uses."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


class ProcessGroup:
    """Processes that end together: on leaving the `with` block, however it is left.

    Each process leads a process group of its own, so that Ctrl-C in the terminal reaches only
    the caller, which then ends them in order. Should the caller itself be killed, the kernel
    ends them (PR_SET_PDEATHSIG).

    Parameters
    ----------
    log_folder : Path
        Where each process's output goes, as NAME.log.
    environment : mapping, optional
        Variables added to the caller's environment.
    """

    def __init__(self, log_folder: Path, environment: Mapping[str, str] | None = None) -> None:
        self._log_folder = log_folder
        self._environment = {**os.environ, **(environment or {})}
        self._processes: dict[str, subprocess.Popen[bytes]] = {}
        log_folder.mkdir(parents=True, exist_ok=True)

    def __enter__(self) -> ProcessGroup:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.stop()

    def start(self, name: str, command: Sequence[str | Path]) -> subprocess.Popen[bytes]:
        """Start a process; its output goes to NAME.log."""
        with self.log(name).open("ab") as log:
            process = subprocess.Popen(
                [str(part) for part in command],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                env=self._environment,
                start_new_session=True,
                preexec_fn=_end_with_parent,
            )
        self._processes[name] = process
        return process

    def log(self, name: str) -> Path:
        """Return where a process's output goes."""
        return self._log_folder / f"{name}.log"

    def check(self) -> None:
        """Raise ProcessDied when a process has ended by itself."""
        for name, process in self._processes.items():
            status = process.poll()
            if status is not None:
                lines = self.log(name).read_text(errors="replace").splitlines()[-15:]
                text = "\n  ".join(lines) if lines else "(it printed nothing)"
                raise ProcessDied(f"{name} ended with status {status}:\n  {text}")

    def kill(self, name: str) -> None:
        """Kill a process without giving it a chance to tidy up, and forget it."""
        process = self._processes.pop(name)
        _signal_group(process, signal.SIGKILL)
        process.wait()

    def stop(self, patience: float = 5.0) -> None:
        """End all processes: interrupt, and kill what still runs after `patience` seconds."""
        for process in self._processes.values():
            _signal_group(process, signal.SIGINT)
        deadline = time.monotonic() + patience
        for process in self._processes.values():
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(max(0.0, deadline - time.monotonic()))
        for process in self._processes.values():
            _signal_group(process, signal.SIGKILL)
            process.wait()
        self._processes.clear()


def _signal_group(process: subprocess.Popen[bytes], number: signal.Signals) -> None:
    """Signal a process and what it has started; one that is gone is no error."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, number)


def _end_with_parent() -> None:
    _LIBC.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
