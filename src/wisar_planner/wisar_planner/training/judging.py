"""How good a policy is: its flights on maps that no training meets."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import NamedTuple

import torch
from torch import Tensor

from wisar_planner.policy.model import Model
from wisar_planner.policy.observation import Observation
from wisar_planner.policy.rollout import Terrain, fly
from wisar_planner.search.bound import upper_bound
from wisar_planner.search.path import SearchPath
from wisar_planner.search.problem import SearchProblem
from wisar_planner.training.ablation import make_environment
from wisar_planner.training.divergence import check_finite
from wisar_planner.training.problems import random_problems
from wisar_planner.training.processes import in_processes
from wisar_planner.training.worlds import WorldDistribution


class Flights(NamedTuple):
    """What a policy saw on n maps.

    Attributes
    ----------
    efficiency : (n,)
        Probability efficiency e_p of each flight.
    share : (n,)
        The same as a share of the bound, the most probable ground that fits into the swath.
    figures : dict of str to float
        What else there is to tell.
    exact : bool
        Whether both are of the exact seen probability instead of a raster's.
    """

    efficiency: Tensor
    share: Tensor
    figures: dict[str, float]
    exact: bool = False


@torch.no_grad()
def fly_maps(
    act: Callable[[Observation], Tensor],
    maps: int,
    generator: torch.Generator,
    worlds: WorldDistribution | None = None,
    ablation: str = "",
) -> Flights:
    """Fly a policy once on each of some random maps.

    Parameters
    ----------
    act : callable
        From what searches show to their turns, see `SearchEnvironment.step`.
    maps : int
        Number of maps.
    generator : torch.Generator
        Source of the maps, on the device where to compute.
    worlds : WorldDistribution, optional
        What the maps look like; the paper's setup unless given.
    ablation : str
        The policy's ablation.
    """
    environment = make_environment(ablation, maps, worlds or WorldDistribution(), generator)
    unseen, steps = environment.unseen, environment.steps.clone()
    in_area = environment.in_area.clone()
    step_area = (2.0 * unseen.radius * unseen.step).clone()
    swept = step_area * steps + math.pi * unseen.radius.square()
    seen = environment.seen.clone()
    searching = torch.ones_like(seen)
    for _ in range(int(steps.max())):
        reward, done = environment.step(act(environment.observe()))
        seen += searching * reward * step_area
        searching = searching * ~done
    return Flights(seen / in_area, seen / swept, {})


@torch.no_grad()
def fly_maps_exactly(
    act: Callable[[Observation], Tensor],
    maps: int,
    generator: torch.Generator,
    ablation: str,
    on_flown: Callable[[int], None],
) -> Flights:
    """Fly a policy as `fly_maps` does in the paper's setup, judged as `fly_problem` does.

    `on_flown` is told how many more maps were flown.
    """
    worlds = WorldDistribution()
    same = torch.Generator(generator.device)
    same.set_state(generator.get_state())
    environment = make_environment(ablation, maps, worlds, generator)
    points = [environment.position.clone()]
    for _ in range(int(environment.steps.max())):
        environment.step(act(environment.observe()))
        points.append(environment.reached)
    waypoints = torch.stack(points, dim=1).double().cpu().numpy()
    efficiency, share = torch.zeros(maps), torch.zeros(maps)
    for k, problem in enumerate(random_problems(maps, 0, worlds, same)):
        path = SearchPath(waypoints[k], problem.swath_radius)
        efficiency[k] = path.probability_efficiency(problem)
        share[k] = efficiency[k] / upper_bound(problem)
        on_flown(1)
    return Flights(efficiency, share, {}, exact=True)


def fly_problem(problem: SearchProblem, model: Model) -> tuple[float, float]:
    """Fly a policy once as planners do; return e_p and the share of the bound, both exact.

    The policy is shown the problem as plans show it, see `rollout.view_scale`. What it sees is the
    exact seen probability and the bound is `search.bound.upper_bound`: the policy's own raster
    tells up to a hundredth less, see docs/policy.md.
    """
    waypoints = fly(problem, Terrain.of(problem), model)[0]
    path = SearchPath(waypoints, problem.swath_radius)
    efficiency = path.probability_efficiency(problem)
    return efficiency, efficiency / upper_bound(problem)


def fly_problems(problems: Iterable[SearchProblem], model: Model) -> Iterator[tuple[float, float]]:
    """Yield what `fly_problem` returns for each problem, flown in several processes."""
    yield from in_processes(fly_problem, ((problem, model) for problem in problems))


def planned(actor: Mapping[str, Tensor], distribution: str) -> Model:
    """Return a policy as planners fly it, as it is now.

    Parameters
    ----------
    actor : mapping of str to Tensor
        Parameters of its network.
    distribution : str
        How its turns are distributed, one of `heading.DISTRIBUTIONS`.

    Raises
    ------
    Diverged
        When a parameter is not finite.
    """
    for each in actor.values():
        check_finite("parameters of the policy", each)
    weights = {name: each.detach().cpu().numpy().copy() for name, each in actor.items()}
    return Model(weights, {"distribution": distribution})
