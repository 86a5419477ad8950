"""`wisar curves`: compare trainings by their validations."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from wisar_planner.evaluation.training_curves import TrainingCurve

_EXAMPLES = """\
examples:
  wisar curves out/train/sac-0 out/train/sac-1 out/train/sac-2
      mean and spread of three seeds
  wisar curves out/train/* --markdown out/curves.md --figure out/curves.png
      all runs, at equal samples and at equal time

  wisar curves out/train/sac-* --fresh-maps 2048
      judged on maps that chose nothing: neither the weights nor the best validation

Runs of one configuration that differ in the seed are one line of the table; where runs of one name
differ in more, their lines say in what."""


def add_parser(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        "curves",
        help="compare trainings: table and learning curves",
        description="Compare trainings by what they left in their folders.",
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("runs", nargs="+", type=Path, metavar="RUN", help="folder of a training")
    parser.add_argument(
        "--fresh-maps",
        type=int,
        metavar="N",
        help="fly each run's last policy on N maps that neither training nor validation meets; all "
        "are judged by the exact seen probability but the paper's",
    )
    parser.add_argument("--markdown", type=Path, metavar="FILE", help="write the table")
    parser.add_argument("--figure", type=Path, metavar="FILE", help="draw the curves, e.g. .png")
    parser.set_defaults(func=run)


def run(args: argparse.Namespace) -> int:
    """Print the table and write what was asked for."""
    from wisar_planner.cli.output_files import check_names, make_places
    from wisar_planner.cli.training_needs import require

    require("curves of trainings need PyTorch", "torch")
    from wisar_planner.evaluation.training_curves import check_seeds, draw, markdown, read_curve

    outputs = [
        (option, path, suffixes)
        for option, path, suffixes in (
            ("--figure", args.figure, (".png", ".pdf", ".svg")),
            ("--markdown", args.markdown, ()),
        )
        if path is not None
    ]
    kept = {
        f"the run's own {file}": file
        for folder in args.runs
        if folder.is_dir()
        for file in folder.iterdir()
    }
    check_names(kept, outputs)
    make_places((option, path) for option, path, _ in outputs)
    # A folder that is named twice, as by out/* and itself, is one run.
    folders = list({folder.resolve(): folder for folder in args.runs}.values())
    curves = [read_curve(folder) for folder in folders]
    check_seeds(curves)
    if args.fresh_maps is not None:
        curves = _flown(curves, folders, args.fresh_maps)
    table = markdown(curves)
    print(table, end="")
    if args.markdown:
        args.markdown.write_text(table, encoding="utf-8")
    if args.figure:
        draw(curves).savefig(args.figure, dpi=160)
    return 0


def _flown(
    curves: Sequence[TrainingCurve], folders: Sequence[Path], maps: int
) -> list[TrainingCurve]:
    """Return the curves with what the policies reach on fresh maps, with a progress bar."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn
    from rich.progress import TimeRemainingColumn as Remaining

    from wisar_planner.evaluation.training_curves import fly_fresh_maps

    columns = (TextColumn("flying"), BarColumn(), MofNCompleteColumn(), Remaining())
    with Progress(*columns, console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task("flying", total=len(curves) * maps)
        return [
            fly_fresh_maps(curve, folder, maps, lambda count: progress.advance(task, count))
            for curve, folder in zip(curves, folders, strict=True)
        ]
