"""`wisar plan`: from a map file to a flight path in files that others read."""

from __future__ import annotations

import argparse
import json
import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from wisar_planner.errors import FloatArray
    from wisar_planner.pdm.geodesy import LocalFrame
    from wisar_planner.pdm.gis import LoadedMap
    from wisar_planner.planners.base import Planner, PlanProgress
    from wisar_planner.search import SearchArea, SearchPath, SearchProblem

_EXAMPLES = """\
examples:
  wisar plan map.tif --start 56.774,-5.001 --budget 10000 --swath-radius 33 --step 64 \\
      --planner sac_search --out plan.geojson --out plan.plan --picture plan.png
      10 km over a raster from a GIS: the path for the GIS and for QGroundControl, and a picture
  wisar plan mixture.yaml --budget 512 --swath-radius 2.5 --step 8 --planner greedy
      the summary alone, from the middle of the area
  wisar plan map.tif --area sector_b.geojson --budget 20000 --swath-radius 40 --time-budget 30 \\
      --option seed=7 --out plan.kml
      inside a polygon, thinking for at most 30 s; Ctrl-C ends the thinking and keeps the best path

South of the equator write --start=-33.9,151.2, with the equals sign."""

_PLAN_SUFFIXES = (".geojson", ".plan", ".waypoints", ".kml", ".gpx")
_PICTURE_SUFFIXES = (".png", ".svg", ".pdf")
_PATIENCE = 2.0  # seconds after which a progress bar is shown
_TIME_OPTION = "time_budget_s"  # what planners that think for a given time call that time


def add_parser(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        "plan",
        help="plan a flight path over a probability map",
        description="Plan the path that sees the most probability soonest, over a map from a "
        "file: GeoTIFF in any CRS, or a Gaussian mixture as GeoJSON or YAML.",
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("map", type=Path, metavar="MAP", help=".tif, .geojson or .yaml")
    what = parser.add_argument_group("map and area")
    what.add_argument(
        "--area", type=Path, metavar="FILE", help="GeoJSON polygon to search (default: all of MAP)"
    )
    what.add_argument("--band", type=int, default=1, metavar="N", help="of the raster (default: 1)")
    what.add_argument("--cell", type=float, metavar="M", help="side of the raster's cells, m")
    form = what.add_mutually_exclusive_group()
    form.add_argument(
        "--mixture",
        action="store_true",
        help="plan on a Gaussian mixture fitted to the raster; the summary is of the raster",
    )
    form.add_argument("--raster", action="store_true", help="plan on the raster itself (default)")
    drone = parser.add_argument_group("drone")
    drone.add_argument(
        "--start", metavar="LAT,LON", help="degrees (default: the middle of the area)"
    )
    drone.add_argument("--budget", type=float, required=True, metavar="M", help="longest path, m")
    drone.add_argument(
        "--swath-radius", type=float, required=True, metavar="M", help="half the width seen, m"
    )
    drone.add_argument(
        "--step",
        type=float,
        metavar="M",
        help="distance between waypoints, m (default: twice the swath radius)",
    )
    drone.add_argument(
        "--speed", type=float, default=10.0, metavar="M/S", help="ground speed (default: 10 m/s)"
    )
    drone.add_argument(
        "--altitude", type=float, default=80.0, metavar="M", help="above launch (default: 80 m)"
    )
    how = parser.add_argument_group("planner")
    how.add_argument(
        "--planner", default="sac_search", metavar="NAME", help="(default: %(default)s)"
    )
    how.add_argument(
        "--option",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="an option of the planner; may be given several times",
    )
    how.add_argument(
        "--time-budget", type=float, metavar="S", help="stop planning after so many seconds"
    )
    output = parser.add_argument_group("results")
    output.add_argument(
        "--out",
        type=Path,
        action="append",
        default=[],
        metavar="FILE",
        help=f"plan file, format by suffix: {' '.join(_PLAN_SUFFIXES)}; may be given several times",
    )
    output.add_argument(
        "--picture",
        type=Path,
        metavar="FILE",
        help=f"map, path and probability seen, {' '.join(_PICTURE_SUFFIXES)}",
    )
    parser.set_defaults(func=run)


def run(args: argparse.Namespace) -> int:
    """Plan, write the files and print the summary."""
    from wisar_planner.cli.output_files import check_names, make_places, write_each
    from wisar_planner.cli.plan_notes import notes_on_path
    from wisar_planner.errors import InvalidInput, positive
    from wisar_planner.pdm.gis import load_map
    from wisar_planner.search.bound import upper_bound

    planner = _planner(args)
    outputs = _outputs(args)
    inputs = {"the map": args.map} | ({"--area": args.area} if args.area else {})
    check_names(inputs, outputs)
    positive(args.speed, "--speed")
    positive(args.altitude, "--altitude")
    loaded = load_map(args.map, band=args.band, area=args.area, cell=args.cell)
    notes = list(loaded.notes)
    problem = _problem(args, loaded)
    make_places((option, path) for option, path, _ in outputs)
    asked = _on_mixture(problem, notes) if args.mixture else problem
    began = time.perf_counter()
    path = _plan(planner, asked, args)
    seconds = time.perf_counter() - began
    files, failures = write_each(_writers(args, loaded, problem, path))
    scores = path.probability_efficiency(problem), upper_bound(problem)
    notes += _notes_on_time(args, problem, path, seconds)
    notes += notes_on_path(problem, path, loaded.frame, scores)
    if args.out:
        notes.append(
            f"heights in the files, {args.altitude:g} m, are above the launch point; terrain is "
            "not checked"
        )
    _print_summary(args, problem, path, scores, seconds, files, notes)
    if failures:
        raise InvalidInput(f"{failures}; make room or choose another place, and plan again")
    return 0


def _planner(args: argparse.Namespace) -> Planner:
    from wisar_planner.errors import InvalidInput, positive
    from wisar_planner.planners.registry import make_planner, planner_options

    options: dict[str, Any] = {}
    for assignment in args.option:
        name, equals, text = assignment.partition("=")
        if not (name and equals):
            raise InvalidInput(f"--option: {assignment!r} is not of the form name=value")
        try:
            options[name] = json.loads(text)
        except json.JSONDecodeError:
            options[name] = text
    if args.time_budget is not None:
        positive(args.time_budget, "--time-budget")
        if _TIME_OPTION in planner_options(args.planner):
            options.setdefault(_TIME_OPTION, args.time_budget)
    return make_planner(args.planner, **options)


def _outputs(args: argparse.Namespace) -> list[tuple[str, Path, tuple[str, ...]]]:
    """Return the option, the name and the possible suffixes of each file to write."""
    outputs = [("--out", path, _PLAN_SUFFIXES) for path in args.out]
    return outputs + ([("--picture", args.picture, _PICTURE_SUFFIXES)] if args.picture else [])


def _problem(args: argparse.Namespace, loaded: LoadedMap) -> SearchProblem:
    from wisar_planner.errors import InvalidInput, positive
    from wisar_planner.pdm import GaussianMixture
    from wisar_planner.search import SearchArea, SearchProblem

    swath_radius = positive(args.swath_radius, "--swath-radius")
    step = 2.0 * swath_radius if args.step is None else positive(args.step, "--step")
    budget = positive(args.budget, "--budget")
    if step > budget:
        what = "--step" if args.step is not None else "--step, by default twice --swath-radius"
        raise InvalidInput(
            f"{what}: {step:g} m is longer than the --budget of {budget:g} m, so that not one step "
            "can be flown; give a shorter step or a larger budget"
        )
    area = SearchArea.from_polygon(loaded.area)
    if isinstance(loaded.pdm, GaussianMixture) and not loaded.pdm.integrate(area.polygon) > 0.0:
        middles = [area.polygon.centroid.coords[0], loaded.pdm.weights @ loaded.pdm.means]
        here, there = (f"{lat:.5f},{lon:.5f}" for lat, lon in loaded.frame.to_geodetic(middles))
        raise InvalidInput(
            f"{args.map}: its search area lies around {here}, but its components around {there} "
            "(LAT,LON), so that there is nothing to find; draw the area around them"
        )
    problem = SearchProblem(
        pdm=loaded.pdm,
        area=area,
        start=_start(args.start, area, loaded.frame),
        step_length=step,
        swath_radius=swath_radius,
        max_distance=budget,
    )
    problem.check_steps(step="--step", budget="--budget")
    return problem


def _start(text: str | None, area: SearchArea, frame: LocalFrame) -> FloatArray:
    """Return the place of ``LAT,LON``, m, or the middle of the area."""
    from wisar_planner.errors import InvalidInput

    if text is None:
        return area.middle
    try:
        latitude, longitude = (float(part) for part in text.split(","))
    except ValueError:
        raise InvalidInput(
            f"--start: {text!r} is not LAT,LON in degrees, for example 56.774,-5.001"
        ) from None

    def inside_at(latitude: float, longitude: float) -> FloatArray | None:
        (place,) = frame.to_local(latitude, longitude)
        return place if area.contains(place[None, :])[0] else None

    try:
        start = inside_at(latitude, longitude)
        why = "lies outside the search area"
    except InvalidInput as error:
        start, why = None, f"is no LAT,LON in degrees ({error})"
    if start is not None:
        return start
    west, south, east, north = area.bounds
    (low, high) = frame.to_geodetic([(west, south), (east, north)])
    remedy = "move it inside"
    with suppress(InvalidInput):
        if inside_at(longitude, latitude) is not None:
            remedy = f"the other way round it lies inside: --start={longitude},{latitude}"
    raise InvalidInput(
        f"--start: {text} {why}; the area reaches from {low[0]:.5f},{low[1]:.5f} to "
        f"{high[0]:.5f},{high[1]:.5f} (LAT,LON); {remedy}"
    )


def _on_mixture(problem: SearchProblem, notes: list[str]) -> SearchProblem:
    """Return the problem on a mixture fitted to its raster."""
    from dataclasses import replace

    from wisar_planner.pdm import RasterMap
    from wisar_planner.pdm.fit import fit_mixture

    if not isinstance(problem.pdm, RasterMap):
        return problem
    fit = fit_mixture(problem.pdm)
    notes.append(f"planned on a mixture fitted to the raster: {fit}")
    return replace(problem, pdm=fit.mixture)


def _plan(planner: Planner, problem: SearchProblem, args: argparse.Namespace) -> SearchPath:
    """Run the planner with a progress bar, until its time is over or Ctrl-C ends it."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    deadline = time.perf_counter() + (args.time_budget or float("inf"))
    with (
        _first_interrupt() as interrupted,
        Progress(
            TextColumn(planner.name),
            BarColumn(),
            TextColumn("{task.percentage:>3.0f}%  e_p {task.fields[best]:.3f}"),
            TimeElapsedColumn(),
            console=Console(stderr=True),
            transient=True,
        ) as progress,
    ):
        bar = progress.add_task("plan", total=1.0, best=0.0, visible=False)

        def on_progress(now: PlanProgress) -> None:
            progress.update(
                bar,
                completed=now.fraction,
                best=now.efficiency,
                visible=now.elapsed_s > _PATIENCE,
            )

        def should_stop() -> bool:
            return bool(interrupted) or time.perf_counter() > deadline

        return planner.plan(problem, on_progress=on_progress, should_stop=should_stop)


@contextmanager
def _first_interrupt() -> Iterator[list[int]]:
    """Collect the first Ctrl-C in a list; the second interrupts as ever."""
    received: list[int] = []

    def receive(number: int, _: FrameType | None) -> None:
        received.append(number)
        signal.signal(signal.SIGINT, before)

    before = signal.signal(signal.SIGINT, receive)
    try:
        yield received
    finally:
        signal.signal(signal.SIGINT, before)


def _notes_on_time(
    args: argparse.Namespace, problem: SearchProblem, path: SearchPath, seconds: float
) -> list[str]:
    """Say so where the time was over before the path was."""
    # A planner that counts the seconds itself may stop a little early.
    over = args.time_budget is not None and seconds >= 0.95 * args.time_budget
    if not over or path.length >= problem.max_distance - problem.step_length:
        return []
    return [
        f"the --time-budget of {args.time_budget:g} s was over with {path.length:,.0f} m of the "
        f"path's {problem.max_distance:,.0f} m planned: give it more, or choose a faster planner"
    ]


def _writers(
    args: argparse.Namespace, loaded: LoadedMap, problem: SearchProblem, path: SearchPath
) -> list[tuple[Path, Callable[[Path], None]]]:
    """Return the files to write, and what writes each."""

    def write_plan(file: Path) -> None:
        from wisar_planner.mavlink.files import write_plan_file
        from wisar_planner.mavlink.mission import build_mission

        places = loaded.frame.to_geodetic(path.waypoints)
        write_plan_file(file, build_mission(places, altitude_m=args.altitude, speed=args.speed))

    def draw(file: Path) -> None:
        from wisar_planner.evaluation.plan_picture import plan_picture

        plan_picture(problem, {path.planner or args.planner: path}, file)

    plans = [(file, write_plan) for file in args.out]
    return plans + ([(args.picture, draw)] if args.picture else [])


def _print_summary(
    args: argparse.Namespace,
    problem: SearchProblem,
    path: SearchPath,
    scores: tuple[float, float],
    seconds: float,
    files: list[Path],
    notes: list[str],
) -> None:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    from wisar_planner.search.bound import bound_holds

    efficiency, bound = scores
    of_bound = f", {efficiency / bound:.1%} of the bound {bound:.4f}"
    if not bound_holds(problem, path):
        of_bound = ""
    minutes = path.length / args.speed / 60.0
    rows = [
        ("probability seen", f"{path.seen_probability(problem.pdm):.4f}"),
        ("in the area", f"{problem.probability_in_area:.4f}"),
        ("efficiency e_p", f"{efficiency:.4f}{of_bound}"),
        ("distance", f"{path.length:,.0f} m of {problem.max_distance:,.0f} m"),
        ("waypoints", f"{len(path.waypoints)}"),
        ("duration", f"{minutes:.1f} min at {args.speed:g} m/s, without the ways there and back"),
        ("planned in", f"{seconds:.2f} s"),
        *(("wrote", str(file)) for file in files),
        *(("note", note) for note in notes),
    ]
    # As Text, in which the brackets and colons of a file's name are no markup.
    table = Table(
        box=None, show_header=False, pad_edge=False, title_justify="left",
        title=Text(f"{args.planner} on {args.map}", style="bold"),
    )  # fmt: skip
    table.add_column(style="dim", no_wrap=True)
    table.add_column(overflow="fold")
    for name, text in rows:
        table.add_row(name, Text(text))
    console = Console() if sys.stdout.isatty() else Console(width=120)
    console.print(table, highlight=False)
