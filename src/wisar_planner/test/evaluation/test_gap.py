import math
from itertools import pairwise

import numpy as np
import pytest
import shapely

from wisar_planner import Grid, RasterMap, SearchArea, SearchProblem, make_planner
from wisar_planner.evaluation.gap import PARTS, gap_markdown, gap_parts, summarise_gap
from wisar_planner.evaluation.run import PlannerSpec
from wisar_planner.evaluation.runner import Evaluation, run_evaluation
from wisar_planner.evaluation.scenario import Drone, RandomMaps
from wisar_planner.search import SearchPath, reachable_bound, upper_bound

RADIUS = 4.0


def strips(distance, *spans, start=(20.0, 20.0)):
    """Return a problem with even probability on a strip 8 m high, between the given columns."""
    mass = np.zeros((40, 400))
    for first, last in spans:
        mass[16:24, first:last] = 1.0
    pdm = RasterMap(mass / mass.sum(), Grid(0.0, 0.0, 1.0, 400, 40))
    area = SearchArea.rectangle(0.0, 0.0, 400.0, 40.0)
    return SearchProblem(pdm, area, np.array(start), 8.0, RADIUS, distance)


def along(*xs):
    return SearchPath([(x, 20.0) for x in xs], RADIUS)


def gap_of(problem, path):
    return upper_bound(problem) - path.probability_efficiency(problem)


def alone(parts, *names, slack=0.02):
    """Check that only these parts matter: the ends of a swath are round, those of a strip not."""
    total = sum(parts.values())
    assert sum(parts[name] for name in names) == pytest.approx(total, abs=slack)
    assert all(parts[name] > slack for name in names)


@pytest.mark.parametrize("planner", ["lawnmower", "lhc_gw_conv", "expanding_square", "greedy"])
@pytest.mark.parametrize("as_raster", [False, True])
def test_the_parts_add_up_to_the_gap(planner, as_raster):
    problem = SearchProblem.paper(np.random.default_rng(5))
    if as_raster:
        grid = Grid.covering((-20, -20, 170, 170), 7.0)
        pdm = RasterMap(problem.pdm.rasterize(grid), grid)
        problem = SearchProblem(pdm, problem.area, problem.start, 8.0, 2.5, 512.0)
    path = make_planner(planner).plan(problem)
    parts = gap_parts(problem, path)
    assert tuple(parts) == PARTS
    assert sum(parts.values()) == pytest.approx(gap_of(problem, path), abs=1e-12)
    assert min(parts.values()) > -1e-3


def test_a_flight_straight_over_the_best_ground_loses_nothing():
    problem = strips(300.0, (10, 390))
    parts = gap_parts(problem, along(20.0, 320.0))
    assert sum(parts.values()) == pytest.approx(0.0, abs=0.01)
    assert max(parts.values()) < 0.01


def test_the_way_to_the_first_best_ground_is_transit():
    problem = strips(240.0, (200, 390))
    parts = gap_parts(problem, along(*np.arange(20.0, 261.0, 8.0)))
    alone(parts, "transit")
    # 180 m of the 240 lead there; the bound takes all of the strip.
    assert parts["transit"] == pytest.approx(1.0 - 60.0 / 190.0, abs=0.03)


def test_the_way_from_one_best_ground_to_the_next_is_crossing():
    problem = strips(300.0, (10, 110), (210, 390))
    parts = gap_parts(problem, along(*np.arange(20.0, 321.0, 10.0)))
    alone(parts, "crossing")
    assert parts["crossing"] == pytest.approx(gap_of(problem, along(20.0, 320.0)), abs=0.02)


def test_a_flight_beside_the_best_ground_is_low_ground():
    problem = strips(300.0, (0, 400))
    path = SearchPath([(20.0 + 10 * k, 17.0) for k in range(31)], RADIUS)
    parts = gap_parts(problem, path)
    alone(parts, "low_ground")
    assert parts["low_ground"] == pytest.approx(3.0 / 8.0 * upper_bound(problem), abs=0.02)


def test_flying_back_is_a_turn_at_first_and_overlap_then():
    problem = strips(320.0, (0, 400))
    there = np.arange(20.0, 181.0, 20.0)
    parts = gap_parts(problem, along(*there, *there[-2::-1]))
    alone(parts, "turns", "overlap")
    # The first of eight legs lies on the leg before it.
    assert parts["overlap"] / parts["turns"] == pytest.approx(7.0, rel=0.02)


def test_what_is_not_flown_is_unused():
    problem = strips(300.0, (0, 400))
    parts = gap_parts(problem, along(20.0, 120.0))
    alone(parts, "unused")
    assert parts["unused"] == pytest.approx(gap_of(problem, along(20.0, 120.0)), abs=0.01)


def test_shapely_and_a_fine_raster_find_the_same_parts():
    """Classify by polygons of the swath and points of a grid, without any kernel."""
    problem = SearchProblem.paper(np.random.default_rng(1))
    path = make_planner("lhc_gw_conv").plan(problem)
    cell = 0.5
    grid = Grid.covering((-2.5, -2.5, 152.5, 152.5), cell)
    # A point anywhere in each cell: a path along rows or diagonals would see too many centres.
    points = grid.centres().reshape(-1, 2)
    points = points + np.random.default_rng(0).uniform(-cell / 2, cell / 2, points.shape)
    density = problem.pdm.density(points)
    size = (5.0 * 512.0 + math.pi * 2.5**2) / cell**2
    best = np.zeros(len(points), dtype=bool)
    best[np.argsort(-density)[: round(size)]] = True

    legs = list(pairwise(path.waypoints))
    swaths = [shapely.Point(path.waypoints[0]).buffer(2.5, quad_segs=64)]
    swaths += [shapely.LineString(leg).buffer(2.5, quad_segs=64) for leg in legs]
    seen, union = np.zeros(len(points), dtype=bool), shapely.Polygon()
    area, instead = dict.fromkeys(PARTS, 0.0), dict.fromkeys(PARTS, 0.0)
    turns, reached = 0.0, False
    for i, swath in enumerate(swaths):
        new = shapely.contains_xy(swath, points) & ~seen
        reaching = best[new].sum() >= 0.5 * new.sum() and bool(best[new].any())
        reached = reached or reaching
        name = "low_ground" if reaching else "crossing" if reached else "transit"
        area[name] += (new & ~best).sum() * cell**2
        instead[name] += density[new & ~best].sum() * cell**2
        seen |= new
        if i >= 2:
            turns += swath.intersection(swaths[i - 1]).area - swaths[0].area
        union = union.union(swath)
    flown = 5.0 * path.length + math.pi * 2.5**2
    area["turns"] = turns
    area["overlap"] = flown - union.area - turns
    area["unused"] = 5.0 * (512.0 - path.length)
    left = (density[best].sum() - density[best & seen].sum()) * cell**2
    charge = left / sum(area.values())
    for name, value in gap_parts(problem, path).items():
        expected = (charge * area[name] - instead[name]) / problem.probability_in_area
        assert value == pytest.approx(expected, abs=2e-3), name


SPECS = (PlannerSpec("lawnmower"), PlannerSpec("lhc_gw_conv"))
EVALUATION = Evaluation(SPECS, runs=4, persons=1, scenario=RandomMaps(Drone(max_distance=200.0)))


@pytest.fixture(scope="module")
def records():
    return run_evaluation(EVALUATION, jobs=1)


def test_shares_of_the_mean_bound_add_up(records):
    gap = summarise_gap(EVALUATION, records, jobs=1)
    for name, planner in gap["planners"].items():
        shares = [planner["share_of_bound"], *(planner[part] for part in PARTS)]
        assert sum(shares) == pytest.approx(1.0, abs=1e-12)
        runs = [r for r in records if r.planner == name]
        efficiency = sum(r.e_p for r in runs)
        # Records keep waypoints to the millimetre.
        expected = efficiency / sum(r.bound for r in runs)
        assert planner["share_of_bound"] == pytest.approx(expected, abs=1e-3)
        low, high = planner["share_of_bound_ci"]
        assert low <= planner["share_of_bound"] <= high
    problems = [EVALUATION.scenario.problem(0, i) for i in range(4)]
    bounds = [reachable_bound(problem) for problem in problems]
    assert gap["reachable_bound"]["e_p_mean"] == pytest.approx(np.mean(bounds))
    # The lawnmower begins at a corner of its own choice.
    assert gap["planners"]["lawnmower"]["share_of_reachable_bound"] is None
    share = gap["planners"]["lhc_gw_conv"]["share_of_reachable_bound"]
    assert share == pytest.approx(efficiency / sum(bounds), abs=1e-3)


def test_the_table_has_a_row_a_planner_that_sums_to_the_whole(records):
    lines = gap_markdown(summarise_gap(EVALUATION, records, jobs=1)).splitlines()
    assert lines[0].count("|") == lines[1].count("|") == lines[2].count("|")
    for line, spec in zip(lines[2:4], SPECS, strict=True):
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        assert cells[0] == spec.name
        assert sum(float(cell.rstrip("%")) for cell in cells[1:8]) == pytest.approx(100, abs=0.5)
        assert "-0.0%" not in cells
    assert lines[2].rstrip("| ").endswith("–")
