"""Runs of policy iteration: reproducible, resumable, with a card that tells where they began."""

import dataclasses
import json

import pytest
import torch

from wisar_planner.cli.main import main
from wisar_planner.errors import InvalidInput
from wisar_planner.policy.model import find_model, load_model
from wisar_planner.training.divergence import Diverged
from wisar_planner.training.improvement.config import ImprovementConfig
from wisar_planner.training.improvement.run import ImprovementRun
from wisar_planner.training.worlds import WorldDistribution

CPU = torch.device("cpu")
TINY = ImprovementConfig(
    name="tiny", rounds=2, environments=8, valued_steps=256, labels=4, remembered_labels=6,
    branches=3, horizon=2, critics=2, channels=4, blocks=1, critic_updates=3, imitation_updates=4,
    batch=8, imitated_steps=16, validation_maps=2,
    worlds=WorldDistribution(paper_share=0.5, sides=(10.0, 12.0), budgets=(5, 9)),
)  # fmt: skip


def same(first, other) -> bool:
    return all(torch.equal(first.actor[name], other.actor[name]) for name in first.actor)


def test_the_same_seed_gives_the_same_policy_and_another_seed_another(tmp_path, trained) -> None:
    first = trained(TINY, tmp_path / "a")
    assert same(first, trained(TINY, tmp_path / "b"))
    assert not same(first, trained(dataclasses.replace(TINY, seed=1), tmp_path / "c"))
    assert len(first.validations) == 3


@pytest.mark.parametrize("stop_after", [1, 2])
def test_a_run_that_was_stopped_goes_on_as_if_it_had_not_been(
    tmp_path, trained, stop_after
) -> None:
    whole = trained(TINY, tmp_path / "whole")
    assert same(whole, trained(TINY, tmp_path / "stopped", stop_after=stop_after))


def test_the_best_policy_is_kept_with_a_card_that_tells_where_it_began(tmp_path, trained) -> None:
    run = trained(TINY, tmp_path)
    model = load_model(tmp_path / "tiny.safetensors")
    shipped = load_model(find_model("sac_plain")).card
    assert model.card["validation"]["share_of_bound"] == pytest.approx(run.best_share, abs=1e-4)
    assert model.card["start"]["weights_sha256"] == shipped["weights_sha256"]
    assert model.card["config"]["horizon"] == 2


@pytest.mark.parametrize("start", ["sac_improved", "sac"])
def test_a_policy_of_either_distribution_is_improved(tmp_path, trained, start) -> None:
    run = trained(dataclasses.replace(TINY, rounds=1, start=start), tmp_path)
    begun = load_model(find_model(start))
    model = load_model(tmp_path / "tiny.safetensors")
    assert model.distribution == begun.distribution
    assert set(model.weights) == set(begun.weights)
    assert "other_worlds" in run.validations[0].figures
    assert "teacher_other_worlds" in run.validations[1].figures


def test_the_command_improves_a_policy_and_tells_mistakes_in_one_line(tmp_path, capsys) -> None:
    content = dataclasses.asdict(dataclasses.replace(TINY, rounds=1))
    config = tmp_path / "tiny.yaml"
    config.write_text(json.dumps(content))  # JSON is YAML, too
    command = ["train", str(config), "--out", str(tmp_path / "run"), "--threads", "1"]
    assert main([*command, "--start", "sac_improved"]) == 0
    assert "of the bound" in capsys.readouterr().out
    for extra, words in (
        (["--start", "none.safetensors"], "there is no file"),
        (["--steps", "5"], "unknown field steps"),
    ):
        assert main([*command, *extra]) == 2
        error = capsys.readouterr().err
        assert words in error
        assert len(error.splitlines()) == 1


@pytest.mark.parametrize("rate", ["imitation_rate", "value_rate"])
def test_a_training_that_diverges_ends_in_words(trained, rate) -> None:
    with pytest.raises(Diverged, match="lower its learning rates"):
        trained(dataclasses.replace(TINY, **{rate: 1e9}), None)


def test_a_checkpoint_of_another_configuration_is_refused(tmp_path, trained) -> None:
    trained(dataclasses.replace(TINY, rounds=1), tmp_path)
    with pytest.raises(InvalidInput, match="another configuration"):
        ImprovementRun(TINY, tmp_path, CPU).load_checkpoint()
