"""Which of several requests to the vehicle are carried out, and which are given up for others."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Iterator

from wisar_planner.mavlink.client import LinkError


class Requests:
    """Lets one request at a time go on, until one comes that waits for nothing.

    `MissionClient` does the same for each request of its own. A node that reads the mission back
    before such a request needs it for both together: a start must not follow a return to launch
    that was asked for while the mission was still being read.
    """

    def __init__(self) -> None:
        self._busy = threading.Lock()
        self._urgent = object()  # another one with every request that waits for nothing

    @contextlib.contextmanager
    def one(self, words: str) -> Iterator[Callable[[], None]]:
        """Make a request of several steps.

        Parameters
        ----------
        words : str
            What is asked for.

        Yields
        ------
        callable
            To be called between two steps; raises LinkError when the request is to be given up.

        Raises
        ------
        LinkError
            If another request is in progress.
        """
        before = self._urgent
        if not self._busy.acquire(blocking=False):
            raise LinkError(
                f"{words}: another request to the vehicle is in progress; wait for its answer"
            )

        def check() -> None:
            if self._urgent is not before:
                raise LinkError(f"{words}: given up, as pause or return_to_launch was asked for")

        try:
            yield check
        finally:
            self._busy.release()

    def give_up(self) -> None:
        """Let the request in progress end at its next step, for one that waits for nothing."""
        self._urgent = object()
