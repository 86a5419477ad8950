"""Starting and ending a node as a process."""

from __future__ import annotations

import contextlib
import signal
import sys
from collections.abc import Callable, Sequence
from typing import Protocol, cast

import rclpy
from rclpy.exceptions import (
    InvalidParameterException,
    InvalidParameterTypeException,
    InvalidParameterValueException,
)
from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor
from rclpy.node import Node
from rclpy.signals import uninstall_signal_handlers

from wisar_planner.errors import InvalidInput

_USER_MISTAKES = (
    InvalidInput,
    OSError,  # a file that is missing, a port that is taken
    InvalidParameterException,
    InvalidParameterTypeException,
    InvalidParameterValueException,
)


class Closeable(Protocol):
    """A node with threads or sockets of its own."""

    def close(self) -> None:
        """Stop them; called once, before the node is destroyed."""


def spin(factory: Callable[[], Node], arguments: Sequence[str] | None = None) -> int:
    """Run a node until Ctrl-C, SIGTERM or a shutdown of the context; return the exit status.

    A mistake in its arguments or parameters ends it with one line on stderr and status 2.
    """
    try:
        rclpy.init(args=arguments)
    except KeyboardInterrupt:
        return 0
    except RuntimeError as error:  # rclpy's errors have no public names
        text = " ".join(str(error).split(", at ")[0].split())
        print(f"{factory.__name__}: ROS arguments not understood: {text}", file=sys.stderr)
        return 2
    try:
        node = factory()
    except _USER_MISTAKES as error:
        print(f"{factory.__name__}: {error}", file=sys.stderr)
        _shut_down()
        return 2
    except KeyboardInterrupt:
        _shut_down()
        return 0
    except Exception:
        if rclpy.ok():
            raise
        return 0  # told to end while it was being made
    # Threads let a node answer (parameters, cancel requests) while a callback works.
    executor = MultiThreadedExecutor(num_threads=4)
    executor.add_node(node)
    try:
        executor.spin()
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        # A terminal and a launcher may both send the signal: once is enough.
        uninstall_signal_handlers()
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        if hasattr(node, "close"):
            cast(Closeable, node).close()
        executor.shutdown(timeout_sec=2.0)
        node.destroy_node()
        _shut_down()
    return 0


def _shut_down() -> None:
    """Shut ROS down, unless the handler of a signal, which runs beside, is ahead."""
    with contextlib.suppress(RuntimeError):
        rclpy.try_shutdown()
