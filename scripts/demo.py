#!/usr/bin/env python3
"""The whole chain on one map: map -> plan -> simulated flight -> mission upload.

Starts every node as a process of its own, shows how far they are, checks what arrived on the
autopilot, and leaves a picture, the plan and the numbers. Nothing keeps running afterwards.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.panel import Panel
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table
from rich.text import Text

from demo_report import FILES, write_report
from wisar_planner.errors import InvalidInput, positive
from wisar_planner.pdm.gis import load_map
from wisar_sim.nodes.operator import Operator
from wisar_sim.processes import (
    WITHOUT_SHARED_MEMORY,
    ProcessDied,
    ProcessGroup,
    RosDomain,
    executable,
    free_udp_port,
    ros_arguments,
)

ROOT = Path(__file__).resolve().parent.parent
FLIGHT_SECONDS = 12.0
"""How long the simulated flight takes on the screen, whatever its real duration."""
NODES = ("sim_autopilot", "pdm_server", "planner", "mavlink_bridge", "sim_drone")
"""What the demo starts; each leaves a log."""
PATIENCE = 180.0
"""Seconds after which the demo gives up."""


class Interrupt:
    """Ctrl-C and SIGTERM as a flag that the waiting loop reads.

    An exception raised at an arbitrary place can get lost: Python ignores those raised inside
    the callbacks that it runs around a fork. A second Ctrl-C takes the default way out.
    """

    def __init__(self) -> None:
        self._requested = False
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._request)

    def _request(self, number: int, _: object) -> None:
        self._requested = True
        signal.signal(number, signal.default_int_handler)

    def check(self) -> None:
        """Raise KeyboardInterrupt if one was requested."""
        if self._requested:
            raise KeyboardInterrupt


class DemoError(Exception):
    """The chain did not come to its end; the text says where."""


@dataclass(frozen=True)
class Settings:
    """What the demo was asked to do; lengths in metres, speed in m/s.

    `map` is the user's own, and only read, unless the demo `makes_map`.
    """

    map: Path
    makes_map: bool
    out: Path
    planner: str
    budget: float
    swath_radius: float
    step: float
    speed: float
    altitude: float
    autopilot: str


def parse(arguments: list[str] | None) -> Settings:
    """Read the command line. Raises InvalidInput for what cannot be right."""
    parser = argparse.ArgumentParser(
        prog="make demo",
        description=__doc__.splitlines()[0],
        epilog='Another map: make demo DEMO="--map MAP.tif --budget 10000 --step 64"',
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
    )
    parser.add_argument("--map", type=Path, help="probability map (made if not given)")
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "demo", help="results")
    parser.add_argument("--planner", default="sac_search", help="name of the planner")
    parser.add_argument("--budget", type=float, default=8000.0, help="distance to fly, m")
    parser.add_argument("--swath-radius", type=float, default=25.0, help="half the swath, m")
    parser.add_argument("--step", type=float, default=50.0, help="between waypoints, m")
    parser.add_argument("--speed", type=float, default=10.0, help="ground speed, m/s")
    parser.add_argument("--altitude", type=float, default=60.0, help="above launch, m")
    parser.add_argument(
        "--autopilot", choices=("px4", "ardupilot", "mavsdk"), default="px4", help="to simulate"
    )
    given = parser.parse_args(arguments)
    out = given.out.resolve()
    if given.map:
        check_kept(given.map, out)
    budget, step = positive(given.budget, "--budget"), positive(given.step, "--step")
    if budget < step:
        raise InvalidInput(f"--budget must be at least a --step ({step:g} m), not {budget:g}")
    return Settings(
        map=given.map.resolve() if given.map else out / "demo_map.tif",
        makes_map=given.map is None,
        out=out,
        planner=given.planner,
        budget=budget,
        swath_radius=positive(given.swath_radius, "--swath-radius"),
        step=step,
        speed=positive(given.speed, "--speed"),
        altitude=positive(given.altitude, "--altitude"),
        autopilot=given.autopilot,
    )


def check_kept(path: Path, out: Path) -> None:
    """Raise InvalidInput when a map is one of the files that the demo writes into `out`."""
    if path.resolve() in [(out / file).resolve() for file in FILES.values()]:
        raise InvalidInput(
            f"--map: the demo would overwrite {path}; name another folder with --out"
        )


def main(arguments: list[str] | None = None) -> int:
    """Run the demo; return the exit status."""
    try:
        settings = parse(arguments)
    except InvalidInput as error:
        print(f"demo: {error}", file=sys.stderr)
        return 2
    interrupt = Interrupt()
    console = Console()
    # Two demos at once on one machine must not hear each other.
    domain = RosDomain()
    os.environ.update({"ROS_DOMAIN_ID": str(domain.number), **WITHOUT_SHARED_MEMORY})
    try:
        prepare_logs(settings.out / "logs")
        if settings.makes_map:
            make_map(settings.map, interrupt)
        run(settings, console, interrupt)
    except KeyboardInterrupt:
        console.print("stopped; nothing is left running")
        return 130
    except (InvalidInput, OSError) as error:
        print(f"demo: {error}", file=sys.stderr)
        return 1
    except (DemoError, ProcessDied) as error:
        print(f"demo: {error}\nThe nodes' logs are in {settings.out / 'logs'}", file=sys.stderr)
        return 1
    finally:
        domain.close()
    return 0


def prepare_logs(folder: Path) -> None:
    """Make the folder of the logs, and with it that of the results, without logs of the last run.

    Raises
    ------
    InvalidInput
        If nothing can be written there.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for node in NODES:  # what else lies there is not the demo's
            (folder / f"{node}.log").unlink(missing_ok=True)
    except OSError as error:
        raise InvalidInput(
            f"--out: cannot write into {folder} ({error.strerror}); name another folder"
        ) from None


def make_map(path: Path, interrupt: Interrupt) -> None:
    """Write the demo's own map. Raises InvalidInput with the reason when that fails."""
    script = ROOT / "scripts" / "make_demo_map.py"
    made = subprocess.run(
        [sys.executable, script, "--out", path], stderr=subprocess.PIPE, text=True, check=False
    )
    interrupt.check()  # Ctrl-C ends the script too, and then is the reason
    if made.returncode != 0:
        *_, reason = made.stderr.splitlines() or [f"status {made.returncode}"]
        raise InvalidInput(f"cannot make the map {path} ({reason}); give one with --map")


def run(settings: Settings, console: Console, interrupt: Interrupt) -> None:
    """Start the nodes, follow the chain to its end, write the results."""
    began = time.monotonic()
    loaded = load_map(settings.map)
    steps = max(1, round(settings.budget / settings.step))
    port = free_udp_port()
    with ProcessGroup(settings.out / "logs") as processes:
        processes.start(
            "sim_autopilot",
            [
                executable("wisar_sim", "sim_autopilot"),
                *("--connection", f"udpin:127.0.0.1:{port}"),
                *("--profile", settings.autopilot),
                # In one word: a latitude south of the equator begins like an option.
                f"--home={loaded.origin.latitude:.7f},{loaded.origin.longitude:.7f}",
            ],
        )
        start_node(processes, "wisar_planner", "pdm_server", map=str(settings.map))
        start_node(
            processes,
            "wisar_planner",
            "planner",
            planner=settings.planner,
            swath_radius=settings.swath_radius,
            step_length=settings.step,
            max_distance=settings.budget,
        )
        start_node(
            processes,
            "wisar_planner",
            "mavlink_bridge",
            connection=f"udpout:127.0.0.1:{port}",
            altitude=settings.altitude,
            speed=settings.speed,
        )
        tick_rate = settings.speed / settings.step
        start_node(
            processes,
            "wisar_sim",
            "sim_drone",
            tick_rate=tick_rate,
            speed_up=max(1.0, steps / tick_rate / FLIGHT_SECONDS),
        )
        with Operator() as operator:
            follow(operator, processes, console, interrupt)
    summary = write_report(settings.out, loaded, operator, settings.speed, settings.altitude)
    summary["elapsed_s"] = round(time.monotonic() - began, 1)
    Path(summary["files"]["Numbers"]).write_text(json.dumps(summary, indent=2) + "\n")
    console.print(last_screen(summary))


def start_node(processes: ProcessGroup, package: str, name: str, **parameters: object) -> None:
    """Start a node of the suite with parameters."""
    processes.start(name, [executable(package, name), *ros_arguments(parameters)])


def follow(
    operator: Operator, processes: ProcessGroup, console: Console, interrupt: Interrupt
) -> None:
    """Show how far the chain is until the plan is flown and the mission is verified."""
    columns = (
        TextColumn("{task.description:<18}"),
        BarColumn(bar_width=30),
        TextColumn("{task.fields[state]}"),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=console) as progress:
        stages = {
            name: Stage(progress, name) for name in ("map", "plan", "mission upload", "flight")
        }
        deadline = time.monotonic() + PATIENCE
        asked = False
        while not all(stage.done for stage in stages.values()):
            interrupt.check()
            processes.check()
            if time.monotonic() > deadline:
                waiting = ", ".join(name for name, stage in stages.items() if not stage.done)
                raise DemoError(f"gave up after {PATIENCE:.0f} s; still waiting for: {waiting}")
            if operator.map is not None:
                count = len(operator.map.weights)
                stages["map"].finish(f"mixture of {count} components")
            if operator.plan is not None:
                plan = operator.plan
                stages["plan"].finish(
                    f"{plan.planner}: e_p {plan.probability_efficiency:.3f}, {plan.length:.0f} m"
                )
                if not asked and operator.can_upload():
                    operator.request_upload(plan.map_id)
                    asked = True
            show_upload(operator, stages["mission upload"])
            show_flight(operator, stages["flight"])
            time.sleep(0.05)


class Stage:
    """One line of the progress display."""

    def __init__(self, progress: Progress, name: str) -> None:
        self._progress = progress
        self._task = progress.add_task(name, total=1.0, state="waiting")
        self._name = name
        self.done = False

    def update(self, share: float, state: str) -> None:
        """Show a share from 0 to 1 and a text."""
        self._progress.update(self._task, completed=min(share, 0.999), state=state)

    def finish(self, state: str) -> None:
        """Mark the stage as done, once."""
        if not self.done:
            self.done = True
            self._progress.update(self._task, completed=1.0, state=state)
            if not self._progress.console.is_terminal:
                print(f"{self._name}: {state}", flush=True)


def show_upload(operator: Operator, stage: Stage) -> None:
    """Update the line of the upload; a refused mission ends the demo."""
    result, feedback = operator.upload_result, operator.upload_feedback
    if result is not None:
        if result.error_code != result.NONE:
            raise DemoError(f"mission upload failed: {result.error_text}")
        stage.finish(f"{result.items} items uploaded, read back, equal")
    elif feedback is not None and feedback.items_total:
        sent, total = feedback.items_sent, feedback.items_total
        stage.update(sent / total, f"{sent} of {total} items")


def show_flight(operator: Operator, stage: Stage) -> None:
    """Update the line of the simulated flight."""
    progress = operator.progress
    if progress is None or progress.steps == 0:
        return
    state = f"{progress.distance:6.0f} m, e_p {progress.probability_efficiency:.3f}"
    if progress.finished:
        stage.finish(state)
    else:
        stage.update(progress.step / progress.steps, state)


def last_screen(summary: dict[str, Any]) -> Panel:
    """Return what was achieved, on one screen."""
    table = Table.grid(padding=(0, 2))
    table.add_column(style="bold")
    table.add_column()
    plan, flight, mission = summary["plan"], summary["flight"], summary["mission"]

    def show(name: str, value: str) -> None:
        table.add_row(name, Text(value))  # a plain string's brackets would be read as markup

    show("Map", f"{Path(summary['map']['file']).name}, {summary['map']['components']} components")
    show(
        "Plan",
        f"{plan['planner']}: e_p {plan['probability_efficiency']:.3f} "
        f"({plan['share_of_bound']:.0%} of the upper bound), "
        f"{plan['length_m'] / 1000:.2f} km, {plan['waypoints']} waypoints, "
        f"planned in {plan['planning_time_s']:.2f} s",
    )
    show(
        "On the map",
        f"e_p {plan['probability_efficiency_on_the_map_file']:.3f} on the cells of the map file, "
        "as in the picture; the planner knows the map by its Gaussian mixture",
    )
    show(
        "Flight",
        f"e_p {flight['probability_efficiency']:.3f} seen after "
        f"{flight['duration_min']:.0f} min of simulated flight",
    )
    show(
        "Mission",
        f"{mission['items_accepted']} items accepted by {mission['autopilot']}, "
        "read back and equal; nothing was armed or started",
    )
    for name, file in summary["files"].items():
        show(name, os.path.relpath(file))
    show("Took", f"{summary['elapsed_s']:.0f} s")
    return Panel(table, title="wisar demo", expand=False)


if __name__ == "__main__":
    sys.exit(main())
