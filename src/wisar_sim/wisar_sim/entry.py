"""The executables of this package, which heed Ctrl-C while they import."""

from __future__ import annotations

from functools import partial

from wisar_planner.nodes.entry import run

sim_drone = partial(run, "wisar_sim.nodes.sim_drone")
sim_autopilot = partial(run, "wisar_sim.autopilot.cli")
