import json
from pathlib import Path

import pytest
import torch
import yaml

from wisar_planner.cli.main import main
from wisar_planner.errors import InvalidInput
from wisar_planner.training.algorithms import read_any_config
from wisar_planner.training.paper import throughput
from wisar_planner.training.paper.config import PaperConfig, read_paper_config
from wisar_planner.training.paper.run import PaperRun
from wisar_planner.training.sac.config import SacConfig

CONFIG = Path(__file__).resolve().parents[5] / "config"
TINY = {
    "algorithm": "paper_sac",
    "steps": 120,
    "environments": 4,
    "learning_starts": 24,
    "train_every": 3,
    "gradient_steps": 2,
    "buffer_size": 60,
    "validation_maps": 3,
    "validation_every": 60,
    "task": {"waypoints": 6, "gaussians": 2},
    "sac": {"learning_rate": 1e-3, "batch": 16, "tau": 0.01},
    "network": {"layers": 2, "width": 16, "path_features": 16, "pdm_features": 8},
}


def write(folder, **changes):
    path = folder / "tiny.yaml"
    path.write_text(yaml.safe_dump({**TINY, **changes}))
    return path


def train(config):
    run = PaperRun(config, None, torch.device("cpu"))
    validations = [vars(each) | {"seconds": 0} for each in run.train()]
    return run, validations


def test_the_file_in_config_is_the_papers():
    config = read_paper_config(CONFIG / "paper_sac.yaml")
    assert config == PaperConfig()
    assert (config.network.layers, config.network.width) == (8, 2000)
    assert (config.network.path_features, config.network.path_extractor) == (1000, "cnn_2d")
    assert (config.sac.learning_rate, config.sac.batch, config.sac.tau) == (1e-6, 1024, 1e-4)
    assert (config.train_every, config.gradient_steps) == (10, 50)
    assert (config.learning_starts, config.buffer_size) == (8192, 5_000_000)
    assert config.sac.gamma == 0.99


def test_a_file_that_names_no_algorithm_is_for_the_shipped_policy(tmp_path):
    path = tmp_path / "sac.yaml"
    path.write_text("steps: 12345")
    assert isinstance(read_any_config(path, seed=3), SacConfig)
    with pytest.raises(InvalidInput, match="must have `algorithm: paper_sac`"):
        read_paper_config(path)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"algorithm": "dqn"},
            "algorithm must be improvement or ppo or expert_iteration or paper_sac",
        ),
        ({"speed": 3}, "unknown field speed"),
        ({"steps": 0}, "steps must be at least 1"),
        ({"seed": -1}, "seed must be at least 0"),
        ({"buffer_size": 0}, "buffer_size must be at least 1"),
        ({"learning_starts": -5}, "learning_starts must not be negative"),
        ({"learning_starts": 120}, "steps must be more than learning_starts"),
        ({"train_every": 40}, "steps must be more than learning_starts"),
        ({"train_every": "often"}, "train_every must be of type int"),
        ({"sac": {"learning_rate": 0.0}}, "sac: learning_rate must be above 0 and finite"),
        ({"sac": {"tau": 1.5}}, "sac: tau must be over 0 and at most 1"),
        ({"sac": {"batch": 0}}, "sac: batch must be at least 1"),
        ({"task": {"waypoints": 0}}, "task: waypoints must be at least 1"),
        ({"network": {"width": 0}}, "network: width must be at least 1"),
        ({"network": {"path_extractor": "gru"}}, "network: path_extractor must be one of"),
    ],
)
def test_wrong_values_are_refused_by_name(tmp_path, changes, message):
    with pytest.raises(InvalidInput, match=message):
        read_any_config(write(tmp_path, **changes))


def test_training_is_the_same_for_the_same_seed_alone(tmp_path):
    torch.manual_seed(1)
    before = torch.get_rng_state()
    run, validations = train(read_paper_config(write(tmp_path)))
    assert torch.equal(before, torch.get_rng_state())
    # Rounds of 24 steps: validated after the third, when 60 are passed, and at the end.
    assert [each["steps"] for each in validations] == [72, 120]
    # Updates after steps 36, 48, ..., 120 of all, two each.
    assert run.updates == 2 * 8
    assert {"critic_loss", "actor_loss", "entropy", "temperature", "out_of_area"} <= set(
        validations[-1]["figures"]
    )
    torch.manual_seed(2)
    again, same = train(read_paper_config(write(tmp_path)))
    assert same == validations
    for one, other in zip(
        run.learner.actor.parameters(), again.learner.actor.parameters(), strict=True
    ):
        assert torch.equal(one, other)
    _, other = train(read_paper_config(write(tmp_path), seed=1))
    assert other != validations


@pytest.mark.parametrize(
    ("steps", "starts", "every"), [(1, 0, 1), (25, 24, 3), (25, 40, 11), (49, 59, 5)]
)
def test_the_shortest_training_that_is_taken_makes_updates(tmp_path, steps, starts, every):
    changes = {"steps": steps, "learning_starts": starts, "train_every": every}
    run, _ = train(read_paper_config(write(tmp_path, **changes)))
    assert run.updates >= TINY["gradient_steps"]
    with pytest.raises(InvalidInput, match="steps must be"):
        read_paper_config(write(tmp_path, **(changes | {"steps": steps - 1})))


def test_replay_memory_is_no_larger_than_the_run(tmp_path):
    config = read_paper_config(write(tmp_path, buffer_size=10**12))
    run = PaperRun(config, None, torch.device("cpu"))
    assert run.replay.tensors()["reward"].numel() == config.steps


def test_a_run_goes_on_from_its_checkpoint_as_if_it_had_not_stopped(tmp_path):
    config = read_paper_config(write(tmp_path))
    whole, _ = train(config)
    stopped = PaperRun(config, tmp_path / "run", torch.device("cpu"))
    next(iter(stopped.train()))
    goes_on = PaperRun(config, tmp_path / "run", torch.device("cpu"))
    goes_on.load_checkpoint()
    assert goes_on.steps == 72
    list(goes_on.train())
    assert [v.efficiency for v in goes_on.validations] == [v.efficiency for v in whole.validations]
    for name, value in whole.learner.tensors().items():
        assert torch.equal(value, goes_on.learner.tensors()[name]), name
    other = PaperRun(
        read_paper_config(write(tmp_path), seed=9), tmp_path / "run", torch.device("cpu")
    )
    with pytest.raises(InvalidInput, match="another configuration"):
        other.load_checkpoint()


def test_critics_learn_the_rewards_of_a_batch(tmp_path):
    """Without discount and with little entropy the value of an action is its reward."""
    changes = {"sac": {**TINY["sac"], "learning_rate": 3e-3, "gamma": 1e-9}}
    run, _ = train(read_paper_config(write(tmp_path, **changes)))
    batch = run.replay.sample(64, run.generator)
    losses = [run.learner.update(batch, run.generator)["critic_loss"].item() for _ in range(150)]
    assert losses[-1] < 0.1 * losses[0]


def test_wisar_train_runs_it(tmp_path, capsys):
    out, curve = tmp_path / "out", tmp_path / "curve.json"
    threads = torch.get_num_threads()
    arguments = ["--out", str(out), "--json", str(curve), "--steps", "48"]
    assert main(["train", str(write(tmp_path)), *arguments]) == 0
    assert torch.get_num_threads() == threads
    points = json.loads(curve.read_text())
    assert [each["steps"] for each in points] == [48]
    assert set(points[0]) == {"steps", "updates", "seconds", "efficiency", "share", "figures"}
    assert 0.0 < points[0]["efficiency"] < 1.0
    assert "of the bound" in capsys.readouterr().out
    card = json.loads((out / "paper_sac.json").read_text())
    assert card["validation"]["maps"] == 3
    assert main(["train", str(write(tmp_path)), *arguments]) == 0
    assert "continuing" in capsys.readouterr().out
    assert main(["train", str(write(tmp_path, algorithm="dqn"))]) == 2
    assert "algorithm must be" in capsys.readouterr().err


def test_a_training_that_diverges_ends_in_words(tmp_path, capsys):
    path = write(tmp_path, sac={**TINY["sac"], "learning_rate": 1e9})
    assert main(["train", str(path), "--out", str(tmp_path / "out"), "--threads", "1"]) == 2
    printed = capsys.readouterr()
    assert "best policy" not in printed.out
    assert "lower its learning rates" in printed.err
    assert len(printed.err.splitlines()) == 1


def test_throughput_is_measured_and_added_up(tmp_path, capsys):
    assert throughput.main([str(write(tmp_path)), "--seconds", "0"]) == 0
    found = json.loads(capsys.readouterr().out)
    policy = 4 / found["environment_steps_per_s_with_policy"]
    cycle = 3 * policy + 2 * found["seconds_per_update"]
    assert found["training_steps_per_s"] == pytest.approx(3 * 4 / cycle)
    assert found["days_for_all_steps"] == pytest.approx(120 / (12 / cycle) / 86_400)
    assert throughput.main([str(write(tmp_path, steps=0))]) == 2
    assert "steps must be" in capsys.readouterr().err
