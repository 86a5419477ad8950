"""Compiled flights, against the array code that trains."""

import dataclasses
import math

import numpy as np
import pytest
import shapely

from wisar_planner import SearchArea, SearchProblem
from wisar_planner.policy import heading
from wisar_planner.policy.flight_kernels import decide
from wisar_planner.policy.heading import (
    ACTOR_OUTPUTS,
    DISTRIBUTIONS,
    GAUSSIAN,
    SPACING,
    actor_distribution,
    likeliest_turn,
)
from wisar_planner.policy.model import find_model, load_model
from wisar_planner.policy.network import forward
from wisar_planner.policy.observation import DIRECTIONS, observe
from wisar_planner.policy.rollout import Terrain, fly
from wisar_planner.policy.unseen_map import UnseenMap, window_side

QUIET = np.zeros(DIRECTIONS, np.float32)
RING = np.arange(DIRECTIONS)


def output(logits, others=0.0):
    return np.array([logits, np.broadcast_to(others, np.shape(logits))], dtype=np.float32)


def flown_in_arrays(problem, model, noise):
    """Return the path and what it sees, by the parts that are not compiled."""
    terrain = Terrain.of(problem)
    one = np.ones(1, np.float32)
    unseen = UnseenMap(
        terrain.density.copy(), one * np.float32(terrain.scale * terrain.step),
        one * np.float32(terrain.radius), window_side(terrain.step, terrain.radius),
    )  # fmt: skip
    origin = np.array([terrain.grid.x0, terrain.grid.y0])

    def cells(point):
        return ((point - origin) / terrain.grid.cell).astype(np.float32)[None]

    where, direction = problem.start, terrain.heading
    seen = float(unseen.see(cells(where), cells(where))[0])
    path = [where]
    for k in range(problem.steps):
        left = np.float32([(problem.steps - k) / terrain.scale])
        shown = observe(unseen, cells(where), np.float32([direction]), left)
        found = forward(model.weights, *shown)[0]
        if model.distribution == GAUSSIAN:
            mean, log_std = actor_distribution(found)
            turn = np.tanh(mean + np.exp(log_std) * noise[k, 0])[0]
        else:
            logits, offsets = heading.directions_and_offsets(found)
            best = int(np.argmax(logits[0] + noise[k]))
            turn = SPACING * best + offsets[0, best]
        wanted = direction + math.pi * float(turn)
        offs = [(-1) ** n * math.ceil(n / 2) * 2.0 * math.pi / 32 for n in range(33)]
        for off in offs:
            direction = wanted + off
            end = where + problem.step_length * np.array([np.cos(direction), np.sin(direction)])
            if shapely.contains_xy(problem.area.polygon, *end):
                break
        seen += float(unseen.see(cells(where), cells(end))[0])
        where = end
        path.append(where)
    return np.array(path), seen * terrain.unit / (2.0 * terrain.radius * terrain.step)


@pytest.mark.parametrize("random", [False, True])
@pytest.mark.parametrize(
    ("name", "radius", "start"),
    [("sac", 2.5, (75.0, 40.0)), ("sac", 4.1, (1.0, 149.0)), ("sac_plain", 2.5, (149.0, 1.0))],
)
def test_a_compiled_flight_is_that_of_the_array_code(name, radius, start, random):
    """In a corner, with another swath and so another scale, too."""
    model = load_model(find_model(name))
    problem = dataclasses.replace(
        SearchProblem.paper(np.random.default_rng(5), start=start),
        swath_radius=radius, max_distance=20 * 8.0,
    )  # fmt: skip
    noise, told = np.zeros((problem.steps, DIRECTIONS), np.float32), []
    if random:
        rng = np.random.default_rng(7)
        noise = np.concatenate([model.noise(rng, 1) for _ in range(problem.steps)])
    path = fly(
        problem, Terrain.of(problem), model, rng=np.random.default_rng(7) if random else None,
        on_step=lambda seen: bool(told.append(float(seen[0]))),
    )[0]  # fmt: skip
    expected, seen = flown_in_arrays(problem, model, noise)
    np.testing.assert_allclose(path, expected, atol=0.02)
    assert len(told) == problem.steps
    assert told[-1] == pytest.approx(seen, rel=1e-3)


@pytest.mark.parametrize("distribution", DISTRIBUTIONS)
def test_the_likeliest_turn_is_that_of_the_array_code(distribution):
    raw = np.random.default_rng(6).normal(size=(ACTOR_OUTPUTS, 90, DIRECTIONS)).astype(np.float32)
    ours = [decide(raw[:, b].copy(), distribution == GAUSSIAN, QUIET) for b in range(90)]
    apart = heading.wrapped(np.array(ours) - likeliest_turn(raw, distribution))
    np.testing.assert_allclose(apart, 0.0, atol=1e-6)


def test_random_turns_come_as_often_as_the_logits_say():
    logits = np.where(RING == 3, np.log(3.0), np.where(RING == 20, 0.0, -30.0))
    noise = np.random.default_rng(5).gumbel(size=(4000, DIRECTIONS)).astype(np.float32)
    turns = np.array([decide(output(logits), False, each) for each in noise])
    left = np.isclose(turns, 3 * SPACING)
    assert np.isclose(turns[~left], 20 * SPACING - 2.0).all()
    assert left.mean() == pytest.approx(0.75, abs=0.03)


def test_random_gaussian_turns_spread_as_the_certainty_says():
    raw = output(50.0 * (RING == 2), 0.3)
    mean, log_std = actor_distribution(raw[:, None])
    noise = np.random.default_rng(5).standard_normal((4000, DIRECTIONS), dtype=np.float32)
    turns = np.arctanh([decide(raw, True, each) for each in noise])
    spread = float(np.exp(log_std[0]))
    assert turns.mean() == pytest.approx(float(mean[0]), abs=4 * spread / np.sqrt(4000))
    assert turns.std() == pytest.approx(spread, rel=0.05)


def test_a_search_that_cannot_move_ends():
    problem = SearchProblem.paper(np.random.default_rng(1), start=(75.0, 75.0))
    tight = SearchArea.rectangle(71.0, 71.0, 78.0, 78.0)
    problem = dataclasses.replace(problem, area=tight)
    model = load_model(find_model("sac"))
    path = fly(problem, Terrain.of(problem), model)[0]
    np.testing.assert_array_equal(path, problem.start[None])
