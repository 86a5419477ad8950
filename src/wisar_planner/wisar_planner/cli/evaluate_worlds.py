"""`wisar evaluate --worlds`: compare planners in several worlds."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from wisar_planner.evaluation.run import PlannerSpec, RunRecord
    from wisar_planner.evaluation.store import RunStore
    from wisar_planner.evaluation.worlds import World

# What a world says itself, or what has no meaning for several.
_OTHERS = ("config", "map", "area", "step", "swath_radius", "budget", "figures", "gap", "dask")
# Suffixes of the folders that runs are kept in.
_FOLDERS = ("", ".runs")


def run_worlds(args: argparse.Namespace, planners: Sequence[PlannerSpec]) -> int:
    """Run the planners in every world and write what was asked for.

    Raises
    ------
    InvalidInput
        If an option does not go with ``--worlds``, or the file or an option is wrong.
    """
    from wisar_planner.errors import InvalidInput
    from wisar_planner.evaluation.worlds_table import worlds_markdown

    for name in _OTHERS:
        if getattr(args, name):
            raise InvalidInput(f"--{name.replace('_', '-')} does not go with --worlds; drop it")
    if args.start != "uniform":
        raise InvalidInput("--start does not go with --worlds; write it into the file")
    keep = args.resume or (args.json and args.json.with_name(args.json.name + ".runs"))
    # One that does not exist and has the suffix of a file is not meant as a folder.
    if keep is not None and not keep.is_dir() and (keep.exists() or keep.suffix not in _FOLDERS):
        raise InvalidInput(f"--resume: {keep} must be a folder, for there is a file per world")
    worlds = selected_worlds(args)
    if keep is not None:
        keep.mkdir(parents=True, exist_ok=True)
    stores: list[tuple[RunStore, Sequence[RunRecord]]] = []
    identities = {spec.name: spec.identity() for spec in planners}
    results = {
        "setup": {
            "worlds": str(args.worlds),
            "runs": args.runs,
            "seed": args.seed,
            "persons": args.persons,
            "planners": identities,
        },
        "worlds": _run_all(args, planners, worlds, keep, stores),
    }
    if identities != {spec.name: spec.identity() for spec in planners}:
        raise InvalidInput(
            "a policy changed between two worlds, so that the table is of two; copy the files to a "
            "place where nothing changes them, and begin anew"
        )
    table = worlds_markdown(results)
    print(table, end="")
    for path, text in (
        (args.json, json.dumps(results, indent=1, allow_nan=False) + "\n"),
        (args.markdown, table),
    ):
        if path:
            path.write_text(text, encoding="utf-8")
    if keep is not None and not args.resume:
        for store, records in stores:
            store.discard(records)
        if any(keep.iterdir()):
            print(f"more runs, not in these results, are kept in {keep}", file=sys.stderr)
        else:
            keep.rmdir()
    return 0


def selected_worlds(args: argparse.Namespace) -> list[World]:
    """Return the worlds of the file, or those that ``--world`` names.

    A name is a world's own, or that of an entry of the file: then all worlds that came from it.

    Raises
    ------
    InvalidInput
        If the file is wrong or has no world of a name.
    """
    from wisar_planner.errors import InvalidInput
    from wisar_planner.evaluation.worlds import read_worlds

    worlds = read_worlds(args.worlds, args.world_maps)
    if not args.world:
        return worlds
    wanted = [name.strip() for name in args.world.split(",") if name.strip()]
    known = list(dict.fromkeys(name for world in worlds for name in (world.entry, world.name)))
    for name in wanted:
        if name not in known:
            raise InvalidInput(f"--world: {name!r} is not in {args.worlds}; it has {known}")
    return [world for world in worlds if {world.name, world.entry} & set(wanted)]


def _run_all(
    args: argparse.Namespace,
    planners: Sequence[PlannerSpec],
    worlds: Sequence[World],
    keep: Path | None,
    stores: list[tuple[RunStore, Sequence[RunRecord]]],
) -> dict[str, Any]:
    """Return the numbers of each world, with a progress bar on standard error.

    Where runs are kept, `stores` gets where, and which are in the numbers.
    """
    from contextlib import nullcontext

    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    from wisar_planner.evaluation.runner import Evaluation, run_evaluation
    from wisar_planner.evaluation.store import RunStore
    from wisar_planner.evaluation.worlds_table import summarise_world

    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
    )
    each = args.runs * len(planners)
    found: dict[str, Any] = {}
    with Progress(*columns, console=Console(stderr=True)) as progress:
        task = progress.add_task("runs", total=each * sum(w.scenario is not None for w in worlds))
        try:
            for position, world in enumerate(worlds):
                if world.scenario is None:
                    found[world.name] = {"skipped": world.missing}
                    continue
                evaluation = Evaluation(
                    planners, args.runs, args.seed, args.persons, world.scenario
                )
                progress.update(task, description=world.name)
                stored = (
                    nullcontext()
                    if keep is None
                    else RunStore(keep, evaluation.common_setup(), planners)
                )
                with stored as store:
                    records = run_evaluation(
                        evaluation,
                        jobs=args.jobs,
                        store=store,
                        on_records=lambda fresh: progress.advance(task, len(fresh)),
                    )
                if store is not None:
                    stores.append((store, records))
                runnable = sum(w.scenario is not None for w in worlds[: position + 1])
                progress.update(task, completed=each * runnable)
                found[world.name] = summarise_world(evaluation, records, jobs=args.jobs)
        except KeyboardInterrupt:
            if keep is not None:
                print(
                    f"finished runs are kept in {keep}; the same command continues from them",
                    file=sys.stderr,
                )
            raise
    return found
