"""Speed and reliability benchmarks: the rows of ``wisar bench``.

Each topic is a module of this package with a table ``ROWS`` from a row's name to
the function that measures it. The modules are imported only when a row of theirs
is asked for, because some need libraries that nothing else does.
"""

from __future__ import annotations

import importlib
import os
import platform
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from wisar_planner.errors import InvalidInput
from wisar_planner.evaluation.bench_row import BenchRow

TOPICS: Mapping[str, str] = {
    "search": "wisar_planner.evaluation.bench_search",
    "mavlink": "wisar_planner.evaluation.bench_mavlink",
    "evaluation": "wisar_planner.evaluation.bench_evaluation",
    "training": "wisar_planner.evaluation.bench_training",
}


RowFunction = Callable[[], BenchRow]


def rows_of(topic: str) -> Mapping[str, RowFunction]:
    """Return the rows that a topic offers.

    Raises
    ------
    InvalidInput
        If there is no such topic.
    """
    if topic not in TOPICS:
        raise InvalidInput(f"topic: {topic!r} is unknown; choose from {', '.join(TOPICS)}")
    rows: Mapping[str, RowFunction] = importlib.import_module(TOPICS[topic]).ROWS
    return rows


def select_rows(only: Sequence[str] = ()) -> dict[str, RowFunction]:
    """Return the rows of the topics or with the names in `only`; all where it is empty.

    Raises
    ------
    InvalidInput
        If a name is neither a topic nor a row.
    """
    topics = [name for name in only if name in TOPICS]
    names = [name for name in only if name not in TOPICS]
    selected: dict[str, RowFunction] = {}
    for topic in topics if only else TOPICS:
        selected.update(rows_of(topic))
    if names:
        everything = {name: row for topic in TOPICS for name, row in rows_of(topic).items()}
        for name in names:
            if name not in everything:
                known = ", ".join((*TOPICS, *everything))
                raise InvalidInput(f"only: {name!r} is neither a topic nor a row; known: {known}")
            selected[name] = everything[name]
    return selected


def measure(rows: Mapping[str, RowFunction]) -> Iterator[BenchRow]:
    """Measure the rows one after the other, so that none disturbs another."""
    for row in rows.values():
        yield row()


def row_to_json(row: BenchRow) -> dict[str, Any]:
    """Return a row as a flat JSON object, its details beside the fixed keys."""
    content = asdict(row)
    details: dict[str, Any] = content.pop("details")
    return {**content, **details}


def machine() -> dict[str, Any]:
    """Return what the figures were measured on."""
    return {
        "processor": _processor(),
        "cores": os.cpu_count(),
        "python": platform.python_version(),
        "system": platform.platform(terse=True),
    }


def _processor() -> str:
    """Return the processor's name, from where Linux keeps it."""
    information = Path("/proc/cpuinfo")
    if information.exists():
        for line in information.read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()
