"""Starting and ending a node as a process."""

from __future__ import annotations

import contextlib
import inspect
import os
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any, NoReturn, Protocol, cast

import rclpy
from rclpy.exceptions import (
    InvalidParameterException,
    InvalidParameterTypeException,
    InvalidParameterValueException,
)
from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Task
from rclpy.utilities import remove_ros_args

from wisar_planner.errors import InvalidInput

_USER_MISTAKES = (
    InvalidInput,
    OSError,  # a file that is missing, a port that is taken
    InvalidParameterException,
    InvalidParameterTypeException,
    InvalidParameterValueException,
)


# How long callbacks at work, and `close`, may each take to end, s.
_PATIENCE_S = 4.0


class Closeable(Protocol):
    """A node with threads or sockets of its own."""

    def close(self) -> None:
        """Stop them; called once, while callbacks still run, so that goals of actions can end.

        It runs in a thread of its own, since what it waits for may never end. What callbacks use
        is destroyed by `destroy_node`, after they have ended.
        """


class _Pool(ThreadPoolExecutor):
    """Threads for callbacks that tell at once when a callback has failed."""

    def __init__(self, threads: int, on_failure: Callable[[BaseException], None]) -> None:
        super().__init__(threads, thread_name_prefix="callback")
        self._on_failure = on_failure

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Run a callback in a thread."""

        def ended(future: Future[Any]) -> None:
            error = None if future.cancelled() else future.exception()
            # A task of rclpy keeps what its callback raised to itself.
            if error is None and isinstance(fn, Task) and fn.done():
                error = fn.exception()
            if error is not None:
                self._on_failure(error)

        future = super().submit(fn, *args, **kwargs)
        future.add_done_callback(ended)
        return future


class _Executor(MultiThreadedExecutor):
    """The executor, but that failures count at once and its shutdown waits for callbacks at work.

    rclpy looks for a callback that has failed only when the next one is ready, which may be
    never. It marks itself as shut down before it asks whether to wait, and so never does (Jazzy,
    7.1.5): the node was destroyed under its callbacks, which then failed or never ended.
    """

    def __init__(self, threads: int) -> None:
        super().__init__(num_threads=threads)
        self.failure: BaseException | None = None
        """What the first callback that failed has raised; it ends `spin`."""
        self._executor = _Pool(threads, self._on_failure)

    def _on_failure(self, error: BaseException) -> None:
        self.failure = self.failure or error
        self.stop()

    def stop(self) -> None:
        """Begin no more callbacks: `spin` returns."""
        with self._shutdown_lock:
            self._is_shutdown = True
            if self._guard is not None:  # a late failure, after `shutdown`
                self._guard.trigger()

    def finish_tasks(self, spinning: threading.Thread, timeout_s: float) -> bool:
        """Wait, while a thread spins, until what was begun beside callbacks has ended.

        Goals of actions and the sending of their results are such tasks; rclpy's own account of
        work leaves them out. Return whether none is at work any more.
        """
        deadline = time.monotonic() + timeout_s
        while spinning.is_alive() and self._tasks_left() and time.monotonic() < deadline:
            time.sleep(0.01)
        return not any(task.executing() for task in self._tasks_left())

    def _tasks_left(self) -> list[Task]:
        with self._tasks_lock:
            return [task for task, entity, _ in self._tasks if entity is None and not task.done()]

    def shutdown(self, timeout_sec: float | None = None) -> bool:
        """Wait for callbacks at work, after `stop` and `spin`; return whether they ended."""
        self._executor.shutdown(wait=False, cancel_futures=True)
        ended = self._work_tracker.wait(timeout_sec)
        return super().shutdown(timeout_sec) and ended


def spin(factory: Callable[[], Node], arguments: Sequence[str] | None = None) -> int:
    """Run a node until Ctrl-C, SIGTERM or a shutdown of the context; return the exit status.

    A mistake in its arguments or parameters ends it with one line on stderr and status 2. Callbacks
    at work when it is told to end come to their end first, so that nothing is sent in halves. Where
    they take longer than some seconds, this is logged and the process ends without them.

    Parameters
    ----------
    factory : callable
        The node's class; its docstring is what `--help` prints.
    arguments : sequence of str, optional
        Command line, the program's name first; the process's own unless given.
    """
    arguments = sys.argv if arguments is None else arguments
    try:
        # rclpy's own handlers would shut ROS down under callbacks at work.
        rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
    except KeyboardInterrupt:
        return 0
    except RuntimeError as error:  # rclpy's errors have no public names
        text = " ".join(str(error).split(", at ")[0].split())
        print(f"{factory.__name__}: ROS arguments not understood: {text}", file=sys.stderr)
        return 2
    rest = remove_ros_args(arguments)[1:]
    if rest:
        rclpy.try_shutdown()
        if {"-h", "--help"} & set(rest):
            print(_usage(factory, arguments[0]))
            return 0
        # `-p NAME:=VALUE` without `--ros-args` would start the node with its defaults.
        print(
            f"{factory.__name__}: arguments not understood: {' '.join(rest)} "
            "(parameters and the like stand after --ros-args; see --help)",
            file=sys.stderr,
        )
        return 2
    try:
        node = factory()
        told_to_end = threading.Event()
        for each in (signal.SIGINT, signal.SIGTERM):
            signal.signal(each, lambda *_: told_to_end.set())
    except _USER_MISTAKES as error:
        print(f"{factory.__name__}: {error}", file=sys.stderr)
        rclpy.try_shutdown()
        return 2
    except KeyboardInterrupt:
        rclpy.try_shutdown()
        return 0
    failure, ended = _spin_until(node, told_to_end)
    if not ended:
        _leave(failure)
    rclpy.try_shutdown()
    if failure is not None:
        raise failure
    return 0


def _usage(factory: Callable[[], Node], program: str) -> str:
    return (
        f"usage: {Path(program).name} [--ros-args [-p NAME:=VALUE] [--params-file FILE] "
        "[-r FROM:=TO] ...]\n\n"
        f"{inspect.getdoc(factory) or factory.__name__}\n\n"
        "Parameters, with meaning and range: ros2 param describe NODE NAME, or the package's README"
    )


def _leave(failure: BaseException | None) -> NoReturn:
    """End the process with threads at work, for which Python would wait at its exit for ever."""
    if failure is not None:
        traceback.print_exception(failure)
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError):  # a reader that has gone
            stream.flush()
    os._exit(0 if failure is None else 1)


def _spin_until(node: Node, told_to_end: threading.Event) -> tuple[BaseException | None, bool]:
    """Spin a node in a thread and end it in order when told to.

    Return what a callback raised, and whether all that was at work has ended.
    """
    # Threads let a node answer (parameters, cancel requests) while a callback works.
    executor = _Executor(threads=4)
    executor.add_node(node)

    def work() -> None:
        try:
            executor.spin()
        except ExternalShutdownException:
            pass
        except BaseException as error:
            executor.failure = executor.failure or error
        finally:
            told_to_end.set()

    spinning = threading.Thread(target=work, name="spin", daemon=True)
    spinning.start()
    # Signal handlers run in this thread.
    told_to_end.wait()
    # A terminal and a launcher may both send Ctrl-C: once is enough. SIGTERM once more is in
    # earnest.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    closing = threading.Thread(target=_close, args=(node, executor), name="close", daemon=True)
    closing.start()
    closing.join(_PATIENCE_S)
    finished = executor.finish_tasks(spinning, _PATIENCE_S)
    # The pool of threads must not end before what hands it work.
    executor.stop()
    spinning.join(_PATIENCE_S)
    ended = finished and not spinning.is_alive() and executor.shutdown(timeout_sec=_PATIENCE_S)
    ended = ended and not closing.is_alive()
    if ended:
        node.destroy_node()
    else:
        node.get_logger().error(
            f"told to end, the node still had work to do after {_PATIENCE_S:g} s: it ends without "
            "finishing that"
        )
    return executor.failure, ended


def _close(node: Node, executor: _Executor) -> None:
    """Close a node that has something to close; what that raises counts as a callback's failure."""
    try:
        if hasattr(node, "close"):
            cast(Closeable, node).close()
    except BaseException as error:
        executor.failure = executor.failure or error
