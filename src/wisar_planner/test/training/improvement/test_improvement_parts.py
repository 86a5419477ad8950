"""The parts of a round: returns, branches, critics, correction, imitation."""

import math
from functools import partial

import numpy as np
import pytest
import torch

from wisar_planner.errors import InvalidInput
from wisar_planner.policy.heading import GAUSSIAN, wrapped
from wisar_planner.policy.model import find_model, load_model
from wisar_planner.policy.network import MIRROR
from wisar_planner.policy.observation import DIRECTIONS, NUMBERS, VIEW_WIDTH, Observation
from wisar_planner.training import networks
from wisar_planner.training.environment import SearchEnvironment
from wisar_planner.training.improvement import branches
from wisar_planner.training.improvement.branches import Labels, fly_branches
from wisar_planner.training.improvement.config import ImprovementConfig
from wisar_planner.training.improvement.critics import learn_critics
from wisar_planner.training.improvement.imitation import imitate
from wisar_planner.training.improvement.value import learn_value
from wisar_planner.training.networks import corrected_turn, likeliest_turn
from wisar_planner.training.sac.learner import Sac, SacSettings
from wisar_planner.training.worlds import WorldDistribution

CPU = torch.device("cpu")


@pytest.fixture
def actor():
    sac = Sac(SacSettings(channels=4, blocks=1), np.random.default_rng(1), CPU)
    return sac.actor


@pytest.fixture
def value():
    return networks.make_networks(
        np.random.default_rng(2), networks=1, channels=4, blocks=1, device=CPU
    )


def nothing(*_: int) -> None:
    pass


def observations(count, generator):
    """Return random ones and the direction where the first column of the view is brightest."""
    view = torch.rand(count, DIRECTIONS, VIEW_WIDTH, generator=generator)
    brightest = torch.randint(DIRECTIONS, (count,), generator=generator)
    apart = torch.arange(DIRECTIONS) - brightest[:, None]
    view[..., 0] = 1.0 + torch.cos(apart * (2.0 * math.pi / DIRECTIONS))
    return Observation(view, torch.rand(count, NUMBERS, generator=generator)), brightest


@pytest.fixture(scope="module")
def shipped():
    weights = load_model(find_model("sac_improved")).weights
    return {name: torch.tensor(value) for name, value in weights.items()}


def test_the_value_learns_what_the_policy_gains(shipped, value, generator) -> None:
    """Searches of at most nine steps: their gains are known after that many."""
    short = WorldDistribution(paper_share=0.0, sides=(10.0, 12.0), budgets=(4, 9))
    config = ImprovementConfig(environments=16, valued_steps=4_096, worlds=short, batch=16)
    policy = partial(likeliest_turn, shipped, GAUSSIAN)
    learn_value(config, policy, value, generator, nothing)
    fresh = SearchEnvironment(64, short, torch.Generator().manual_seed(9))
    with torch.no_grad():
        predicted = networks.state_value(value, fresh.observe())
        gained, alive = torch.zeros(64), torch.ones(64)
        for _ in range(9):
            reward, done = fresh.step(policy(fresh.observe()))
            gained, alive = gained + alive * reward, alive * ~done
    assert float(gained.mean()) > 1.5
    assert float(predicted.mean()) == pytest.approx(float(gained.mean()), rel=0.15)
    assert float(torch.corrcoef(torch.stack([predicted, gained]))[0, 1]) > 0.6


def test_branches_gain_what_their_turns_gain(actor, value, generator, monkeypatch) -> None:
    config = ImprovementConfig(environments=32, labels=8, branches=4, horizon=3)
    policy = partial(likeliest_turn, actor, GAUSSIAN)
    states = []

    class Spy(SearchEnvironment):
        def observe(self):
            states.append({name: each.clone() for name, each in self.tensors().items()})
            return super().observe()

    monkeypatch.setattr(branches, "SearchEnvironment", Spy)
    labels = fly_branches(config, policy, value, generator, nothing)
    assert labels.turns.shape == labels.returns.shape == (8, 4)
    for branch in range(4):
        again = SearchEnvironment(8, config.worlds, torch.Generator().manual_seed(1))
        for mine, theirs in zip(again.tensors().values(), states[0].values(), strict=True):
            mine.copy_(theirs)
        gained, alive = torch.zeros(8), torch.ones(8)
        turn = labels.turns[:, branch]
        with torch.no_grad():
            for _ in range(3):
                reward, done = again.step(turn)
                gained, alive = gained + alive * reward, alive * ~done
                shown = again.observe()
                turn = policy(shown)
            gained += alive * networks.state_value(value, shown)
        assert torch.allclose(labels.returns[:, branch], gained, atol=1e-4)


def test_branches_turn_to_both_sides_within_the_deviations(actor, value, generator) -> None:
    config = ImprovementConfig(environments=64, labels=128, horizon=1, deviations=(10.0, 40.0))
    labels = fly_branches(
        config, partial(likeliest_turn, actor, GAUSSIAN), value, generator, nothing
    )
    deviation = wrapped(labels.turns[:, 1:] - labels.turns[:, :1]) * 180.0
    assert float(deviation.abs().min()) > 9.9
    assert float(deviation.abs().max()) < 40.1
    assert 0.4 < float((deviation > 0.0).float().mean()) < 0.6
    assert labels.view.dtype == torch.float16


def test_labels_are_mirrored_with_their_turns(generator) -> None:
    shown, _ = observations(1, generator)
    turns = torch.tensor([[0.25, -0.5]])
    labels = Labels(shown.view, shown.numbers, turns, torch.ones(1, 2))
    sample = labels.sample(64, generator)
    mirrored = sample.turns[:, 0] < 0.0
    assert 0 < int(mirrored.sum()) < 64
    assert torch.equal(sample.turns[mirrored], -turns.expand(int(mirrored.sum()), 2))
    assert torch.equal(sample.view[mirrored][0], shown.view[0, torch.as_tensor(MIRROR)])
    assert torch.equal(sample.view[~mirrored][0], shown.view[0])


def test_critics_learn_which_turns_are_better(generator) -> None:
    """The better turn is to where the view is bright; what branches share does not matter."""
    shown, brightest = observations(512, generator)
    turns = 2.0 * torch.rand(512, 8, generator=generator) - 1.0
    shared = 10.0 * torch.rand(512, 1, generator=generator)
    returns = shared + torch.cos(math.pi * (turns - (brightest * (2.0 / DIRECTIONS))[:, None]))
    config = ImprovementConfig(critics=2, channels=16, blocks=2, critic_updates=150, batch=128)
    labels = Labels(shown.view, shown.numbers, turns, returns)
    critics, left = learn_critics(config, labels, np.random.default_rng(0), generator, nothing)
    assert left < 0.2
    fresh, brightest = observations(64, generator)
    with torch.no_grad():
        best = networks.mean_value(critics, fresh).argmax(dim=1)
    apart = wrapped((best - brightest) * (2.0 / DIRECTIONS))
    assert float(apart.abs().mean()) < 0.1  # 0.5 by chance


def test_critics_value_a_mirrored_turn_in_a_mirrored_view_alike(generator) -> None:
    rng = np.random.default_rng(0)
    critics = networks.make_networks(rng, networks=2, channels=8, blocks=1, device=CPU)
    shown, _ = observations(16, generator)
    mirror = torch.as_tensor(MIRROR)
    values = networks.mean_value(critics, shown)
    again = networks.mean_value(critics, Observation(shown.view[:, mirror], shown.numbers))
    assert torch.allclose(again, values[:, mirror], atol=1e-5)
    assert not torch.allclose(again, values, atol=1e-2)


def test_the_correction_takes_a_better_turn_and_leaves_what_is_nearly_as_good(
    actor, generator, monkeypatch
) -> None:
    shown, _ = observations(16, generator)
    with torch.no_grad():
        own = likeliest_turn(actor, GAUSSIAN, shown)
    wanted = wrapped(own + 45.0 / 180.0)

    def mean_value(_critics, _shown):
        """Highest at the wanted turn, 0.3 higher than at the policy's own."""
        directions = torch.arange(DIRECTIONS) * (2.0 / DIRECTIONS)
        bump = torch.cos(math.pi * (directions - wanted[:, None]))
        return (0.3 / (1.0 - math.cos(math.pi / 4.0))) * bump

    monkeypatch.setattr(networks, "mean_value", mean_value)
    taken = corrected_turn(own, {}, shown, margin=0.2)
    kept = corrected_turn(own, {}, shown, margin=0.4)
    assert torch.allclose(wrapped(taken - wanted), torch.zeros(16), atol=0.02)
    assert torch.equal(kept, own)


def test_the_actor_learns_to_turn_as_its_teacher(actor, shipped, generator) -> None:
    config = ImprovementConfig(
        environments=16, imitated_steps=640, imitation_updates=200, batch=64, imitation_rate=1e-2
    )
    teacher = partial(likeliest_turn, shipped, GAUSSIAN)

    def deviation() -> float:
        fresh = SearchEnvironment(64, config.worlds, torch.Generator().manual_seed(4))
        with torch.no_grad():
            fresh.step(teacher(fresh.observe()))
            shown = fresh.observe()
            apart = wrapped(likeliest_turn(actor, GAUSSIAN, shown) - teacher(shown))
        return float(apart.abs().median()) * 180.0

    before = deviation()
    imitate(config, actor, GAUSSIAN, teacher, generator, nothing, nothing)
    assert deviation() < 0.5 * before


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"algorithm": "ppo"}, "algorithm must be improvement"),
        ({"rounds": 0}, "rounds must be at least 1"),
        ({"branches": 1}, "branches must be at least 2"),
        ({"labels": 10, "remembered_labels": 5}, "remembered_labels must be at least 10"),
        ({"critic_rate": math.nan}, "critic_rate must be above 0"),
        ({"deviations": (40.0, 10.0)}, "deviations must be two rising numbers"),
        ({"trace": 1.5}, "trace must be from 0 to 1"),
        ({"margin": -0.1}, "margin must be at least 0"),
        ({"seed": -1}, "seed must be at least 0"),
    ],
)
def test_wrong_settings_are_refused_in_words(changes, words) -> None:
    with pytest.raises(InvalidInput, match=words):
        ImprovementConfig(**changes)
