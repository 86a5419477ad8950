import numpy as np
import pytest
import torch

from wisar_planner import GaussianMixture, SearchArea, SearchPath, SearchProblem
from wisar_planner.policy.observation import (
    DIRECTIONS,
    DISTANCES,
    NUMBERS,
    VIEW_WIDTH,
    observe,
    observe_in_arrays,
    reference_density,
    step_gains,
)
from wisar_planner.policy.rollout import Terrain
from wisar_planner.policy.unseen_map import OUTSIDE, UnseenMap, window_side


@pytest.fixture
def scene(make_world, fly):
    """A world in its reference density, the area's eastern part cut off, and a path flown in it.

    Returns a function that turns the scene by quarter turns, or mirrors it east to west, and
    observes it.
    """
    world = make_world(1, 0.3125)
    density = world.mass / world.mass.mean()
    density[:, 3 * world.side // 4 :] = OUTSIDE
    path = world.path(12, 0.5)

    def show(quarters=0, mirrored=False):
        raster, points = density, path - 0.5 * world.side
        for _ in range(quarters):
            raster, points = raster.T[:, ::-1], np.stack([-points[:, 1], points[:, 0]], axis=1)
        if mirrored:
            raster, points = raster[:, ::-1], points * np.float32([-1.0, 1.0])
        points = points + np.float32(0.5 * world.side)
        unseen = world.unseen(raster)
        fly(unseen, points)
        along = points[-1] - points[-2]
        heading = np.arctan2(along[1:], along[:1])
        return observe(unseen, points[-1:], heading, np.float32([20.0]))

    return show


def test_what_is_shown_has_the_sizes_that_the_networks_take(scene):
    view, numbers = scene()
    assert view.shape == (1, DIRECTIONS, VIEW_WIDTH)
    assert numbers.shape == (1, NUMBERS)
    assert view.dtype == numbers.dtype == np.float32
    assert view.min() == OUTSIDE
    assert len(np.unique(view)) > DIRECTIONS


@pytest.mark.parametrize("quarters", [1, 2, 3])
def test_a_turned_world_looks_the_same(scene, quarters):
    for turned, straight in zip(scene(quarters), scene(), strict=True):
        np.testing.assert_allclose(turned, straight, atol=2e-4)


def test_a_mirrored_world_has_the_ring_of_directions_reversed(scene):
    mirrored, straight = scene(mirrored=True), scene()
    order = -np.arange(DIRECTIONS) % DIRECTIONS
    np.testing.assert_allclose(mirrored.view, straight.view[:, order], atol=2e-4)
    np.testing.assert_allclose(mirrored.numbers, straight.numbers, atol=1e-5)
    assert np.abs(mirrored.view - straight.view).max() > 0.1


def test_directions_count_from_the_heading_to_the_left(make_world):
    world = make_world(2, 0.3125)
    centre = np.full((1, 2), 0.5 * world.side, dtype=np.float32)
    westwards = np.broadcast_to(1.0 - np.arange(world.side) / world.side, (world.side,) * 2)
    for heading, brightest in ((0.5 * np.pi, DIRECTIONS // 4), (0.0, DIRECTIONS // 2)):
        heading = np.float32([heading])
        view = observe(world.unseen(westwards), centre, heading, np.float32([9.0])).view[0]
        near = DISTANCES < 6.0
        assert (view[:, :-1][:, near].argmax(axis=0) == brightest).all()


def test_distances_read_the_map_where_they_say(make_world):
    """On a plane, all levels give the height at the point itself."""
    world = make_world(3, 0.3125, sides=80.0)
    x = np.broadcast_to(np.arange(world.side) + 0.5, (world.side, world.side)) / world.side
    centre = np.full((1, 2), 0.5 * world.side, dtype=np.float32)
    view = observe(world.unseen(x), centre, np.float32([0.3]), np.float32([9.0])).view[0, :, :-1]
    angles = 0.3 + 2.0 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    expected = 0.5 + np.cos(angles)[:, None] * DISTANCES * world.step / world.side
    np.testing.assert_allclose(view, expected, atol=1e-4)


@pytest.mark.parametrize("radius", [0.2, 0.3125, 0.6])
def test_step_gains_are_close_to_the_exact_gains(make_world, fly, radius):
    errors, gains = [], []
    angles = 2.0 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    unit = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    for seed in range(4):
        world = make_world(seed, radius, sides=30.0)
        path = world.path(8, 0.4)
        unseen = world.unseen()
        fly(unseen, path)
        found = step_gains(unseen, path[-1:], unit[None].astype(np.float32))[0]
        seen = SearchPath(path, world.radius).seen_probability(world.pdm)
        for each, gain in zip(unit, found * 2.0 * world.radius * world.step, strict=True):
            end = path[-1] + world.step * each
            whole = SearchPath(np.concatenate([path, end[None]]), world.radius)
            gains.append(whole.seen_probability(world.pdm) - seen)
            errors.append(gain - gains[-1])
    assert np.sqrt(np.mean(np.square(errors))) < 0.04 * np.mean(gains)
    assert abs(np.mean(errors)) < 0.02 * np.mean(gains)


@pytest.mark.parametrize("show", [observe, observe_in_arrays])
def test_numpy_and_torch_show_the_same(make_world, fly, show):
    """Compiled and in array operations, as on a GPU."""
    world = make_world(4, 0.25)
    path = world.path(10, 0.6)
    unseen = world.unseen(world.mass * 5e3)
    fly(unseen, path)
    in_torch = UnseenMap(
        *(torch.tensor(each) for each in (unseen.levels[0], unseen.step, unseen.radius)),
        window_side(world.step, world.radius),
    )
    state = path[-1:], np.float32([1.0]), np.float32([7.0])
    for found, expected in zip(
        show(in_torch, *map(torch.tensor, state)), observe(unseen, *state), strict=True
    ):
        assert isinstance(found, torch.Tensor)
        np.testing.assert_allclose(found.numpy(), expected, rtol=1e-4, atol=1e-5)


def test_the_last_steps_are_told_apart(make_world):
    world = make_world(5, 0.3125)
    centre = np.full((1, 2), 0.5 * world.side, dtype=np.float32)
    numbers = [
        observe(world.unseen(), centre, np.float32([0.0]), np.float32([left])).numbers[0]
        for left in (1.0, 2.0, 64.0, 65.0, 640.0)
    ]
    assert np.isfinite(numbers).all()
    assert (np.abs(np.diff(numbers, axis=0)).max(axis=1) > 0.003).all()


def test_reference_density_of_one_gaussian_is_the_closed_form(make_world):
    """The most probable ground of area A holds 1 - exp(-A / (2 pi s^2)) of a Gaussian."""
    world = make_world(6, 0.3125)
    middle, deviation = 0.5 * world.side, 2.0 * world.step
    pdm = GaussianMixture(np.ones(1), np.full((1, 2), middle), deviation**2 * np.eye(2)[None])
    mass = pdm.rasterize(world.grid)
    for steps in (16.0, 64.0, 160.0):
        area = 2.0 * world.radius * world.step * steps
        expected = -np.expm1(-area / (2.0 * np.pi * deviation**2)) / area
        found = reference_density(world.unseen(mass), np.float32([steps]))
        assert found[0] == pytest.approx(expected, rel=0.01)


def test_reference_density_of_a_mixture_is_that_of_a_fine_raster(make_world):
    world = make_world(7, 0.3125)
    for steps in (4.0, 64.0):
        area = round(2.0 * world.radius * world.step * steps)
        expected = np.sort(world.mass.ravel())[-area:].mean()
        found = reference_density(world.unseen(), np.float32([steps]))
        assert found[0] == pytest.approx(expected, rel=0.01)


def test_reference_density_on_a_raster_smaller_than_the_swath_is_the_mean(make_world):
    world = make_world(8, 0.3125)
    found = reference_density(world.unseen(), np.float32([1e6]))
    assert found[0] == pytest.approx(world.mass.mean(), rel=1e-4)


def test_a_world_in_other_units_looks_the_same():
    shown = []
    for unit in (1.0, 10.0):
        problem = SearchProblem(
            pdm=GaussianMixture(
                [0.7, 0.3],
                np.array([[40.0, 60.0], [110.0, 20.0]]) * unit,
                np.array([np.diag([500.0, 300.0]), np.diag([200.0, 700.0])]) * unit**2,
            ),
            area=SearchArea.rectangle(0.0, 0.0, 150.0 * unit, 90.0 * unit),
            start=np.array([70.0, 30.0]) * unit,
            step_length=8.0 * unit,
            swath_radius=2.5 * unit,
            max_distance=512.0 * unit,
        )
        terrain = Terrain.of(problem)
        ones = np.ones(1, dtype=np.float32)
        unseen = UnseenMap(
            terrain.density.copy(),
            ones * terrain.scale * terrain.step,
            ones * terrain.radius,
            window_side(terrain.step, terrain.radius),
        )
        start = (problem.start - [terrain.grid.x0, terrain.grid.y0]) / terrain.grid.cell
        state = (start[None], [terrain.heading], [float(problem.steps)])
        shown.append(observe(unseen, *(np.array(each, dtype=np.float32) for each in state)))
        assert problem.steps == 64
        assert terrain.grid.cell == pytest.approx(unit * terrain.scale)
    assert shown[0].view.max() > 0.5
    for metres, decametres in zip(*shown, strict=True):
        np.testing.assert_allclose(decametres, metres, atol=1e-3)
