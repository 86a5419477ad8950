"""Finished samples of a sweep on disk: an append-only file that a sweep continues from."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from wisar_planner.errors import InvalidInput


class SweepStore:
    """Samples of one setup in a file of JSON lines, the setup first.

    Parameters
    ----------
    path : Path
        The file; made with the first sample if missing.
    setup : Mapping
        What all samples share, ready for JSON.

    Raises
    ------
    InvalidInput
        If the file holds samples of another setup, or is not such a file at all.
    """

    def __init__(self, path: Path, setup: Mapping[str, Any]) -> None:
        self.path = path
        self._setup = dict(setup)
        self.records: list[dict[str, Any]] = []
        if path.exists() and path.stat().st_size:
            self._read()

    def append(self, record: dict[str, Any]) -> None:
        """Add a finished sample."""
        self.path.parent.mkdir(parents=True, exist_ok=True)
        new = not self.path.exists() or self.path.stat().st_size == 0
        with self.path.open("a", encoding="utf-8") as file:
            if new:
                file.write(json.dumps({"sweep": self._setup}, allow_nan=False) + "\n")
            file.write(json.dumps(record, allow_nan=False) + "\n")
        self.records.append(record)

    def discard(self, told: Iterable[int]) -> int:
        """Remove the file, unless it has more samples than those told of by their indices.

        Returns
        -------
        int
            How many samples are in no results, and keep the file.
        """
        more = len({int(record["index"]) for record in self.records} - set(told))
        if not more:
            self.path.unlink(missing_ok=True)
        return more

    def _read(self) -> None:
        """Read what is there and cut off a last line that was not written to its end."""
        content = self.path.read_bytes()
        end = content.rfind(b"\n") + 1
        try:
            lines = [json.loads(line) for line in content[:end].splitlines()]
            found: dict[str, Any] = dict(lines[0]["sweep"])
        except (ValueError, KeyError, TypeError, IndexError):
            raise InvalidInput(
                f"{self.path} is not a file of a sweep's samples; name another"
            ) from None
        if found != self._setup:
            names = sorted({*found, *self._setup})
            differing = [name for name in names if found.get(name) != self._setup.get(name)]
            raise InvalidInput(
                f"{self.path} holds samples of another sweep ({', '.join(differing)} differ); "
                "name another file, or remove this one to start over"
            )
        self.records = lines[1:]
        if end < len(content):
            with self.path.open("r+b") as file:
                file.truncate(end)
