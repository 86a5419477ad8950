"""Compile the numerical kernels into the cache: ``python -m wisar_planner.cli.warm_up``.

Run once after installation, so that nobody waits for the compiler in the field.
"""

from __future__ import annotations


def main() -> None:
    """Let every planner plan once, on a mixture and on a raster."""
    from wisar_planner.evaluation.run import PlannerSpec, evaluate_map
    from wisar_planner.evaluation.scenario import Drone, FixedMap, RandomMaps
    from wisar_planner.pdm import Grid, RasterMap
    from wisar_planner.planners.registry import planner_names

    short = RandomMaps(drone=Drone(max_distance=32.0))
    problem = short.problem(seed=0, index=0)
    grid = Grid.covering(problem.area.bounds, cell=problem.step_length)
    raster = RasterMap(problem.pdm.rasterize(grid), grid)
    planners = [PlannerSpec(name) for name in planner_names()]
    for scenario in (short, FixedMap(raster, problem.area, "warm-up", short.drone)):
        evaluate_map(scenario, planners, seed=0, index=0, persons=1)


if __name__ == "__main__":
    main()
