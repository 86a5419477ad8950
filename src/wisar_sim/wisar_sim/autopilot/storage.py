"""The file in which the simulated autopilot's missions survive a restart."""

from __future__ import annotations

import json
import struct
import tempfile
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any

from wisar_planner.errors import InvalidInput
from wisar_sim.autopilot.autopilot import Autopilot
from wisar_sim.autopilot.mission_server import KINDS, StoredItem

_ITEM = struct.Struct("<5f2iH2B")
"""What MISSION_ITEM_INT carries of an item: an item that does not fit was never uploaded."""


def save_lists(path: Path, autopilot: Autopilot) -> None:
    """Write mission, fence and rally points to a file, whole or not at all.

    Raises
    ------
    InvalidInput
        If the file cannot be written; what it held stays.
    """
    lists = {
        str(kind): [asdict(item) for item in items]
        for kind, items in autopilot.missions.lists.items()
    }
    file = path.resolve()  # a link stays one
    new = file.with_name(f"{file.name}.new")
    try:
        new.write_text(json.dumps(lists), encoding="utf-8")
        new.replace(file)
    except OSError as error:
        with suppress(OSError):
            new.unlink(missing_ok=True)
        raise InvalidInput(
            f"--storage: cannot write {path}: {error.strerror}; make room or name another file"
        ) from None


def load_lists(path: Path, autopilot: Autopilot) -> None:
    """Read what `save_lists` wrote; a missing file leaves the lists empty.

    Raises
    ------
    InvalidInput
        If the file is not one that `save_lists` wrote, or cannot be read, or could not be
        replaced later. The lists then are as they were.
    """
    try:
        # What is acknowledged later must find its place: better refused now than lost then.
        with tempfile.TemporaryFile(dir=path.resolve().parent):
            pass
        text = path.read_text(encoding="utf-8") if path.exists() else "{}"
        lists = _lists_of(json.loads(text))
    except OSError as error:
        raise InvalidInput(
            f"--storage: cannot use {path}: {error.strerror}; name a file in a folder that exists "
            "and can be written to"
        ) from None
    except (ValueError, TypeError, KeyError, OverflowError, struct.error):
        raise InvalidInput(
            f"--storage: {path} holds no missions of sim_autopilot; name another file or remove it"
        ) from None
    autopilot.missions.lists.update(lists)
    autopilot.vehicle.load(autopilot.missions.flight_items)


def _lists_of(content: Any) -> dict[int, tuple[StoredItem, ...]]:
    """Return the items by kind of list; what is none raises the error that it happens to meet."""
    if not isinstance(content, dict):
        raise TypeError("no object")
    lists = {int(kind): tuple(map(_item_of, rows)) for kind, rows in content.items()}
    if not lists.keys() <= set(KINDS):
        raise ValueError("a kind of list that is unknown")
    return lists


def _item_of(row: dict[str, Any]) -> StoredItem:
    item = StoredItem(**{**row, "params": tuple(row["params"])})
    numbers = (*item.params, item.z, item.x, item.y, item.command, item.frame, item.autocontinue)
    _ITEM.pack(*numbers)
    return item
