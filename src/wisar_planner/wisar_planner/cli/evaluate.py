"""`wisar evaluate`: compare planners on the same maps."""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from wisar_planner.evaluation.run import PlannerSpec, RunRecord
    from wisar_planner.evaluation.runner import Evaluation
    from wisar_planner.evaluation.scenario import Scenario, StartRule

_EXAMPLES = """\
examples:
  wisar evaluate --planner lawnmower,lhc_gw_conv,greedy --runs 1000 --json out.json
      the paper's setup; Ctrl-C and the same command again continues where it stopped
  wisar evaluate --planner greedy,lookahead --option lookahead.time_budget_s=0.5 --runs 200 \\
      --figures out/figures --markdown out/table.md
      an option of one planner, figures, and a table beside the paper's numbers
  wisar evaluate --planner greedy --runs 10000 --resume out/runs.jsonl --dask tcp://10.0.0.1:8786
      on a Dask cluster; the runs stay in out/runs.jsonl, and more runs or planners can be added
  wisar evaluate --planner lawnmower,greedy --map map.tif --start centre --runs 1 \\
      --step 64 --swath-radius 33 --budget 100000
      one search on a map from a GIS
  wisar evaluate --worlds config/worlds.yaml --planner greedy,lookahead --runs 20 --json out.json
      small and large areas, budgets and swaths, few and many modes, rasters, real maps

Map i of a seed depends on the seed and i alone, never on the number of runs, jobs or planners."""


def add_parser(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        "evaluate",
        help="compare planners on the same maps",
        description="Let planners search the same random maps and report how well they do.",
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    what = parser.add_argument_group("what is compared")
    what.add_argument(
        "--planner",
        default="lawnmower,lhc_gw_conv,greedy",
        metavar="A,B,...",
        help="planners, separated by commas (default: %(default)s)",
    )
    what.add_argument(
        "--option",
        action="append",
        default=[],
        metavar="PLANNER.OPTION=VALUE",
        help="an option of a planner; may be given several times",
    )
    what.add_argument("--runs", type=int, default=100, metavar="N", help="maps (default: 100)")
    what.add_argument("--seed", type=int, default=0, metavar="S", help="seed (default: 0)")
    what.add_argument(
        "--persons",
        type=int,
        default=1000,
        metavar="P",
        help="missing persons drawn inside the area of each map (default: 1000)",
    )
    setup = parser.add_argument_group("maps and drone", "the paper's setup unless given")
    setup.add_argument("--config", type=Path, metavar="FILE", help="ROS 2 parameter file")
    setup.add_argument(
        "--map",
        type=Path,
        metavar="FILE",
        help="this map instead of random ones: .tif, .geojson or .yaml",
    )
    setup.add_argument(
        "--area", type=Path, metavar="FILE", help="GeoJSON polygon to search on the --map"
    )
    setup.add_argument("--step", type=float, metavar="M", help="distance between waypoints, m")
    setup.add_argument(
        "--swath-radius", type=float, metavar="M", help="half the width that is seen, m"
    )
    setup.add_argument("--budget", type=float, metavar="M", help="longest path, m")
    setup.add_argument(
        "--start",
        default="uniform",
        metavar="WHERE",
        help="uniform in the area (default), peak, centre, or a point: X,Y in metres, "
        "LAT,LON in degrees on a --map",
    )
    worlds = parser.add_argument_group("several worlds", "one table, a row a world")
    worlds.add_argument(
        "--worlds", type=Path, metavar="FILE", help="YAML file of worlds, see config/worlds.yaml"
    )
    worlds.add_argument("--world", metavar="A,B,...", help="these worlds of the file; all if not")
    worlds.add_argument(
        "--world-maps", type=Path, metavar="DIR", help="folder of the GIS maps that the file names"
    )
    output = parser.add_argument_group("results")
    output.add_argument("--json", type=Path, metavar="FILE", help="all numbers")
    output.add_argument("--markdown", type=Path, metavar="FILE", help="the table")
    output.add_argument(
        "--gap",
        action="store_true",
        help="what each planner loses to transit, low ground, turns and overlap, beside the table",
    )
    output.add_argument("--figures", type=Path, metavar="DIR", help="pictures")
    how = parser.add_argument_group("how it runs")
    how.add_argument(
        "--jobs", type=int, default=-1, metavar="N", help="processes; -1 for all cores (default)"
    )
    how.add_argument("--dask", metavar="ADDRESS", help="run on the Dask cluster of this scheduler")
    how.add_argument(
        "--resume",
        type=Path,
        metavar="PATH",
        help="file (or folder with a file per setup) of finished runs to continue and to keep; "
        "without it, unfinished runs are kept beside the --json file until all are finished",
    )
    parser.set_defaults(func=run)


def run(args: argparse.Namespace) -> int:
    """Run the evaluation and write what was asked for."""
    from wisar_planner.errors import InvalidInput
    from wisar_planner.evaluation.runner import Evaluation
    from wisar_planner.evaluation.store import RunStore
    from wisar_planner.evaluation.summary import summarise
    from wisar_planner.evaluation.tables import markdown

    # Here once: what is left to do after runs that were all stored would fail in joblib's words.
    if args.jobs == 0:
        raise InvalidInput("--jobs must be at least 1, or -1 for one process per core, not 0")
    planners = planner_specs(args.planner, args.option)
    _check_outputs(args)
    if args.worlds:
        from wisar_planner.cli.evaluate_worlds import run_worlds

        return run_worlds(args, planners)
    if args.world or args.world_maps:
        raise InvalidInput("--world and --world-maps need --worlds")
    evaluation = Evaluation(
        planners=planners,
        runs=args.runs,
        seed=args.seed,
        persons=args.persons,
        scenario=_scenario(args),
    )
    keep = args.resume or (args.json and args.json.with_name(args.json.name + ".runs.jsonl"))
    store = None
    if keep is None:
        records = _with_progress(evaluation, args, None)
    else:
        with RunStore(keep, evaluation.common_setup(), evaluation.planners) as store:
            records = _with_progress(evaluation, args, store)
    results = summarise(evaluation, records)
    _print_table(results)
    table = markdown(results)
    if args.gap:
        from wisar_planner.evaluation.gap import gap_markdown, summarise_gap

        results["gap"] = summarise_gap(evaluation, records, jobs=args.jobs)
        print(f"\n{gap_markdown(results['gap'])}", end="")
        table += "\n" + gap_markdown(results["gap"])
    if args.json:
        args.json.write_text(json.dumps(results, indent=1, allow_nan=False) + "\n", "utf-8")
    if args.markdown:
        args.markdown.write_text(table, "utf-8")
    if args.figures:
        from wisar_planner.evaluation.figures import save_figures

        for path in save_figures(args.figures, results, records, evaluation.scenario):
            print(path)
    if store is not None and not args.resume and (more := store.discard(records)):
        print(f"{more} more runs, not in these results, are kept in {store.path}", file=sys.stderr)
    return 0


def _check_outputs(args: argparse.Namespace) -> None:
    """Refuse what cannot be written, or would overwrite what is read, before the runs."""
    from wisar_planner.cli.output_files import check_names, make_places

    read = {"--config": args.config, "--map": args.map, "--area": args.area}
    read |= {"--worlds": args.worlds, "--resume": args.resume}
    written = [("--json", args.json), ("--markdown", args.markdown)]
    outputs = [(option, path) for option, path in written if path is not None]
    check_names(
        {name: path for name, path in read.items() if path is not None},
        [(option, path, ()) for option, path in outputs],
    )
    if args.figures and not args.worlds:
        outputs.append(("--figures", args.figures / "efficiency_over_distance.png"))
    make_places(outputs)


def planner_specs(names: str, assignments: list[str]) -> list[PlannerSpec]:
    """Return planners from ``a,b`` and ``a.option=value``.

    Raises
    ------
    InvalidInput
        If an assignment is malformed or is for a planner that is not named.
    """
    from wisar_planner.errors import InvalidInput
    from wisar_planner.evaluation.run import PlannerSpec

    options: dict[str, dict[str, Any]] = {
        name.strip(): {} for name in names.split(",") if name.strip()
    }
    for assignment in assignments:
        key, equals, text = assignment.partition("=")
        planner, dot, option = key.partition(".")
        if not (equals and dot and option):
            raise InvalidInput(f"--option: {assignment!r} is not of the form planner.option=value")
        if planner not in options:
            raise InvalidInput(f"--option: {planner} is not among the planners {names}")
        options[planner][option] = _value(text)
    return [PlannerSpec(name, values) for name, values in options.items()]


def _value(text: str) -> Any:
    """Read a number, true, false or, failing that, a text."""
    try:
        return json.loads(text)
    except json.JSONDecodeError:
        return text


def _scenario(args: argparse.Namespace) -> Scenario:
    """Return the maps and the drone that the arguments ask for."""
    from wisar_planner.errors import InvalidInput
    from wisar_planner.evaluation.scenario import FixedMap, RandomMaps, check_holds_persons
    from wisar_planner.search import SearchArea

    start = _start_rule(args.start)
    scenario = (
        RandomMaps.from_ros_parameters(args.config, start)
        if args.config
        else RandomMaps(start=start)
    )
    given = {
        "step_length": args.step,
        "swath_radius": args.swath_radius,
        "max_distance": args.budget,
    }
    drone = replace(scenario.drone, **{k: v for k, v in given.items() if v is not None})
    usual = f"--step, by default that of {args.config or 'the paper'}"
    drone.check_step_fits("--step" if args.step is not None else usual, "the --budget")
    if args.area and not args.map:
        raise InvalidInput("--area needs a --map")
    if not args.map:
        return replace(scenario, drone=drone)
    if not args.config and None in given.values():
        raise InvalidInput("--map needs --step, --swath-radius and --budget, or a --config")
    from wisar_planner.pdm.gis import load_map

    loaded = load_map(args.map, area=args.area)
    for note in loaded.notes:
        print(f"{args.map}: {note}", file=sys.stderr)
    if not isinstance(start, str):
        x, y = loaded.frame.to_local([start[0]], [start[1]])[0]
        start = (float(x), float(y))
    maps = FixedMap(loaded.pdm, SearchArea.from_polygon(loaded.area), args.map.name, drone, start)
    check_holds_persons(maps.problem(args.seed, 0).probability_in_area, str(args.map))
    return maps


def _start_rule(text: str) -> StartRule:
    """Return the rule's name, or the point of ``X,Y``."""
    try:
        x, y = (float(part) for part in text.split(","))
    except ValueError:
        return text
    return x, y


def _with_progress(evaluation: Evaluation, args: argparse.Namespace, store: Any) -> list[RunRecord]:
    """Run with a progress bar on standard error."""
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    from wisar_planner.evaluation.runner import run_evaluation

    names = {spec.name for spec in evaluation.planners}
    total = evaluation.runs * len(names)
    columns = (
        TextColumn("runs"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True)) as progress:
        done = sum(
            record.planner in names and record.index < evaluation.runs
            for record in (store.records if store else ())
        )
        task = progress.add_task("runs", total=total, completed=done)
        try:
            return run_evaluation(
                evaluation,
                jobs=args.jobs,
                dask=args.dask,
                store=store,
                on_records=lambda fresh: progress.advance(task, len(fresh)),
            )
        except KeyboardInterrupt:
            if store:
                progress.console.print(
                    f"{len(store.records)} runs are kept in {store.path}; "
                    "the same command continues from them",
                    highlight=False,
                    markup=False,
                )
            raise


def _print_table(results: dict[str, Any]) -> None:
    from rich.console import Console
    from rich.table import Table

    from wisar_planner.evaluation.tables import HEADERS, best_markdown, caption, table_rows

    table = Table(box=None, header_style="bold", pad_edge=False)
    for position, header in enumerate(HEADERS):
        table.add_column(header, justify="left" if position in (0, len(HEADERS) - 1) else "right")
    for row in table_rows(results):
        table.add_row(*row, style="dim" if row[0].startswith("paper's") else None)
    console = Console() if sys.stdout.isatty() else Console(width=160)
    console.print(table)
    console.print(caption(results), style="dim", highlight=False)
    if len(results["planners"]) > 1:
        print(f"\n{best_markdown(results)}", end="")
