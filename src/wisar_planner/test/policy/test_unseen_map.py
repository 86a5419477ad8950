import numpy as np
import pytest
import torch

from wisar_planner import SearchPath
from wisar_planner.policy.unseen_map import (
    LEVELS,
    OUTSIDE,
    RATIO,
    UnseenMap,
    margin,
    window_side,
)


@pytest.mark.parametrize("radius", [0.1, 0.2, 0.3125, 0.6, 1.0])
@pytest.mark.parametrize("turn", [0.2, 1.2])
def test_gains_agree_with_the_exact_integral(make_world, fly, radius, turn):
    exact, errors = [], []
    for seed in range(6):
        world = make_world(seed, radius, sides=30.0)
        path = world.path(24, turn)
        seen = fly(world.unseen(), path)[:, 0]
        total = SearchPath(path, world.radius).probability_at_waypoints(world.pdm)
        exact.append(np.diff(total, prepend=0.0))
        errors.append(seen - exact[-1])
    assert np.sqrt(np.mean(np.square(errors))) < 0.01 * np.mean(exact)


@pytest.mark.parametrize("radius", [0.2, 0.6])
def test_coarse_levels_stay_block_means(make_world, fly, radius):
    world = make_world(1, radius)
    unseen = world.unseen(world.mass, world.mass.T)
    fly(unseen, world.path(40, 0.7))
    assert len(unseen.levels) == LEVELS
    assert (unseen.levels[0] < 0.5 * world.mass).mean() > 0.05
    for finer, coarser in zip(unseen.levels, unseen.levels[1:], strict=False):
        rows, columns = coarser.shape[1:]
        means = finer.reshape(2, rows, RATIO, columns, RATIO).mean(axis=(2, 4))
        np.testing.assert_allclose(coarser, means, rtol=1e-5, atol=1e-9)


def test_what_is_seen_is_taken_from_the_map(make_world, fly):
    world = make_world(2, 0.3125)
    unseen = world.unseen()
    seen = fly(unseen, world.path(30, 0.5)).sum()
    assert seen == pytest.approx(world.mass.sum() - unseen.levels[0].sum(), rel=1e-4)


def test_nothing_is_seen_twice(make_world, fly):
    world = make_world(3, 0.3125)
    forth = world.path(1, 0.0)
    gains = fly(world.unseen(), np.concatenate([forth, forth[::-1][1:]]))[:, 0]
    assert gains[2] < 0.01 * gains[1]


@pytest.mark.parametrize("see", [UnseenMap.see, UnseenMap.see_in_arrays])
def test_numpy_and_torch_see_the_same(make_world, fly, see):
    """Compiled and in array operations, as on a GPU."""
    world = make_world(4, 0.2)
    unseen = world.unseen(world.mass, world.mass.T)
    in_torch = UnseenMap(
        *(torch.tensor(each) for each in (unseen.levels[0], unseen.step, unseen.radius)),
        window_side(world.step, world.radius),
    )
    path = world.path(30, 0.7)
    gains = fly(unseen, path)
    before = np.concatenate([path[:1], path[:-1]])
    for start, end, expected in zip(before, path, gains, strict=True):
        gain = see(in_torch, *(torch.tensor(np.tile(point, (2, 1))) for point in (start, end)))
        assert isinstance(gain, torch.Tensor)
        np.testing.assert_allclose(gain.numpy(), expected, rtol=1e-4, atol=1e-8)
    for level, expected in zip(in_torch.levels, unseen.levels, strict=True):
        np.testing.assert_allclose(level.numpy(), expected, rtol=1e-4, atol=1e-9)
    points = np.repeat(path[None], 2, axis=0)
    for level in range(LEVELS):
        found = in_torch.interpolated(level, torch.tensor(points))
        np.testing.assert_allclose(found, unseen.interpolated(level, points), rtol=1e-3, atol=1e-9)


def test_searches_side_by_side_are_those_alone(make_world, fly):
    world = make_world(5, 0.4)
    path = world.path(20, 0.7)
    rasters = [world.mass, world.mass.T, world.mass[::-1]]
    together = fly(world.unseen(*rasters), path)
    alone = [fly(world.unseen(raster), path)[:, 0] for raster in rasters]
    np.testing.assert_allclose(together, np.transpose(alone), rtol=1e-5)


def test_ground_outside_the_area_gains_nothing_and_stays_outside(make_world, fly):
    world = make_world(6, 0.3125)
    path = world.path(20, 0.5)
    outside = np.arange(world.side) < path[:, 0].mean()
    unseen = world.unseen(np.where(outside, OUTSIDE, world.mass))
    gains = fly(unseen, path)
    assert (unseen.levels[0][0][:, outside] == OUTSIDE).all()
    assert (gains >= 0.0).all()
    assert gains.sum() < fly(world.unseen(), path).sum()


def test_a_replaced_search_continues_as_the_other(make_world, fly):
    world = make_world(7, 0.3125)
    path = world.path(12, 0.5)
    other, unseen = world.unseen(), world.unseen(world.mass.T, world.mass)
    fly(other, path[:7])
    fly(unseen, path[:3])
    unseen.replace(np.array([1]), other)
    ends = [np.tile(point, (2, 1)) for point in path[6:8]]
    assert unseen.see(*ends)[1] == pytest.approx(other.see(*(e[:1] for e in ends))[0], rel=1e-5)
    for level, expected in zip(unseen.levels, other.levels, strict=True):
        np.testing.assert_array_equal(level[1], expected[0])


@pytest.mark.parametrize("level", range(LEVELS))
def test_interpolation_reproduces_centres_and_slopes(make_world, level):
    world = make_world(8, 0.3125)
    y, x = np.mgrid[0 : world.side, 0 : world.side] + 0.5
    unseen = world.unseen(3.0 * x - 2.0 * y, world.mass)
    points = world.rng.uniform(RATIO**level, world.side - RATIO**level, (1, 50, 2))
    found = unseen.interpolated(level, np.repeat(points, 2, axis=0).astype(np.float32))
    np.testing.assert_allclose(found[0], points[0] @ [3.0, -2.0], atol=0.01)
    centre = (np.array([[[5.5, 3.5]]] * 2) * RATIO**level).astype(np.float32)
    assert unseen.interpolated(level, centre)[1, 0] == pytest.approx(unseen.levels[level][1, 3, 5])


def test_nearest_is_the_cell_that_a_point_lies_in(make_world):
    world = make_world(9, 0.3125)
    points = np.array([[[5.1, 3.9], [0.0, 0.0], [-40.0, 7.5]]], dtype=np.float32)
    expected = world.mass[[3, 0, 7], [5, 0, 0]]
    np.testing.assert_allclose(world.unseen().nearest(points)[0], expected, rtol=1e-6)


@pytest.mark.parametrize(("step", "radius"), [(8.0, 2.5), (25.0, 2.5), (8.0, 8.0), (8.0, 40.0)])
def test_windows_and_margins_hold_the_largest_step(step, radius):
    assert window_side(step, radius) >= step + 2.0 * radius + 2.0
    assert margin(step, radius) >= radius + 1.0
