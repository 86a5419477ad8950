"""Training: the environment, its gains, and our soft actor-critic beside Stable-Baselines3's.

The peer learns in the same environment, from the same observation, laid flat, with its own network
of two hidden layers of 256 and the same batch and number of updates per step.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import numpy as np

from wisar_planner.errors import FloatArray
from wisar_planner.evaluation.bench_row import BenchRow
from wisar_planner.search import SearchPath, SearchProblem

_ENVIRONMENTS, _BATCH, _UPDATES = 64, 256, 2
_SECONDS = 20.0


def training_environment_steps(seconds: float = _SECONDS) -> BenchRow:
    """Measure steps per second of the batched environment with its observation, on one thread."""
    import torch

    torch.set_num_threads(1)
    environment = _environment()
    action = torch.zeros(_ENVIRONMENTS)

    def step() -> None:
        environment.observe()
        environment.step(action.uniform_(-1.0, 1.0))

    rate = _rate(step, seconds) * _ENVIRONMENTS
    return BenchRow(
        "training_environment_steps", "steps/s", rate, details={"environments": _ENVIRONMENTS}
    )


def training_gain_error(paths: int = 50) -> BenchRow:
    """Measure how far the raster's gains lie from the exact integral, on random walks."""
    from wisar_planner.policy.rollout import Terrain

    errors = []
    for seed in range(paths):
        rng = np.random.default_rng(seed)
        problem = SearchProblem.paper(rng)
        terrain = Terrain.of(problem)
        unseen = terrain.unseen(1)
        waypoints = _random_walk(problem, rng)
        cells = terrain.to_cells(waypoints).astype(np.float32)
        unit = terrain.unit / (2.0 * terrain.radius * terrain.step)
        unseen.see(cells[:1], cells[:1])
        ours = [float(unseen.see(a[None], b[None])[0]) * unit for a, b in itertools.pairwise(cells)]
        path = SearchPath(waypoints, problem.swath_radius)
        exact = np.diff(path.probability_at_waypoints(problem.pdm))
        errors.append((np.array(ours) - exact) / exact.mean())
    rms = float(np.sqrt(np.mean(np.square(errors))))
    return BenchRow(
        "training_gain_error",
        "% rms of the mean gain, against the exact integral",
        100.0 * rms,
        details={"paths": paths, "steps": int(np.size(errors))},
    )


def training_samples(seconds: float = _SECONDS) -> BenchRow:
    """Measure steps per second of learning, two updates of 256 transitions per 64 steps."""
    ours = _Learner()
    rate = _rate(ours.step, seconds) * _ENVIRONMENTS
    peer = _peer()
    theirs = None if peer is None else _rate(peer.step, seconds) * 16 * _ENVIRONMENTS
    return _beside_peer("training_samples", "steps/s", rate, theirs)


def training_share_of_bound(seconds: float = 180.0, maps: int = 256) -> BenchRow:
    """Measure how good policies are after the same time of training on one thread.

    Parameters
    ----------
    seconds : float
        Time of training, each.
    maps : int
        Maps that they are judged on.
    """
    ours = _Learner()
    _rate(ours.step, seconds)
    share = _share(lambda shown: ours.sac.act(shown, None), maps)
    peer = _peer()
    theirs = None
    if peer is not None:
        _rate(peer.step, seconds)
        theirs = _share(peer.act, maps)
    return _beside_peer(
        "training_share_of_bound", f"share of the bound after {seconds:g} s", share, theirs
    )


ROWS: dict[str, Callable[[], BenchRow]] = {
    "training_environment_steps": training_environment_steps,
    "training_gain_error": training_gain_error,
    "training_samples": training_samples,
    "training_share_of_bound": training_share_of_bound,
}


def _environment() -> Any:
    import torch

    from wisar_planner.training.environment import SearchEnvironment
    from wisar_planner.training.worlds import WorldDistribution

    generator = torch.Generator().manual_seed(0)
    return SearchEnvironment(_ENVIRONMENTS, WorldDistribution(), generator, stagger=True)


def _random_walk(problem: SearchProblem, rng: np.random.Generator) -> FloatArray:
    """Return waypoints of a walk that turns by at most a right angle and stays in the area."""
    points, heading = [problem.start], rng.uniform(0.0, 2.0 * np.pi)
    while len(points) <= problem.steps:
        heading += rng.uniform(-0.5, 0.5) * np.pi
        end = points[-1] + problem.step_length * np.array([np.cos(heading), np.sin(heading)])
        if problem.area.contains(end[None])[0]:
            points.append(end)
    return np.array(points)


def _rate(step: Callable[[], None], seconds: float) -> float:
    """Return how often per second a task runs."""
    step()
    count, began = 0, time.perf_counter()
    while time.perf_counter() - began < seconds:
        step()
        count += 1
    return count / (time.perf_counter() - began)


class _Learner:
    """Our learner, flying and learning step by step.

    Its rates are constant, those of config/sac.yaml averaged over a run.
    """

    def __init__(self) -> None:
        import torch

        from wisar_planner.training.sac.learner import Sac, SacSettings
        from wisar_planner.training.sac.replay import Replay

        torch.set_num_threads(1)
        settings = SacSettings(channels=32, critic_rate=1.5e-3, actor_rate=7.5e-4)
        self.sac = Sac(settings, np.random.default_rng(0), torch.device("cpu"))
        self._generator = torch.Generator().manual_seed(0)
        self._environment = _environment()
        self._replay = Replay(200_000, _ENVIRONMENTS, 3, 0.99, torch.device("cpu"))

    def step(self) -> None:
        """Fly one step of every search, then learn."""
        shown = self._environment.observe()
        action = self.sac.act(shown, self._generator)
        reward, done = self._environment.step(action)
        self._replay.add(shown, action, 0.2 * reward, done)
        if len(self._replay) < 8 * _ENVIRONMENTS:
            return
        for _ in range(_UPDATES):
            self.sac.update(
                self._replay.sample(_BATCH, self._generator), -1.5, 1.0, self._generator
            )


class _Peer:
    """The peer's learner, flying and learning 16 steps at a time."""

    def __init__(self) -> None:
        import torch

        from wisar_planner.evaluation.stable_baselines import peer_learner

        torch.set_num_threads(1)
        self._learner = peer_learner(_environment(), batch=_BATCH, updates=_UPDATES)

    def step(self) -> None:
        """Fly 16 steps of every search and learn."""
        self._learner.learn(16 * _ENVIRONMENTS, reset_num_timesteps=False)

    def act(self, shown: Any) -> Any:
        """Return the most likely turns."""
        import torch

        from wisar_planner.evaluation.stable_baselines import flat

        action, _ = self._learner.predict(flat(shown).numpy(), deterministic=True)
        return torch.as_tensor(action[:, 0])


def _peer() -> _Peer | None:
    """Return the peer's learner; None where it is not installed."""
    try:
        version("stable-baselines3")
    except PackageNotFoundError:
        return None
    return _Peer()


def _beside_peer(name: str, unit: str, ours: float, theirs: float | None) -> BenchRow:
    details = {"batch": _BATCH, "updates_per_64_steps": _UPDATES, "threads": 1}
    if theirs is None:
        return BenchRow(name, unit, ours, details=details)
    peer_name = f"stable-baselines3 {version('stable-baselines3')}, perceptron of 2 x 256"
    return BenchRow(name, unit, ours, theirs, peer_name, ours / theirs, details)


def _share(act: Callable[[Any], Any], maps: int) -> float:
    """Return the mean share of the bound of a policy on maps of the paper's setup."""
    import torch

    from wisar_planner.training.judging import fly_maps
    from wisar_planner.training.streams import validation_generator

    return float(fly_maps(act, maps, validation_generator(torch.device("cpu"))).share.mean())
