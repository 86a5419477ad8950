import numpy as np
import pytest
import shapely

from wisar_planner import GaussianMixture, Grid, RasterMap, SearchArea, SearchProblem


@pytest.fixture
def paper_problem():
    """Make the paper's random problem for a seed."""

    def make(seed: int) -> SearchProblem:
        return SearchProblem.paper(np.random.default_rng(seed))

    return make


@pytest.fixture
def far_modes() -> SearchProblem:
    """Two patches of a raster map, 800 m apart, with nothing in between; start beside one."""
    probability = np.zeros((40, 100))
    probability[18:22, 4:8] = 1.0
    probability[18:22, 84:88] = 3.0
    grid = Grid(0.0, 0.0, 10.0, 100, 40)
    return SearchProblem(
        pdm=RasterMap(probability / probability.sum(), grid),
        area=SearchArea.rectangle(0.0, 0.0, 1000.0, 400.0),
        start=np.array([60.0, 200.0]),
        step_length=20.0,
        swath_radius=10.0,
        max_distance=1600.0,
    )


@pytest.fixture
def holed_problem() -> SearchProblem:
    """A square with a square hole in its middle, the map's peak inside the hole."""
    shell = shapely.box(0.0, 0.0, 100.0, 100.0)
    hole = shapely.box(35.0, 35.0, 65.0, 65.0)
    return SearchProblem(
        pdm=GaussianMixture(np.ones(1), np.array([[50.0, 50.0]]), 400.0 * np.eye(2)[None]),
        area=SearchArea.from_polygon(shell.difference(hole)),
        start=np.array([10.0, 10.0]),
        step_length=8.0,
        swath_radius=2.5,
        max_distance=400.0,
    )
