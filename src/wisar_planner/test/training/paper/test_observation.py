import math

import numpy as np
import pytest
import torch

from wisar_planner.training.paper.environment import PaperEnvironment, TaskSettings
from wisar_planner.training.paper.observation import Layout, observe

SIDE = 150.0


@pytest.mark.parametrize(("waypoints", "gaussians"), [(64, 4), (1, 1), (5, 3), (40, 7)])
def test_size_is_the_papers(waypoints, gaussians):
    layout = Layout(waypoints, gaussians)
    assert layout.size == 2 * waypoints + 6 * gaussians + 4
    environment = PaperEnvironment(
        3, TaskSettings(waypoints, gaussians), torch.Generator().manual_seed(0)
    )
    observation = environment.observe()
    assert observation.shape == (3, layout.size)
    assert observation.dtype == torch.float32
    parts = layout.split(observation)
    assert list(parts) == ["path", "pdm", "position", "out_of_bounds", "steps"]
    assert torch.equal(torch.cat(list(parts.values()), dim=1), observation)


def expected(path_m, flown, means_m, waypoints):
    """The observation of one search, written out number by number from positions in metres."""
    numbers = [path_m[i][0] / SIDE if i <= flown else 0.0 for i in range(waypoints)]
    numbers += [path_m[i][1] / SIDE if i <= flown else 0.0 for i in range(waypoints)]
    for x, y in means_m:
        numbers += [x / SIDE, y / SIDE, 500.0 / SIDE**2, 0.0, 0.0, 500.0 / SIDE**2]
    x, y = path_m[flown]
    inside = 0.0 <= x <= SIDE and 0.0 <= y <= SIDE
    return [*numbers, x / SIDE, y / SIDE, float(inside), flown / waypoints]


@pytest.mark.parametrize(("waypoints", "gaussians"), [(64, 4), (6, 2)])
def test_it_is_what_an_independent_computation_gives(waypoints, gaussians):
    rng = np.random.default_rng(3)
    environment = PaperEnvironment(
        2, TaskSettings(waypoints, gaussians), torch.Generator().manual_seed(1)
    )
    start_m = SIDE * environment.position.double().numpy()
    means_m = SIDE * environment.means.double().numpy()
    paths = [[tuple(p)] for p in start_m]
    for flown in range(waypoints):
        found = environment.observe().numpy()
        for b, path in enumerate(paths):
            np.testing.assert_allclose(
                found[b], expected(path, flown, means_m[b], waypoints), atol=2e-6
            )
        action = rng.uniform(-1.0, 1.0, 2)
        environment.step(torch.tensor(action, dtype=torch.float32))
        for b, path in enumerate(paths):
            u = math.pi * (action[b] + 1.0)
            path.append((path[-1][0] + 8.0 * math.cos(u), path[-1][1] + 8.0 * math.sin(u)))


def test_what_is_not_flown_yet_does_not_show():
    layout = Layout(4, 1)
    path = torch.rand(1, 5, 2)
    other = path.clone()
    other[:, 3:] = 7.0
    means, flown = torch.rand(1, 1, 2), torch.tensor([2])
    assert torch.equal(
        observe(layout, path, flown, means, 0.02), observe(layout, other, flown, means, 0.02)
    )
    assert not torch.equal(
        observe(layout, path, flown + 1, means, 0.02),
        observe(layout, other, flown + 1, means, 0.02),
    )


@pytest.mark.parametrize(
    ("position", "flag"),
    [((0.5, 0.5), 1.0), ((1.0, 0.0), 1.0), ((-0.01, 0.5), 0.0), ((0.5, 1.01), 0.0)],
)
def test_out_of_bounds_is_one_inside(position, flag):
    layout = Layout(2, 1)
    path = torch.tensor([[position] * 3])
    observation = observe(layout, path, torch.tensor([0]), torch.rand(1, 1, 2), 0.02)
    assert layout.split(observation)["out_of_bounds"].item() == flag
