"""What the demo leaves behind: a picture, the plan in two file formats, and the numbers."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from wisar_planner.evaluation.plan_picture import plan_picture
from wisar_planner.mavlink.files import write_plan_file
from wisar_planner.mavlink.mission import build_mission
from wisar_planner.nodes import conversions
from wisar_planner.pdm.geodesy import LocalFrame
from wisar_planner.pdm.gis import LoadedMap
from wisar_planner.search import SearchProblem
from wisar_sim.nodes.operator import Operator

FILES = {
    "Picture": "picture.png",
    "GeoJSON": "plan.geojson",
    "QGroundControl": "plan.plan",
    "Numbers": "numbers.json",
}
"""What the demo writes into its folder, besides the logs and a map that it made."""


def write_report(
    out: Path, loaded: LoadedMap, operator: Operator, speed: float, altitude: float
) -> dict[str, Any]:
    """Write picture, plan.geojson and plan.plan into `out`; return the numbers of the demo.

    Parameters
    ----------
    out : Path
        Folder that receives the files.
    loaded : LoadedMap
        The map file, to judge the plan on the map itself and not only on its fit.
    operator : Operator
        What arrived on the topics.
    speed, altitude : float
        Of the mission, m/s and m.
    """
    plan = conversions.plan_from_msg(operator.plan)
    located = conversions.map_from_msg(operator.map)
    problem = SearchProblem(
        pdm=loaded.pdm,
        area=located.area,
        start=plan.start,
        step_length=plan.step_length,
        swath_radius=plan.path.swath_radius,
        max_distance=plan.budget,
    )
    files = {name: out / file for name, file in FILES.items()}
    plan_picture(problem, {plan.path.planner: plan.path}, files["Picture"])
    mission = build_mission(
        LocalFrame(plan.origin).to_geodetic(plan.path.waypoints), altitude_m=altitude, speed=speed
    )
    for name in ("GeoJSON", "QGroundControl"):
        write_plan_file(files[name], mission)
    progress, status = operator.progress, operator.mission
    return {
        "map": {
            "file": str(operator.map.source),
            "components": len(located.pdm.weights),
            "probability_in_area": plan.probability_in_area,
        },
        "plan": {
            "planner": plan.path.planner,
            "waypoints": len(plan.path.waypoints),
            "length_m": float(plan.path.length),
            "budget_m": plan.budget,
            "step_m": plan.step_length,
            "swath_radius_m": plan.path.swath_radius,
            "probability": float(plan.probability[-1]),
            "probability_efficiency": plan.probability_efficiency,
            "upper_bound": plan.upper_bound,
            "share_of_bound": plan.probability_efficiency / plan.upper_bound,
            "probability_efficiency_on_the_map_file": float(
                plan.path.probability_efficiency(problem)
            ),
            "planning_time_s": plan.planning_time,
        },
        "flight": {
            "distance_m": progress.distance,
            "duration_min": progress.distance / speed / 60.0,
            "probability": progress.probability,
            "probability_efficiency": progress.probability_efficiency,
            "difference_to_plan": progress.probability - float(plan.probability[-1]),
        },
        "mission": {
            "autopilot": status.autopilot,
            "items_accepted": operator.upload_result.items,
            "status": status.text,
        },
        "files": {name: str(path) for name, path in files.items()},
    }
