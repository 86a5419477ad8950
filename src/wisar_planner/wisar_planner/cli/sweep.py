"""`wisar sweep`: the paper's parameter sweep over sizes of its network."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from wisar_planner.evaluation.sweep import Sweep, SweepRecord
    from wisar_planner.evaluation.sweep_store import SweepStore

_EXAMPLES = """\
examples:
  wisar sweep config/paper_sac.yaml --json out/sweep.json --figures out/sweep
      the paper's sweep; Ctrl-C and the same command again continues where it stopped
  wisar sweep config/paper_sac.yaml --samples 12 --steps 100000 --layers 1,4 --width 32,256 \\
      --path-features 16,128 --jobs 4 --json out/small.json --markdown out/small.md
      small networks
  wisar sweep config/paper_sac.yaml --dask tcp://10.0.0.1:8786 --resume out/sweep.jsonl
      on a Dask cluster; the samples stay in out/sweep.jsonl, and more can be added

Sample i of a seed depends on the seed and i alone, never on the number of samples or jobs."""

# What the paper's 39 runs in 12 days come to at the 275 steps per second of its training.
_PAPER_STEPS = 7_300_000


def add_parser(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        "sweep",
        help="train random sizes of the paper's network and say what matters",
        description="Train random sizes of the paper's network; regress e_p on them.",
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("config", type=Path, help="YAML file, for example config/paper_sac.yaml")
    what = parser.add_argument_group("what is sampled")
    what.add_argument("--samples", type=int, default=39, metavar="N", help="default: 39")
    what.add_argument("--seed", type=int, default=0, metavar="S", help="default: 0")
    what.add_argument(
        "--steps",
        type=int,
        default=_PAPER_STEPS,
        metavar="N",
        help="steps of training per sample (default: %(default)s)",
    )
    for name, meaning in (
        ("--layers", "layers of the core (default: 1,12)"),
        ("--width", "their width (default: 100,2000)"),
        ("--path-features", "features of the path (default: 100,1000)"),
    ):
        what.add_argument(name, type=_range, metavar="LOW,HIGH", help=meaning)
    what.add_argument(
        "--path-extractors", metavar="A,B,...", help="extractors of the path (default: all)"
    )
    output = parser.add_argument_group("results")
    output.add_argument("--json", type=Path, metavar="FILE", help="all numbers")
    output.add_argument("--markdown", type=Path, metavar="FILE", help="the tables")
    output.add_argument("--figures", type=Path, metavar="DIR", help="pictures")
    how = parser.add_argument_group("how it runs")
    how.add_argument(
        "--jobs", type=int, default=1, metavar="N", help="processes; -1 for all cores (default: 1)"
    )
    how.add_argument("--dask", metavar="ADDRESS", help="run on the Dask cluster of this scheduler")
    how.add_argument("--device", default="cpu", help="cpu (default) or cuda")
    how.add_argument(
        "--resume",
        type=Path,
        metavar="FILE",
        help="file of finished samples to continue and to keep; without it, unfinished sweeps are "
        "kept beside the --json file until all samples are finished",
    )
    parser.set_defaults(func=run)


def run(args: argparse.Namespace) -> int:
    """Run the sweep and write what was asked for."""
    from wisar_planner.cli.training_needs import checked_device, require

    require("a sweep needs PyTorch and statsmodels", "torch", "statsmodels")
    from wisar_planner.evaluation.sweep import Sweep
    from wisar_planner.evaluation.sweep_report import markdown, save_figures
    from wisar_planner.evaluation.sweep_statistics import summarise
    from wisar_planner.evaluation.sweep_store import SweepStore
    from wisar_planner.training.paper.config import read_paper_config

    checked_device(args.device)
    given = {
        "layers": args.layers,
        "width": args.width,
        "path_features": args.path_features,
        "path_extractors": args.path_extractors and tuple(args.path_extractors.split(",")),
    }
    sweep = Sweep(
        base=read_paper_config(args.config, steps=args.steps),
        samples=args.samples,
        seed=args.seed,
        **{name: value for name, value in given.items() if value},
    )
    _check_outputs(args)
    keep = args.resume or (args.json and args.json.with_name(args.json.name + ".samples.jsonl"))
    store = SweepStore(keep, sweep.common_setup()) if keep else None
    records = _with_progress(sweep, args, store)
    results = summarise(sweep, [each for each in records if each.e_p is not None])
    diverged = [str(each.index) for each in records if each.e_p is None]
    table = markdown(results)
    if diverged:
        table += f"\nDiverged, and left out of all of this: samples {', '.join(diverged)}.\n"
    print(table, end="")
    if args.json:
        told = {**results, "samples": [vars(each) for each in records]}
        _write(args.json, json.dumps(told, indent=1, allow_nan=False) + "\n")
    if args.markdown:
        _write(args.markdown, table)
    if args.figures:
        for path in save_figures(args.figures, results):
            print(path)
    if store is not None and not args.resume and (more := store.discard(e.index for e in records)):
        print(f"{more} more samples, not in these results, are kept in {keep}", file=sys.stderr)
    return 0


def _check_outputs(args: argparse.Namespace) -> None:
    """Refuse what cannot be written, or would overwrite what is read, before days of training."""
    from wisar_planner.cli.output_files import check_names, make_places

    read = {"the configuration": args.config, "--resume": args.resume}
    outputs = [
        (option, path)
        for option, path in (("--json", args.json), ("--markdown", args.markdown))
        if path is not None
    ]
    check_names(
        {name: path for name, path in read.items() if path is not None},
        [(option, path, ()) for option, path in outputs],
    )
    if args.figures:
        outputs.append(("--figures", args.figures / "path_extractor_p_values.png"))
    make_places(outputs)


def _with_progress(
    sweep: Sweep, args: argparse.Namespace, store: SweepStore | None
) -> list[SweepRecord]:
    """Run with a progress bar and a line for each sample on standard error."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn
    from rich.progress import TimeRemainingColumn as Remaining

    from wisar_planner.evaluation.sweep import run_sweep

    console = Console(stderr=True, highlight=False)
    columns = (TextColumn("samples"), BarColumn(), MofNCompleteColumn(), Remaining())
    with Progress(*columns, console=console) as progress:
        kept = {each["index"] for each in (store.records if store else ())}
        done = sum(index < sweep.samples for index in kept)
        task = progress.add_task("samples", total=sweep.samples, completed=done)

        def tell(record: SweepRecord) -> None:
            progress.advance(task)
            reached = "diverged" if record.e_p is None else f"e_p {record.e_p:.4f}"
            console.print(
                f"sample {record.index}: {record.layers} x {record.width}, "
                f"{record.path_features} features by {record.path_extractor}, "
                f"{reached} after {record.seconds / 60.0:.1f} min"
            )

        return run_sweep(
            sweep,
            jobs=args.jobs,
            dask=args.dask,
            device=args.device,
            store=store,
            on_record=tell,
        )


def _range(text: str) -> tuple[int, int]:
    try:
        low, high = (int(part) for part in text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not of the form LOW,HIGH") from None
    return low, high


def _write(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
