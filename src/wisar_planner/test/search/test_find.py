import math

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from wisar_planner.errors import InvalidInput
from wisar_planner.pdm import GaussianMixture
from wisar_planner.search import SearchPath, distance_to_find


def test_entry_into_the_disc_is_exact():
    path = SearchPath([[0, 0], [10, 0], [10, 10]], 2.0)
    expected = {
        (0, 0): 0.0,
        (-2, 0): 0.0,
        (5, 0): 3.0,
        (5, 1.2): 3.4,
        (5, 2): 5.0,
        (5, 2.01): np.inf,
        (13, 5): np.inf,
        (11, 11): 10.0 + 11.0 - math.sqrt(3.0),
        (10, 12.1): np.inf,
    }
    found = distance_to_find(path, list(expected))
    np.testing.assert_allclose(found, list(expected.values()))


@given(st.integers(0, 10_000))
def test_it_agrees_with_walking_the_path(seed):
    rng = np.random.default_rng(seed)
    path = SearchPath(rng.uniform(0, 30, (6, 2)), 2.5)
    persons = rng.uniform(-3, 33, (20, 2))
    found = distance_to_find(path, persons)
    walked = np.linspace(0, path.length, 4001)
    near = np.linalg.norm(path.point_at(walked)[:, None] - persons, axis=2) <= path.swath_radius
    seen = near.any(axis=0)
    first = walked[near.argmax(axis=0)]
    # Walking finds nobody earlier, and nobody more than a step later who stays in sight so long.
    assert (found[seen] <= first[seen] + 1e-9).all()
    in_sight = np.linalg.norm(path.point_at(found[seen]) - persons[seen], axis=1)
    assert (in_sight <= path.swath_radius + 1e-9).all()
    apart = shapely.distance(shapely.LineString(path.waypoints), shapely.points(persons))
    np.testing.assert_array_equal(np.isfinite(found), apart <= path.swath_radius)


def test_the_share_found_is_the_probability_seen():
    pdm = GaussianMixture([1.0], [[10, 10]], [[[80, 0], [0, 80]]])
    path = SearchPath([[0, 0], [12, 8], [20, 20], [5, 15]], 2.5)
    persons = pdm.sample(100_000, np.random.default_rng(0))
    share = np.isfinite(distance_to_find(path, persons)).mean()
    assert share == pytest.approx(path.seen_probability(pdm), abs=0.006)


def test_a_path_of_one_point():
    path = SearchPath([[0, 0]], 1.0)
    np.testing.assert_array_equal(distance_to_find(path, [[0.5, 0.5], [2, 0]]), [0.0, np.inf])
    assert distance_to_find(path, np.empty((0, 2))).shape == (0,)
    with pytest.raises(InvalidInput, match="persons"):
        distance_to_find(path, [[math.nan, 0]])
