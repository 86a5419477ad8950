"""Training runs: reproducible, resumable, and wrong configurations refused in words."""

import dataclasses

import pytest
import torch

from wisar_planner.errors import InvalidInput
from wisar_planner.policy.model import load_model
from wisar_planner.training.algorithms import read_any_config
from wisar_planner.training.divergence import Diverged
from wisar_planner.training.sac.config import SacConfig
from wisar_planner.training.sac.learner import SacSettings
from wisar_planner.training.sac.run import SacRun
from wisar_planner.training.worlds import WorldDistribution

CPU = torch.device("cpu")
TINY = SacConfig(
    name="tiny", steps=160, environments=4, warm_up_steps=32, updates=0.75, batch=8, replay=128,
    validation_maps=2, validation_every=80, sac=SacSettings(channels=4, blocks=1),
    worlds=WorldDistribution(paper_share=0.5, sides=(10.0, 12.0), budgets=(5, 9)),
)  # fmt: skip


def same(first, other) -> bool:
    mine, theirs = first.sac.actor, other.sac.actor
    return all(torch.equal(mine[name], theirs[name]) for name in mine)


def test_the_same_seed_gives_the_same_weights_and_another_seed_others(tmp_path, trained) -> None:
    first = trained(TINY, tmp_path / "a")
    assert same(first, trained(TINY, tmp_path / "b"))
    assert not same(first, trained(dataclasses.replace(TINY, seed=1), tmp_path / "c"))


def test_a_run_that_was_stopped_goes_on_as_if_it_had_not_been(tmp_path, trained) -> None:
    whole = trained(TINY, tmp_path / "whole")
    assert same(whole, trained(TINY, tmp_path / "stopped", stop_after=1))
    assert whole.validations[0].steps == TINY.validation_every


def test_the_best_policy_is_kept_with_its_card(tmp_path) -> None:
    run = SacRun(TINY, tmp_path, CPU)
    results = list(run.train())
    model = load_model(tmp_path / "tiny.safetensors")
    assert [each.steps for each in results] == [80, 160]
    assert model.card["validation"]["share_of_bound"] == pytest.approx(run.best_share, abs=1e-4)
    assert model.card["training"]["seed"] == 0
    assert model.card["config"]["sac"]["channels"] == 4


@pytest.mark.parametrize(
    ("steps", "warm_up", "updates", "made"),
    [(33, 32, 1.0, 1), (37, 33, 2.5, 2), (45, 32, 0.25, 1)],
)
def test_the_shortest_training_that_is_taken_makes_an_update(steps, warm_up, updates, made) -> None:
    config = dataclasses.replace(TINY, steps=steps, warm_up_steps=warm_up, updates=updates)
    run = SacRun(config, None, CPU)
    list(run.train())
    assert run.updates == made
    with pytest.raises(InvalidInput, match="nothing would be learned"):
        dataclasses.replace(config, steps=steps - 1)


@pytest.mark.parametrize("rate", ["critic_rate", "actor_rate"])
def test_a_training_that_diverges_ends_in_words(rate) -> None:
    fast = dataclasses.replace(TINY.sac, **{rate: 1e9})
    run = SacRun(dataclasses.replace(TINY, sac=fast), None, CPU)
    with pytest.raises(Diverged, match="lower its learning rates"):
        list(run.train())


@pytest.mark.parametrize("where", ["efficiency", "share", "figures"])
def test_the_last_good_state_of_a_training_that_diverges_stays(
    tmp_path, monkeypatch, where
) -> None:
    run = SacRun(TINY, tmp_path, CPU)
    training = run.train()
    next(training)
    kept = {path.name: path.read_bytes() for path in tmp_path.glob("*.safetensors")}
    fly, nothing = run.fly, torch.tensor([float("nan")])
    lost = {where: {"loss": float("inf")} if where == "figures" else nothing}
    monkeypatch.setattr(run, "fly", lambda *args: fly(*args)._replace(**lost))
    with pytest.raises(Diverged, match="lower its learning rates"):
        next(training)
    assert set(kept) == {"checkpoint.safetensors", "tiny.safetensors"}
    assert kept == {path.name: path.read_bytes() for path in tmp_path.glob("*.safetensors")}


def test_an_ablation_learns_but_is_not_kept_as_a_model(tmp_path) -> None:
    run = SacRun(dataclasses.replace(TINY, ablation="mlp"), tmp_path, CPU)
    assert [each.updates for each in run.train()] == [9, 24]
    assert not list(tmp_path.glob("tiny*"))


def test_a_checkpoint_of_another_run_or_a_broken_one_is_refused(tmp_path, trained) -> None:
    trained(TINY, tmp_path)
    with pytest.raises(InvalidInput, match="another configuration"):
        SacRun(dataclasses.replace(TINY, batch=16), tmp_path, CPU).load_checkpoint()
    (tmp_path / "checkpoint.safetensors").write_bytes(b"no checkpoint")
    with pytest.raises(InvalidInput, match="cannot be read"):
        SacRun(TINY, tmp_path, CPU).load_checkpoint()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("steps: 0", "steps must be at least 1"),
        ("seed: -1", "seed must be at least 0"),
        ("stepps: 5", "unknown field stepps"),
        ("steps: many", "steps must be of type int"),
        ("steps: true", "steps must be of type int"),
        ("updates: .nan", "updates must be above 0"),
        ("gamma: 1.5", "gamma must be over 0"),
        ("decay_from: 1.0", "decay_from must be from 0"),
        ("entropy: [1.0]", "entropy must be a list of 2"),
        ("entropy: [.nan, -1.0]", "entropy must be finite"),
        ("entropy: [-1.0, -.inf]", "entropy must be finite"),
        ("warm_up_steps: 10", "warm_up_steps must be at least"),
        ("steps: 4096", "steps must be more than warm_up_steps"),
        ("{steps: 4200, warm_up_steps: 4161}", "steps must be more than warm_up_steps"),
        ("{steps: 4672, updates: 0.1}", "steps must be more than warm_up_steps"),
        ("{steps: 4097, updates: 1.0e-320}", "steps must be more than warm_up_steps"),
        ("replay: 5000", "replay must be at least twice"),
        ("ablation: everything", "ablation must be one of"),
        ("sac: {channels: 0}", "sac: channels must be at least 1"),
        ("sac: {tau: 0.0}", "sac: tau must be over 0"),
        ("sac: 3", "sac must be a mapping"),
        ("worlds: {sides: [9.0, 3.0]}", "worlds: sides must be two rising numbers"),
        ("worlds: {paper_share: 2.0}", "worlds: paper_share must be from 0 to 1"),
        ("- a list", "must be a mapping"),
        ("a: [", "is not YAML"),
    ],
)
def test_a_wrong_configuration_names_the_field(tmp_path, text, words) -> None:
    path = tmp_path / "config.yaml"
    path.write_text(text)
    with pytest.raises(InvalidInput, match=words):
        read_any_config(path)
