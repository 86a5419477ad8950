import numpy as np
import pytest
import shapely
import torch

from wisar_planner import GaussianMixture, SearchArea, SearchPath, SearchProblem
from wisar_planner.errors import InvalidInput
from wisar_planner.search.bound import upper_bound
from wisar_planner.search.reward import scaled_reward, shaped_reward
from wisar_planner.training.paper.environment import PaperEnvironment, TaskSettings
from wisar_planner.training.worlds import WorldDistribution

SIDE = 150.0
END = WorldDistribution().side - 21.0


def make(count=4, seed=0, **task):
    return PaperEnvironment(count, TaskSettings(**task), torch.Generator().manual_seed(seed))


def problem_of(environment, b):
    """The search in metres, for the library's own exact computations."""
    means = SIDE * environment.means[b].double().numpy()
    g = len(means)
    return SearchProblem(
        pdm=GaussianMixture(np.full(g, 1.0 / g), means, np.repeat(500.0 * np.eye(2)[None], g, 0)),
        area=SearchArea.rectangle(0.0, 0.0, SIDE, SIDE),
        start=SIDE * environment.path[b, 0].double().numpy(),
        step_length=8.0,
        swath_radius=2.5,
        max_distance=8.0 * environment.task.waypoints,
    )


def fly(environment, turn, seed=0):
    """Fly random walks to their end; return the rewards, (B, N)."""
    rng = np.random.default_rng(seed)
    heading = rng.uniform(-1.0, 1.0, environment.count)
    rewards = []
    for _ in range(environment.task.waypoints):
        heading = (heading + rng.normal(0.0, turn, environment.count) + 1.0) % 2.0 - 1.0
        rewards.append(environment.step(torch.tensor(heading, dtype=torch.float32)))
    return torch.stack(rewards, dim=1).numpy()


@pytest.mark.parametrize("turn", [0.1, 0.4])
def test_reward_is_that_of_the_exact_gains(turn):
    environment = make(12, seed=5)
    rewards = fly(environment, turn)
    kinds = set()
    for b in range(environment.count):
        problem = problem_of(environment, b)
        path = SearchPath(SIDE * environment.path[b].double().numpy(), 2.5)
        gains = np.diff(path.probability_at_waypoints(problem.pdm))
        wanted = shaped_reward(problem, gains, path.waypoints[1:])
        # Where a gain lies at the threshold, the raster may put it on the other side.
        sure = np.abs(scaled_reward(problem, gains) - environment.task.epsilon) > 0.03
        assert sure.mean() > 0.8
        np.testing.assert_allclose(rewards[b][sure], wanted[sure], atol=0.02, rtol=0.05)
        kinds |= {"outside" if r == -1.0 else "little" if r == -0.5 else "earned" for r in wanted}
    assert kinds == {"outside", "little", "earned"}


def test_weights_of_the_reward_are_used():
    weights = {"epsilon": 0.3, "w_oob": 3.0, "w_r": 2.0, "w_0": 0.7}
    plain, weighed = make(8, seed=2), make(8, seed=2, **weights)
    one, other = fly(plain, 0.3), fly(weighed, 0.3)
    assert torch.equal(plain.path, weighed.path)
    scaled = np.where(one > 0.0, one / 0.5, 0.0)
    wanted = np.where(one == -1.0, -3.0, np.where(scaled > 0.3, 2.0 * scaled, -0.7))
    np.testing.assert_allclose(other, wanted, rtol=1e-5)


@pytest.mark.parametrize("gaussians", [4, 1])
def test_probability_seen_is_the_cubatures(gaussians):
    environment = make(6, seed=3, gaussians=gaussians)
    fly(environment, 0.2)
    for b in range(environment.count):
        problem = problem_of(environment, b)
        assert environment.in_area[b] == pytest.approx(problem.probability_in_area, rel=1e-4)
        path = SearchPath(SIDE * environment.path[b].double().numpy(), 2.5)
        # The raster ends 21 m beyond the low borders; its cells are a metre wide.
        near = path.seen_area().intersection(shapely.box(-21.0, -21.0, END, END))
        seen = problem.pdm.integrate(near)
        assert environment.seen[b] == pytest.approx(seen, rel=0.02, abs=1e-4)
    assert not bool((environment.path.abs() <= 1.0).all())  # some of it was outside


def test_maps_are_uniform_and_new_in_every_round():
    environment = make(100, waypoints=2)
    first = environment.means.clone()
    environment.begin()
    assert not torch.equal(first, environment.means)
    for values in (environment.means, environment.path[:, 0]):
        assert 0.0 <= values.min() < 0.05
        assert 0.95 < values.max() <= 1.0
        assert values.mean().item() == pytest.approx(0.5, abs=0.07)


def test_bound_is_the_librarys():
    environment = make(5, seed=8)
    for b in range(environment.count):
        found = (environment.bound / environment.in_area)[b].item()
        assert found == pytest.approx(upper_bound(problem_of(environment, b)), rel=0.02)


@pytest.mark.parametrize(
    ("field", "value"),
    [("waypoints", 0), ("gaussians", 0), ("epsilon", -0.1), ("w_r", float("nan"))],
)
def test_wrong_settings_are_refused(field, value):
    with pytest.raises(InvalidInput, match=f"^{field} must"):
        TaskSettings(**{field: value})
