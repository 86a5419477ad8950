"""Runs of expert iteration: reproducible, resumable, with a card that tells where they began."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
import torch

from wisar_planner.cli.main import main
from wisar_planner.errors import InvalidInput
from wisar_planner.policy.model import find_model, load_model, save_model
from wisar_planner.training.algorithms import last_policy, read_any_config
from wisar_planner.training.divergence import Diverged
from wisar_planner.training.expert_iteration.config import ExpertConfig
from wisar_planner.training.expert_iteration.run import ExpertRun
from wisar_planner.training.ppo.config import PpoConfig
from wisar_planner.training.records import read_checkpoint, write_checkpoint
from wisar_planner.training.worlds import WorldDistribution

CPU = torch.device("cpu")
CONFIG = Path(__file__).resolve().parents[5] / "config" / "expert_iteration.yaml"
TINY = ExpertConfig(
    name="tiny", rounds=3, flights=4, remembered_flights=8, tries=2, moves=20, updates=3, batch=8,
    validation_maps=2,
    worlds=WorldDistribution(paper_share=0.5, sides=(10.0, 12.0), budgets=(5, 9)),
)  # fmt: skip


def same(first, other) -> bool:
    return all(torch.equal(first.actor[name], other.actor[name]) for name in first.actor)


def test_the_same_seed_gives_the_same_policy_and_another_seed_another(tmp_path, trained) -> None:
    first = trained(TINY, tmp_path / "a")
    assert same(first, trained(TINY, tmp_path / "b"))
    assert not same(first, trained(dataclasses.replace(TINY, seed=1), tmp_path / "c"))
    assert len(first.validations) == 4
    assert first.updates == 9


@pytest.mark.parametrize("stop_after", [1, 3])
def test_a_run_that_was_stopped_goes_on_as_if_it_had_not_been(
    tmp_path, trained, stop_after
) -> None:
    whole = trained(TINY, tmp_path / "whole")
    assert same(whole, trained(TINY, tmp_path / "stopped", stop_after=stop_after))


def test_the_latest_rounds_are_remembered(tmp_path, trained) -> None:
    run = trained(TINY, tmp_path)
    assert len(run._rounds) == 2
    assert sum(len(each.turn) for each in run._rounds) < run.steps


def test_a_wider_policy_says_about_the_same_and_has_more_to_learn_with() -> None:
    """It flies about as well as before; the copies of channels differ, to learn apart."""
    narrow = dataclasses.replace(TINY, start="sac_ppo")
    start = ExpertRun(narrow, None, CPU)
    wide = ExpertRun(dataclasses.replace(narrow, channels=96), None, CPU)
    assert start.actor["mix0"].shape == (1, 64, 64)
    assert wide.actor["mix0"].shape == (1, 96, 96)
    shares = [
        run.fly(40, torch.Generator().manual_seed(2)).share.mean().item() for run in (start, wide)
    ]
    assert shares[1] == pytest.approx(shares[0], abs=0.01)
    copies = np.corrcoef(wide.actor["view"][0].detach().numpy())[np.arange(32), np.arange(64, 96)]
    assert (copies > 0.99).all()
    assert (copies < 1.0 - 1e-6).all()


def test_a_policy_is_not_made_narrower() -> None:
    with pytest.raises(InvalidInput, match="channels: sac_ppo has 64, more than 32"):
        ExpertRun(dataclasses.replace(TINY, start="sac_ppo", channels=32), None, CPU)


def test_labels_of_earlier_runs_are_remembered_the_latest_the_longest(tmp_path, trained) -> None:
    """Two runs of two and one rounds; then the first own round displaces the oldest."""
    first = trained(dataclasses.replace(TINY, rounds=2), tmp_path / "first")
    second = trained(dataclasses.replace(TINY, rounds=1, seed=1), tmp_path / "second")
    config = dataclasses.replace(
        TINY, seed=2, rounds=1, remembered_flights=12,
        labels=(str(tmp_path / "first"), str(tmp_path / "second")),
    )  # fmt: skip
    run = ExpertRun(config, tmp_path / "run", CPU)
    training = run.train()
    next(training)
    expected = [*first._rounds, second._rounds[0]]
    assert [each.turn.tolist() for each in run._rounds] == [each.turn.tolist() for each in expected]
    list(training)
    assert [each.turn.tolist() for each in run._rounds[:2]] == [
        each.turn.tolist() for each in expected[1:]
    ]
    assert len(run._rounds) == 3


def test_labels_must_be_those_of_a_run(tmp_path, trained) -> None:
    def reason(folder: Path) -> str:
        run = ExpertRun(dataclasses.replace(TINY, labels=(str(folder),)), None, CPU)
        with pytest.raises(InvalidInput) as caught:
            next(run.train())
        return str(caught.value)

    assert "holds no run; train it first" in reason(tmp_path / "none")
    tiny = PpoConfig(
        name="tiny", start="sac_improved", steps=192, imitation_steps=64, value_steps=64,
        environments=8, window=4, batch=16, channels=4, blocks=1, validation_maps=2,
        validation_every=128,
    )  # fmt: skip
    trained(tiny, tmp_path / "ppo")
    assert "is no run of expert iteration" in reason(tmp_path / "ppo")


def test_what_search_does_becomes_likelier(trained) -> None:
    """The loss on the same labels falls."""
    config = dataclasses.replace(TINY, rounds=1, flights=8, updates=60, batch=64, rate=1e-3)
    run = ExpertRun(config, None, CPU)
    list(run.train())
    run.updates = 0
    assert run._imitate() < run.validations[-1].figures["loss"]


def test_the_best_policy_is_kept_with_a_card_that_tells_where_it_began(tmp_path, trained) -> None:
    run = trained(TINY, tmp_path)
    card = load_model(tmp_path / "tiny.safetensors").card
    start = load_model(find_model("sac")).card
    assert card["algorithm"].startswith("expert iteration")
    assert card["validation"]["note"].startswith("by the exact seen probability")
    assert card["start"]["weights_sha256"] == start["weights_sha256"]
    assert card["validation"]["share_of_bound"] == pytest.approx(run.best_share, abs=1e-4)
    assert "share_of_bound_other_worlds" in card["validation"]


def test_a_run_on_the_papers_setup_alone_is_judged_there(tmp_path, trained) -> None:
    paper = dataclasses.replace(TINY, rounds=1, worlds=WorldDistribution())
    run = trained(paper, tmp_path)
    assert "other_worlds" not in run.validations[0].figures
    assert 0.5 < run.validations[0].share < 1.0


@pytest.mark.parametrize("share", [0.03, 0.6])
def test_the_share_of_the_papers_setup_is_kept(share) -> None:
    worlds = dataclasses.replace(TINY.worlds, paper_share=share)
    config = dataclasses.replace(TINY, flights=1001, remembered_flights=1001, worlds=worlds)
    firsts, flights = zip(*ExpertRun(config, None, CPU)._batches(), strict=True)
    paper, others = np.sum(flights, axis=0)
    assert paper == round(1001 * share)
    assert paper + others == 1001
    assert list(firsts) == list(range(0, 1001, 16))


def test_a_run_does_not_go_on_from_another_start(tmp_path, trained) -> None:
    """The file that a run began with is overwritten by another policy."""
    start = tmp_path / "start.safetensors"
    config = dataclasses.replace(TINY, rounds=1, start=str(start))
    policy = load_model(find_model("sac"))
    save_model(start, policy.weights, policy.card)
    trained(config, tmp_path / "run", stop_after=1)
    save_model(start, {k: v + np.float32(0.1) for k, v in policy.weights.items()}, policy.card)
    with pytest.raises(InvalidInput, match=r"another policy than .* began with"):
        ExpertRun(config, tmp_path / "run", CPU).load_checkpoint()


def test_the_log_keeps_its_validations_when_a_run_goes_on(tmp_path, trained) -> None:
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    run = trained(TINY, tmp_path, stop_after=2)
    log = EventAccumulator(str(tmp_path))
    log.Reload()
    logged = [each.step for each in log.Scalars("validation/e_p")]
    assert logged == [each.steps for each in run.validations]


def test_curves_fly_the_policy_of_a_run_on_a_single_fresh_map(tmp_path, trained, capsys) -> None:
    trained(dataclasses.replace(TINY, rounds=1), tmp_path)
    assert main(["curves", str(tmp_path), "--fresh-maps", "1"]) == 0
    assert "tiny, from search" in capsys.readouterr().out


@pytest.mark.parametrize("updates", [1, 3])
def test_a_training_that_diverges_ends_in_words(trained, updates) -> None:
    with pytest.raises(Diverged, match="lower its learning rates"):
        trained(dataclasses.replace(TINY, rate=1e9, updates=updates), None)


def test_a_policy_that_is_no_number_is_not_flown(tmp_path, trained, capsys) -> None:
    config = dataclasses.replace(TINY, rounds=1)
    trained(config, tmp_path)
    tensors, counters = read_checkpoint(tmp_path, dataclasses.asdict(config), CPU)
    tensors["actor.output"][0] = float("nan")
    write_checkpoint(tmp_path, tensors, counters)
    assert main(["curves", str(tmp_path), "--fresh-maps", "1"]) == 2
    assert "parameters of the policy are not finite" in capsys.readouterr().err


@pytest.mark.parametrize("earlier", [False, True])
def test_curves_do_not_need_what_a_run_began_with(tmp_path, trained, capsys, earlier) -> None:
    """Checkpoints of earlier versions do not tell how turns are distributed."""
    start, folder = tmp_path / "start.safetensors", tmp_path / "run"
    policy = load_model(find_model("sac_improved"))
    save_model(start, policy.weights, policy.card)
    config = dataclasses.replace(TINY, rounds=1, start=str(start))
    trained(config, folder)
    assert last_policy(folder).distribution == policy.distribution
    if earlier:
        tensors, counters = read_checkpoint(folder, dataclasses.asdict(config), CPU)
        del counters["distribution"]
        write_checkpoint(folder, tensors, counters)
    start.unlink()
    assert main(["curves", str(folder), "--fresh-maps", "2"]) == 0
    assert "% |" in capsys.readouterr().out
    assert last_policy(folder).distribution == policy.distribution


def test_the_command_learns_from_search_and_tells_mistakes_in_one_line(tmp_path, capsys) -> None:
    config = tmp_path / "tiny.yaml"
    content = dataclasses.asdict(dataclasses.replace(TINY, rounds=1))
    config.write_text(json.dumps(content))  # JSON is YAML, too
    command = ["train", str(config), "--out", str(tmp_path / "run"), "--threads", "1"]
    assert main([*command, "--start", "sac_improved"]) == 0
    assert "search_brings" in capsys.readouterr().out
    assert main([*command, "--start", "none.safetensors"]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"moves": 0}, "moves must be at least 1"),
        ({"remembered_flights": 3}, "remembered_flights must be at least 4"),
        ({"rate": 0.0}, "rate must be above 0"),
        ({"algorithm": "ppo"}, "algorithm must be expert_iteration"),
        ({"early_weight": float("nan")}, "early_weight must be at least 0"),
    ],
)
def test_wrong_values_are_refused(change, words) -> None:
    with pytest.raises(InvalidInput, match=words):
        dataclasses.replace(TINY, **change)


def test_the_shipped_configuration_is_one_of_expert_iteration() -> None:
    config = read_any_config(CONFIG)
    assert isinstance(config, ExpertConfig)
    assert config.worlds.paper_share < 1.0
