"""The parts of proximal policy optimisation: turns, experience, imitation."""

import dataclasses
import math

import numpy as np
import pytest
import torch
from scipy import stats

from wisar_planner.errors import InvalidInput
from wisar_planner.policy.heading import ACTOR_OUTPUTS, DIRECTED, SPACING, likeliest_turn, wrapped
from wisar_planner.policy.network import MIRROR, forward
from wisar_planner.policy.observation import DIRECTIONS, Observation
from wisar_planner.training.networks import optimizer_of, state_value
from wisar_planner.training.ppo.config import PpoConfig
from wisar_planner.training.ppo.experience import Experience, fly_window, make_environments
from wisar_planner.training.ppo.imitation import imitate_step
from wisar_planner.training.ppo.run import PpoRun
from wisar_planner.training.ppo.turns import Turns, log_likelihood, random_turns
from wisar_planner.training.worlds import WorldDistribution

CPU = torch.device("cpu")
CONFIG = PpoConfig(
    start="sac_improved", environments=12, window=5, batch=16, channels=8, blocks=2,
    steps=2000, imitation_steps=60, value_steps=60,
    worlds=WorldDistribution(paper_share=0.5, sides=(10.0, 12.0), budgets=(5, 9)),
)  # fmt: skip


@pytest.fixture
def run():
    return PpoRun(CONFIG, None, CPU)


@pytest.fixture
def flown(run, generator):
    """Experience of the searches of the paper's setup, with all that it was made of."""
    environment = make_environments(CONFIG, generator)[0]
    return fly_window(CONFIG, environment, run.actor, run._value, 0.02, generator)


def random_output(count, seed=1):
    rng = np.random.default_rng(seed)
    return torch.tensor(rng.normal(size=(ACTOR_OUTPUTS, count, DIRECTIONS)), dtype=torch.float32)


def test_the_likelihood_is_that_of_a_direction_and_a_normal_deviation():
    output, noise = random_output(40), 0.03
    turns = random_turns(output, noise, torch.Generator().manual_seed(2))
    found, entropy = log_likelihood(output, turns, noise)
    logits = output[0].double().numpy()
    shares = np.exp(logits) / np.exp(logits).sum(axis=1, keepdims=True)
    rows = np.arange(40)
    centre = SPACING * np.tanh(output[1].double().numpy()[rows, turns.direction])
    normal = stats.norm(centre, noise)
    expected = np.log(shares[rows, turns.direction]) + normal.logpdf(turns.deviation)
    constant = -math.log(noise * math.sqrt(2.0 * math.pi))
    np.testing.assert_allclose(found + constant, expected, rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(entropy, stats.entropy(shares, axis=1), rtol=1e-4)


def test_turns_are_drawn_as_the_policy_says():
    output = random_output(1).expand(-1, 20_000, -1)
    turns = random_turns(output, 0.01, torch.Generator().manual_seed(3))
    drawn = torch.bincount(turns.direction, minlength=DIRECTIONS).numpy()
    shares = torch.softmax(output[0, 0], dim=0).numpy()
    assert stats.chisquare(drawn, 20_000 * shares / shares.sum()).pvalue > 1e-4
    offsets = SPACING * torch.tanh(output[1, 0])
    apart = turns.deviation - offsets[turns.direction]
    assert float(apart.mean()) == pytest.approx(0.0, abs=4 * 0.01 / math.sqrt(20_000))
    assert float(apart.std()) == pytest.approx(0.01, rel=0.05)


@pytest.mark.parametrize("direction", [0, 9, 16, 31])
def test_a_turn_is_its_direction_and_deviation(direction):
    turn = Turns(torch.tensor([direction]), torch.tensor([0.05])).turn()
    assert -1.0 <= float(turn) < 1.0
    expected = direction * 2.0 / DIRECTIONS + 0.05
    assert float(wrapped(turn - expected)) == pytest.approx(0.0, abs=1e-6)


def test_the_experience_holds_what_the_policy_saw_when_it_turned(run, flown):
    """So the first update starts from the likelihood that the turns were drawn with."""
    shown = Observation(flown.view.float(), flown.numbers)
    found, _ = log_likelihood(
        forward(run.actor, *shown)[0], Turns(flown.direction, flown.deviation), 0.02
    )
    torch.testing.assert_close(found, flown.log_likelihood, rtol=1e-4, atol=1e-4)
    value = state_value(run._value, shown)
    torch.testing.assert_close(flown.returns - value, flown.surprise, rtol=1e-3, atol=1e-3)


def test_advantages_have_mean_zero_and_deviation_one(flown):
    assert float(flown.advantage.mean()) == pytest.approx(0.0, abs=1e-5)
    assert float(flown.advantage.std(correction=0)) == pytest.approx(1.0, rel=1e-5)
    # What is taken off is the same everywhere.
    together = np.corrcoef(flown.advantage, flown.surprise)[0, 1]
    assert together == pytest.approx(1.0, rel=1e-5)


def test_what_looks_mirrored_is_flown_mirrored(run, generator, monkeypatch):
    """The turn that is flown is the mirror image of that drawn for the mirrored view."""
    environment = make_environments(CONFIG, generator)[0]
    shown, flown = [], []
    observe, step = environment.observe, environment.step
    monkeypatch.setattr(environment, "observe", lambda: shown.append(observe()) or shown[-1])
    monkeypatch.setattr(environment, "step", lambda turn: flown.append(turn) or step(turn))
    found = fly_window(CONFIG, environment, run.actor, run._value, 0.02, generator)
    drawn = Turns(found.direction, found.deviation).turn()
    seen = torch.cat([each.view for each in shown[:-1]])
    straight = (found.view.float() - seen).abs().amax(dim=(1, 2)) < 2e-3
    mirrored = (found.view.float() - seen[:, MIRROR]).abs().amax(dim=(1, 2)) < 2e-3
    assert (straight | mirrored).all()
    assert 0.2 < float(straight.float().mean()) < 0.8
    sign = torch.where(straight, 1.0, -1.0)
    torch.testing.assert_close(torch.cat(flown), sign * drawn)


def test_batches_hold_each_state_once(flown, generator):
    batches = list(flown.batches(16, generator))
    assert [len(each.view) for each in batches[:-1]] == [16] * (len(batches) - 1)
    together = Experience(*(torch.cat(each) for each in zip(*batches, strict=True)))
    order = torch.argsort(together.log_likelihood)
    expected = torch.argsort(flown.log_likelihood)
    for name in ("view", "direction", "advantage", "returns"):
        ours, theirs = getattr(together, name)[order], getattr(flown, name)[expected]
        torch.testing.assert_close(ours.float(), theirs.float())


def test_the_papers_setup_and_other_worlds_have_an_environment_each(generator):
    paper, others = make_environments(dataclasses.replace(CONFIG, environments=10), generator)
    assert len(paper.steps) == len(others.steps) == 5
    assert (paper.steps == 64.0).all()
    assert (others.steps <= 9.0).all()
    only = dataclasses.replace(CONFIG, worlds=WorldDistribution())
    assert [len(each.steps) for each in make_environments(only, generator)] == [12]


def test_a_gain_makes_the_turn_likelier_and_a_loss_less_likely(run, flown):
    """One update with a small rate, seen by its effect on the likelihood."""
    shown = Observation(flown.view.float(), flown.numbers)
    turns = Turns(flown.direction, flown.deviation)

    def likelihood():
        return log_likelihood(forward(run.actor, *shown)[0], turns, 0.02)[0]

    before = likelihood().detach()
    change = torch.exp(likelihood() - flown.log_likelihood)
    run._optimizers["actor"].param_groups[0]["lr"] = 1e-5
    run._update("actor", -(change * flown.advantage).mean())
    with torch.no_grad():
        moved = (likelihood() - before) * flown.advantage
    assert float(moved.mean()) > 0.0


def test_imitation_comes_near_the_teacher(run, generator):
    environment = make_environments(dataclasses.replace(CONFIG, environments=32), generator)[0]

    def teacher(shown):
        """Turn to the brightest ground nearby."""
        return wrapped(SPACING * shown.view[:, :, :4].sum(dim=-1).argmax(dim=1).float())

    def near():
        shown = environment.observe()
        with torch.no_grad():
            turn = likeliest_turn(forward(run.actor, *shown)[0], DIRECTED)
        return float((wrapped(turn - teacher(shown)).abs() < SPACING).float().mean())

    before = near()
    optimizer = optimizer_of(run.actor, 1e-2)
    losses = [
        imitate_step(environment, run.actor, teacher, optimizer, 1e-2, i / 150) for i in range(150)
    ]
    assert np.mean(losses[-10:]) < np.mean(losses[:10])
    assert before < 0.2
    assert near() > 0.4


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"algorithm": "sac"}, "algorithm must be ppo"),
        ({"steps": 100}, "steps must be at least 121"),
        ({"steps": 120}, "steps must be at least 121"),
        ({"environments": 0}, "environments must be at least 1"),
        ({"noise": (0.0, 0.1)}, "noise must be above 0"),
        ({"clip": math.inf}, "clip must be above 0 and finite"),
        ({"trace": 1.5}, "trace must be from 0 to 1"),
        ({"entropy": (math.nan, 0.0)}, "entropy must be finite"),
        ({"rate": 0.0}, "rate must be above 0"),
    ],
)
def test_configurations_that_cannot_be_right_are_refused(change, words):
    with pytest.raises(InvalidInput, match=words):
        dataclasses.replace(CONFIG, **change)
