from pathlib import Path

import numpy as np
import pytest
import shapely
from scipy import stats

from wisar_planner.errors import InvalidInput
from wisar_planner.evaluation.scenario import Drone, FixedMap, RandomMaps, persons_in_area
from wisar_planner.pdm import GaussianMixture, Grid, RasterMap
from wisar_planner.search import SearchArea

PAPER = next(
    (p / "config/paper.yaml" for p in Path(__file__).parents if (p / "config/paper.yaml").exists()),
    Path("config/paper.yaml"),
)


def test_config_file_and_defaults_are_the_papers_setup():
    assert RandomMaps.from_ros_parameters(PAPER) == RandomMaps()
    problem = RandomMaps().problem(seed=0, index=0)
    assert problem.steps == 64
    assert problem.pdm.weights == pytest.approx([0.25] * 4)
    np.testing.assert_array_equal(problem.pdm.covariances, np.tile(500.0 * np.eye(2), (4, 1, 1)))


def test_problem_depends_on_seed_and_index_alone():
    maps = RandomMaps()
    maps.problem(seed=0, index=0)
    a, b = maps.problem(seed=3, index=5), RandomMaps().problem(seed=3, index=5)
    np.testing.assert_array_equal(a.pdm.means, b.pdm.means)
    np.testing.assert_array_equal(a.start, b.start)
    assert not np.array_equal(a.pdm.means, maps.problem(seed=4, index=5).pdm.means)


def test_means_and_starts_are_uniform_in_the_area():
    problems = [RandomMaps().problem(seed=1, index=i) for i in range(150)]
    for points in ([p.pdm.means for p in problems], [p.start[None] for p in problems]):
        for coordinate in np.concatenate(points).T:
            assert stats.kstest(coordinate / 150.0, "uniform").pvalue > 1e-4


@pytest.mark.parametrize(
    ("rule", "expected"), [("centre", (75.0, 75.0)), ((10.0, 20.0), (10.0, 20.0))]
)
def test_start_rules_with_a_known_point(rule, expected):
    np.testing.assert_array_equal(RandomMaps(start=rule).problem(0, 0).start, expected)


def test_centre_start_lies_in_an_area_that_its_bounds_middle_is_not_in():
    bent = SearchArea(shapely.box(0, 0, 150, 150).difference(shapely.box(20, 20, 150, 150)))
    scenario = FixedMap(RandomMaps().problem(0, 0).pdm, bent, "bent", Drone(), "centre")
    assert bent.contains(scenario.problem(0, 0).start[None]).all()


def test_peak_start_is_near_the_highest_density():
    problem = RandomMaps(start="peak").problem(0, 0)
    grid = Grid.covering(problem.area.bounds, 0.5)
    highest = problem.pdm.density(grid.centres().reshape(-1, 2)).max()
    assert problem.pdm.density(problem.start[None])[0] > 0.98 * highest


def test_peak_start_lies_in_an_area_narrower_than_its_cells():
    problem = RandomMaps().problem(0, 0)
    area = SearchArea.rectangle(0.0, 70.0, 200.0, 80.0)
    scenario = FixedMap(problem.pdm, area, "strip", Drone(swath_radius=30.0), "peak")
    assert area.contains(scenario.problem(0, 0).start[None]).all()


def test_peak_start_takes_a_raster_of_bounded_size(monkeypatch):
    sizes = []
    rasterize = GaussianMixture.rasterize

    def counting(self, grid):
        sizes.append(grid.rows * grid.columns)
        return rasterize(self, grid)

    monkeypatch.setattr(GaussianMixture, "rasterize", counting)
    wide = RandomMaps(Drone(), "peak", (0.0, 0.0, 20_000.0, 20_000.0), 2, (4e4, 0.0, 0.0, 4e4))
    problem = wide.problem(0, 0)
    highest = problem.pdm.density(problem.pdm.means).max()
    assert problem.pdm.density(problem.start[None])[0] > 0.98 * highest
    assert max(sizes) <= 512**2


def test_uniform_start_lies_in_an_area_of_any_shape():
    ring = shapely.box(0, 0, 100, 100).difference(shapely.box(5, 5, 95, 95))
    problem = RandomMaps().problem(0, 0)
    scenario = FixedMap(problem.pdm, SearchArea(ring), "ring", Drone())
    starts = np.array([scenario.problem(0, i).start for i in range(30)])
    assert scenario.search_area.contains(starts).all()
    assert len(np.unique(starts, axis=0)) == 30


def test_persons_lie_in_the_area_and_follow_the_map():
    problem = RandomMaps().problem(seed=0, index=2)
    persons = persons_in_area(problem, 4000, seed=0, index=2)
    assert persons.shape == (4000, 2)
    assert problem.area.contains(persons).all()
    # Quarters of the area against their exact probability.
    observed, expected = [], []
    for x in (0.0, 75.0):
        for y in (0.0, 75.0):
            quarter = shapely.box(x, y, x + 75.0, y + 75.0)
            observed.append(int(SearchArea(quarter).contains(persons).sum()))
            expected.append(problem.pdm.integrate(quarter))
    expected = 4000 * np.array(expected) / np.sum(expected)
    assert stats.chisquare(observed, expected).pvalue > 1e-4


def test_a_raster_that_reaches_beyond_its_area_gives_persons_in_the_area():
    grid = Grid(0.0, 0.0, 10.0, 20, 20)
    raster = RasterMap(np.full((20, 20), 1.0 / 400.0), grid)
    area = SearchArea.rectangle(0.0, 0.0, 40.0, 40.0)
    problem = FixedMap(raster, area, "flat", Drone()).problem(0, 0)
    persons = persons_in_area(problem, 500, seed=0, index=0)
    assert len(persons) == 500
    assert area.contains(persons).all()


def test_description_tells_maps_apart():
    grid = Grid(0.0, 0.0, 10.0, 4, 4)
    cells = np.full((4, 4), 1.0 / 16.0)
    other = cells.copy()
    other[0, 0], other[3, 3] = 0.0, 2.0 / 16.0
    area = SearchArea.rectangle(0.0, 0.0, 40.0, 40.0)
    digests = {
        FixedMap(RasterMap(c, grid), area, "same.tif", Drone()).description()["map_digest"]
        for c in (cells, other)
    }
    assert len(digests) == 2


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("a: [", "YAML"),
        ("planner: {ros__parameters: {}}", "ros__parameters"),
        ("/**: {ros__parameters: {area: [0, 0, 1, 1]}}", "components, covariance"),
        (PAPER.read_text().replace("[0.0, 0.0, 150.0, 150.0]", "[0, 1]"), "four numbers"),
        (PAPER.read_text().replace("components: 4", "components: 0"), "components"),
    ],
)
def test_wrong_config_is_refused_in_words(tmp_path, text, named):
    path = tmp_path / "setup.yaml"
    path.write_text(text)
    with pytest.raises(InvalidInput, match=named):
        RandomMaps.from_ros_parameters(path)


def test_unknown_start_rule_is_refused():
    with pytest.raises(InvalidInput, match="start"):
        RandomMaps(start="somewhere")
