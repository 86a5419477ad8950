"""Finished runs on disk: an append-only file that an evaluation continues from.

One JSON object per line: first the setup, then finished runs and, before the first run of
a planner, the options that it was made with and the hash of its trained policy. A line is
written in one go as soon as its run is finished, so stopping at any moment loses the runs in
flight and no more.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from types import TracebackType
from typing import IO, Any

from wisar_planner.errors import InvalidInput
from wisar_planner.evaluation.run import MODEL_HASH, PlannerSpec, RunRecord

#: How the first line begins.
_HEADER = b'{"setup": '


def setup_digest(setup: Mapping[str, Any]) -> str:
    """Return a short name of a setup: equal setups have equal names."""
    text = json.dumps(setup, sort_keys=True, allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


class RunStore:
    """Runs of one setup in a file.

    The setup holds what all runs share; the number of runs and the list of planners are not
    part of it, so that an evaluation can be extended by either.

    Parameters
    ----------
    path : Path
        The file, or a folder, in which each setup has a file of its own. Made if missing.
    setup : Mapping
        What all runs share, ready for JSON.
    planners : sequence of PlannerSpec
        Planners whose runs are to be read and added.

    Raises
    ------
    InvalidInput
        If the file holds runs of another setup, of other options of a planner or of another
        trained policy, or is not such a file at all.
    """

    def __init__(
        self, path: Path, setup: Mapping[str, Any], planners: Sequence[PlannerSpec]
    ) -> None:
        if path.is_dir() or not path.suffix:
            path = path / f"runs-{setup_digest(setup)}.jsonl"
        self.path = path
        self.records: list[RunRecord] = []
        # All runs in the file, those of other planners, too.
        self._kept: set[tuple[str, int]] = set()
        self._setup = dict(setup)
        self._planners = {spec.name: spec.identity() for spec in planners}
        self._options: dict[str, dict[str, Any]] = {}
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
        self._read()
        self._file: IO[str] = path.open("a", encoding="utf-8")
        if path.stat().st_size == 0:
            self._write({"setup": self._setup})

    def append(self, records: Iterable[RunRecord]) -> None:
        """Add finished runs and hand them to the operating system."""
        for record in records:
            options = self._planners[record.planner]
            # A line of an earlier version, without the hash, is followed by one that has it.
            if self._options.get(record.planner) != options:
                self._write({"planner": record.planner, "options": options})
                self._options[record.planner] = options
            self._write({"run": asdict(record)})
            self._add(record)

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def discard(self, told: Iterable[RunRecord]) -> int:
        """Remove the closed file, unless it has more runs than have been told of.

        Parameters
        ----------
        told : iterable of RunRecord
            Runs that are in results by now.

        Returns
        -------
        int
            How many runs are in no results, and keep the file: of more maps, or of other planners.
        """
        more = len(self._kept - {(record.planner, record.index) for record in told})
        if not more:
            self.path.unlink(missing_ok=True)  # two worlds of the same values have one file
        return more

    def __enter__(self) -> RunStore:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()

    def _write(self, line: Mapping[str, Any]) -> None:
        self._file.write(json.dumps(line, allow_nan=False) + "\n")
        self._file.flush()

    def _read(self) -> None:
        """Read what is there and cut off a last line that was not written to its end."""
        content = self.path.read_bytes()
        end = content.rfind(b"\n") + 1
        for number, line in enumerate(content[:end].splitlines(), start=1):
            try:
                self._take(json.loads(line), number)
            except InvalidInput:
                raise  # Says itself what is wrong, and is a ValueError, too.
            except (KeyError, TypeError, AttributeError, ValueError) as error:
                raise InvalidInput(
                    f"{self.path}: line {number} is not a line of finished runs ({error}); "
                    "name another file"
                ) from None
        if end < len(content):
            # Someone else's file without a line end: better refuse than empty it.
            if end == 0 and not _HEADER.startswith(content[: len(_HEADER)]):
                raise InvalidInput(f"{self.path}: is not a file of finished runs; name another")
            with self.path.open("r+b") as file:
                file.truncate(end)

    def _take(self, line: Mapping[str, Any], number: int) -> None:
        if number == 1:
            self._check(line["setup"], self._setup, "setup")
        elif "planner" in line:
            name, options = line["planner"], line["options"]
            wanted = self._planners.get(name, options)
            if MODEL_HASH not in options:
                # Earlier versions kept none, so nobody knows which policy it was.
                wanted = {key: value for key, value in wanted.items() if key != MODEL_HASH}
            self._check(options, wanted, f"{name} with")
            self._options[name] = options
        else:
            self._add(RunRecord(**line["run"]))

    def _add(self, record: RunRecord) -> None:
        self._kept.add((record.planner, record.index))
        if record.planner in self._planners:
            self.records.append(record)

    def _check(self, found: Mapping[str, Any], wanted: Mapping[str, Any], what: str) -> None:
        """Refuse to mix runs that are not comparable, saying how they differ."""
        differences = [
            f"{key} is {found.get(key)!r} there and {wanted.get(key)!r} here"
            for key in sorted({*found, *wanted})
            if found.get(key) != wanted.get(key)
        ]
        if differences:
            raise InvalidInput(
                f"{self.path} holds runs of another setup: {what} {'; '.join(differences)}. "
                "Name another file, or remove this one to start over"
            )
