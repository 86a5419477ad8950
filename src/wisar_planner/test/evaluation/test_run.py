import dataclasses
import json

import numpy as np
import pytest
import shapely
from shapely.ops import substring

from wisar_planner.errors import InvalidInput
from wisar_planner.evaluation import run
from wisar_planner.evaluation.run import CURVE_STEPS, FIND_BINS, PlannerSpec, RunRecord
from wisar_planner.evaluation.scenario import Drone, FixedMap, RandomMaps, persons_in_area
from wisar_planner.pdm import Grid, RasterMap
from wisar_planner.search import SearchArea

SPECS = (PlannerSpec("lawnmower"), PlannerSpec("lhc_gw_conv"))


@pytest.fixture(scope="module")
def records():
    return run.evaluate_map(RandomMaps(), SPECS, seed=0, index=1, persons=1000)


def test_efficiency_is_the_integral_over_the_buffered_path(records):
    problem = RandomMaps().problem(0, 1)
    for record in records:
        path = shapely.LineString(record.waypoints)
        # The polygon of a buffer lies inside the true one by 1e-5 of it at 256 segments.
        seen = problem.pdm.integrate(path.buffer(problem.swath_radius, quad_segs=256))
        assert record.p_d == pytest.approx(seen, rel=1e-4)
        assert record.e_p == pytest.approx(record.p_d / record.p_a, rel=1e-12)
        assert record.e_p <= record.bound


def test_curve_rises_from_the_disc_around_the_first_point_to_e_p(records):
    for record in records:
        assert len(record.curve) == CURVE_STEPS + 1
        assert record.curve[-1] == record.e_p
        assert (np.diff(record.curve) >= -1e-12).all()
        path = shapely.LineString(record.waypoints)
        half = substring(path, 0.0, 256.0).buffer(2.5, quad_segs=256)
        expected = RandomMaps().problem(0, 1).pdm.integrate(half) / record.p_a
        assert record.curve[CURVE_STEPS // 2] == pytest.approx(expected, rel=1e-3)


def test_persons_found_are_those_within_the_swath(records):
    problem = RandomMaps().problem(0, 1)
    persons = shapely.points(persons_in_area(problem, 1000, seed=0, index=1))
    for record in records:
        path = shapely.LineString(record.waypoints)
        found = persons[shapely.distance(path, persons) <= 2.5]
        assert record.found == len(found)
        assert sum(record.find_counts) == record.found
        assert len(record.find_counts) == FIND_BINS
        # Nobody is found later than when the path is nearest to them.
        assert record.find_total <= shapely.line_locate_point(path, found).sum() + 1e-6
        assert record.find_squares >= record.find_total**2 / max(record.found, 1)


def test_persons_found_agree_with_the_probability_seen(records):
    for record in records:
        p = record.e_p
        deviation = np.sqrt(p * (1.0 - p) / record.persons)
        assert record.found / record.persons == pytest.approx(p, abs=4.5 * deviation)


def test_record_survives_json(records):
    for record in records:
        assert RunRecord(**json.loads(json.dumps(dataclasses.asdict(record)))) == record


def test_a_raster_is_evaluated_like_a_mixture():
    mixture = RandomMaps().problem(0, 1)
    grid = Grid.covering((-10.0, -10.0, 160.0, 160.0), 2.0)
    raster = RasterMap(mixture.pdm.rasterize(grid), grid)
    scenario = FixedMap(raster, SearchArea.rectangle(0, 0, 150, 150), "raster", Drone())
    spec = (PlannerSpec("lawnmower"),)
    ours = run.evaluate_map(scenario, spec, seed=0, index=1, persons=50)[0]
    theirs = run.evaluate_map(RandomMaps(), spec, seed=0, index=1, persons=50)[0]
    assert ours.start == theirs.start
    assert ours.p_d == pytest.approx(theirs.p_d, rel=0.01)
    assert ours.p_a == pytest.approx(theirs.p_a, rel=0.01)


def test_options_are_resolved_with_their_defaults():
    resolved = PlannerSpec("lawnmower", {"lane_spacing": 5.0}).resolved()
    assert resolved["lane_spacing"] == 5.0
    assert resolved["from_start"] is False


def test_unknown_planner_and_option_are_refused():
    with pytest.raises(InvalidInput, match="lawnmover"):
        PlannerSpec("lawnmover").make()
    with pytest.raises(InvalidInput, match="lanes"):
        PlannerSpec("lawnmower", {"lanes": 3}).make()


def test_a_planner_that_fails_is_named_with_its_problem(monkeypatch):
    class Broken:
        def plan(self, problem, **_):
            if problem.start[0] == RandomMaps().problem(5, 3).start[0]:
                raise ZeroDivisionError
            return SPECS[0].make().plan(problem)

    monkeypatch.setattr(run, "_warm", set())
    monkeypatch.setattr(run, "_planners", {run._key(PlannerSpec("broken")): Broken()})
    with pytest.raises(RuntimeError, match="broken failed on map 3 of seed 5"):
        run.evaluate_map(RandomMaps(), [PlannerSpec("broken")], seed=5, index=3, persons=1)
