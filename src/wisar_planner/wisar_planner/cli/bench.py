"""`wisar bench`: measure the speed and reliability of this installation."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from wisar_planner.evaluation.bench_row import BenchRow

# Rows that cannot be measured without it.
_NEED_TORCH = ("training_environment_steps", "training_samples", "training_share_of_bound")

_EXAMPLES = """\
examples:
  wisar bench --list                   the rows by topic
  wisar bench --only search,mavlink    two topics
  wisar bench --only mission_upload_loss_30 --json out.json
                                       one row

Both sides of a row are measured in this run; a ratio above 1 means that ours is better."""


def add_parser(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        "bench",
        help="measure speed and reliability, side by side with peers",
        description="Measure this installation, side by side with other libraries.",
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "--only", default="", metavar="A,B,...", help="topics or rows (default: all)"
    )
    parser.add_argument("--list", action="store_true", help="list topics and rows, measure nothing")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the rows")
    parser.set_defaults(func=run)


def run(args: argparse.Namespace) -> int:
    """Measure and report the rows."""
    from rich.console import Console

    from wisar_planner.evaluation.bench import (
        TOPICS,
        machine,
        measure,
        row_to_json,
        rows_of,
        select_rows,
    )

    if args.list:
        for topic in TOPICS:
            print(f"{topic}: {', '.join(rows_of(topic))}")
        return 0
    selected = select_rows([name.strip() for name in args.only.split(",") if name.strip()])
    _check(selected, args.json)
    rows: list[BenchRow] = []
    progress = Console(stderr=True, highlight=False)
    for name, row in zip(selected, measure(selected), strict=True):
        progress.print(f"{name}: {_number(row.ours)} {row.unit}")
        rows.append(row)
    _print_table(rows)
    if args.json:
        content = {"machine": machine(), "rows": [row_to_json(row) for row in rows]}
        args.json.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    return 0


def _check(selected: Iterable[str], json_file: Path | None) -> None:
    """Refuse what would fail after minutes of measuring, and lose them."""
    from wisar_planner.cli.output_files import check_names, make_places
    from wisar_planner.cli.training_needs import require
    from wisar_planner.evaluation.bench import TOPICS

    if any(name in _NEED_TORCH for name in selected):
        others = ",".join(topic for topic in TOPICS if topic != "training")
        require(f"training (left out with --only {others}) needs PyTorch", "torch")
    if json_file is not None:
        check_names({}, [("--json", json_file, ())])
        make_places([("--json", json_file)])


def _print_table(rows: list[BenchRow]) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table(box=None, header_style="bold", pad_edge=False)
    for header, justify in (
        ("row", "left"),
        ("ours", "right"),
        ("peer", "right"),
        ("unit", "left"),
        ("times better", "right"),
        ("peer's name", "left"),
    ):
        table.add_column(header, justify=justify)  # type: ignore[arg-type]
    for row in rows:
        table.add_row(
            row.name,
            _number(row.ours),
            "" if row.peer is None else _number(row.peer),
            row.unit,
            "" if row.ratio is None else f"{row.ratio:.3g}",
            row.peer_name or "",
        )
    console = Console() if sys.stdout.isatty() else Console(width=140)
    console.print(table)


def _number(value: float) -> str:
    return f"{value:,.0f}" if abs(value) >= 1000 else f"{value:.4g}"
