"""Runs of proximal policy optimisation: reproducible, resumable, with a card."""

import dataclasses
import json
from pathlib import Path

import pytest
import torch

from wisar_planner.cli.main import main
from wisar_planner.errors import InvalidInput
from wisar_planner.policy.heading import DIRECTED
from wisar_planner.policy.model import find_model, load_model
from wisar_planner.training.algorithms import read_any_config
from wisar_planner.training.divergence import Diverged
from wisar_planner.training.ppo.config import PpoConfig
from wisar_planner.training.ppo.run import PpoRun
from wisar_planner.training.worlds import WorldDistribution

CPU = torch.device("cpu")
CONFIG = Path(__file__).resolve().parents[5] / "config" / "ppo.yaml"
TINY = PpoConfig(
    name="tiny", start="sac_improved", steps=320, imitation_steps=64, value_steps=64,
    environments=8, window=4, batch=16, channels=4, blocks=1, validation_maps=4,
    validation_every=128,
    worlds=WorldDistribution(paper_share=0.5, sides=(10.0, 12.0), budgets=(5, 9), field_share=0.5),
)  # fmt: skip


def same(first, other) -> bool:
    return all(torch.equal(first.actor[name], other.actor[name]) for name in first.actor)


def test_the_same_seed_gives_the_same_policy_and_another_seed_another(tmp_path, trained):
    first = trained(TINY, tmp_path / "a")
    assert same(first, trained(TINY, tmp_path / "b"))
    assert not same(first, trained(dataclasses.replace(TINY, seed=1), tmp_path / "c"))
    assert [each.steps for each in first.validations] == [64, 128, 256, 320]


@pytest.mark.parametrize("stop_after", [1, 3])
def test_a_run_that_was_stopped_goes_on_to_the_end(tmp_path, trained, stop_after):
    """In other worlds: its searches begin anew."""
    run = trained(TINY, tmp_path, stop_after=stop_after)
    assert run.steps == TINY.steps
    assert len(run.validations) == 4


def test_what_a_checkpoint_keeps_comes_back(tmp_path, trained):
    run = trained(TINY, tmp_path)
    again = PpoRun(TINY, tmp_path, CPU)
    again.load_checkpoint()
    assert same(run, again)
    for name, tensor in run._tensors().items():
        torch.testing.assert_close(again._tensors()[name], tensor, rtol=0.0, atol=0.0)
    assert again.best_score == run.best_score


def copies(networks):
    return {name: each.detach().clone() for name, each in networks.items()}


def differ(before, networks) -> bool:
    return not all(torch.equal(before[name], each) for name, each in networks.items())


def test_the_value_alone_learns_at_first():
    """The policy stays as it was imitated until `value_steps` are flown."""
    long = dataclasses.replace(TINY, value_steps=128, validation_every=64)
    run = PpoRun(long, None, CPU)
    training = run.train()
    next(training)
    imitated, value = copies(run.actor), copies(run._value)
    while next(training).steps < 192:
        pass
    assert run.steps == 192
    assert not differ(imitated, run.actor)
    assert differ(value, run._value)
    list(training)
    assert differ(imitated, run.actor)


@pytest.mark.parametrize(
    ("imitation", "value", "steps"), [(64, 64, 129), (60, 30, 97), (60, 2, 65), (1, 1, 33)]
)
def test_the_shortest_training_that_is_taken_makes_the_policy_learn(
    tmp_path, trained, imitation, value, steps
):
    """Whether the start is imitated or not."""
    trained(TINY, tmp_path)
    config = dataclasses.replace(
        TINY, steps=steps, imitation_steps=imitation, value_steps=value, validation_every=1
    )
    for start in (TINY.start, str(tmp_path / "tiny.safetensors")):
        run = PpoRun(dataclasses.replace(config, start=start), None, CPU)
        assert sum("change" in each.figures for each in run.train()) >= 1
    with pytest.raises(InvalidInput, match=f"steps must be at least {steps}"):
        dataclasses.replace(config, steps=steps - 1)


def test_the_kept_policy_and_its_card_tell_what_it_is(tmp_path, trained):
    run = trained(TINY, tmp_path)
    model = load_model(tmp_path / "tiny.safetensors")
    assert model.distribution == DIRECTED
    assert (
        model.card["start"]["weights_sha256"]
        == (load_model(find_model("sac_improved")).card["weights_sha256"])
    )
    assert model.card["config"]["window"] == 4
    best = max(
        run.validations, key=lambda each: 0.5 * each.share + 0.5 * each.figures["other_worlds"]
    )
    found = model.card["validation"]
    assert found["share_of_bound"] == pytest.approx(best.share, abs=1e-4)
    assert found["share_of_bound_other_worlds"] == pytest.approx(
        best.figures["other_worlds"], abs=1e-4
    )


@pytest.mark.parametrize("rate", ["rate", "value_rate", "imitation_rate"])
def test_a_training_that_diverges_ends_in_words(trained, rate):
    with pytest.raises(Diverged, match="lower its learning rates"):
        trained(dataclasses.replace(TINY, **{rate: 1e9}), None)


def test_a_start_of_the_same_kind_and_size_is_taken_over(tmp_path, trained):
    trained(TINY, tmp_path)
    config = dataclasses.replace(TINY, start=str(tmp_path / "tiny.safetensors"))
    run = PpoRun(config, None, CPU)
    assert run.imitation_steps == 0
    kept = load_model(tmp_path / "tiny.safetensors").weights
    for name, each in run.actor.items():
        torch.testing.assert_close(each.detach(), torch.tensor(kept[name]))
    larger = PpoRun(dataclasses.replace(config, channels=6), None, CPU)
    assert larger.imitation_steps == config.imitation_steps


def test_the_shipped_configuration_is_read():
    config = read_any_config(CONFIG)
    assert isinstance(config, PpoConfig)
    assert config.worlds.paper_share < 1.0


def test_the_command_trains_and_tells_mistakes_in_one_line(tmp_path, capsys):
    config = tmp_path / "tiny.yaml"
    config.write_text(json.dumps(dataclasses.asdict(TINY)))  # JSON is YAML, too
    command = ["train", str(config), "--out", str(tmp_path / "run"), "--threads", "1"]
    assert main([*command, "--steps", "192"]) == 0
    assert "other_worlds" in capsys.readouterr().out
    assert main([*command, "--start", "none.safetensors"]) == 2
    error = capsys.readouterr().err
    assert "there is no file" in error
    assert len(error.splitlines()) == 1
