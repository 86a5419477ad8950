"""The executables of this package's nodes: they import little, so that Ctrl-C is heeded at once."""

from __future__ import annotations

import os
import signal
from functools import partial
from importlib import import_module


def run(module: str) -> int:
    """Import a module and run its `main`; return the exit status.

    Ctrl-C during the import, which takes a second or more, ends the process without a traceback:
    nothing has begun yet that would have to be ended in order.
    """
    default = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if default:
        signal.signal(signal.SIGINT, lambda *_: os._exit(0))
    main = import_module(module).main
    if default:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    return int(main())


pdm_server = partial(run, "wisar_planner.nodes.pdm_server")
planner = partial(run, "wisar_planner.nodes.planner")
mavlink_bridge = partial(run, "wisar_planner.nodes.mavlink_bridge")
