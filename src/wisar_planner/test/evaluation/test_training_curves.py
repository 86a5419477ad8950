"""Tables and figures of trainings."""

import pytest

pytest.importorskip("torch")

import torch

from wisar_planner.cli.main import main
from wisar_planner.errors import InvalidInput
from wisar_planner.evaluation.training_curves import TrainingCurve, draw, markdown, read_curve
from wisar_planner.training.judging import fly_maps
from wisar_planner.training.records import Validation, write_checkpoint
from wisar_planner.training.sac.config import SacConfig
from wisar_planner.training.sac.learner import SacSettings
from wisar_planner.training.sac.run import SacRun
from wisar_planner.training.streams import fresh_generator


def curve(policy: str, seed: int, *points: tuple[float, float]) -> TrainingCurve:
    """Make a curve of points (minutes, e_p); the share is three times e_p."""
    validations = [
        Validation(1000 * (i + 1), i, 60.0 * minutes, e_p, 3.0 * e_p, {})
        for i, (minutes, e_p) in enumerate(points)
    ]
    return TrainingCurve(policy, seed, validations)


def test_the_table_has_mean_and_spread_over_seeds_best_first() -> None:
    table = markdown(
        [
            curve("mlp", 0, (1.0, 0.2), (2.0, 0.26)),
            curve("sac", 0, (1.0, 0.28), (2.0, 0.29), (3.0, 0.27)),
            curve("sac", 1, (1.0, 0.25), (2.0, 0.27), (3.0, 0.28)),
        ]
    ).splitlines()
    assert table[2] == "| sac | 2 | 3,000 | 3.0 | 2.0 | 0.2850 ± 0.0071 | 85.5 ± 2.1% |"
    assert table[3] == "| mlp | 1 | 2,000 | 2.0 | not reached | 0.2600 | 78.0% |"


def test_the_figure_has_a_line_per_run_in_both_views() -> None:
    figure = draw([curve("a", 0, (1.0, 0.2)), curve("a", 1, (1.0, 0.3)), curve("b", 0, (1.0, 0.1))])
    assert [len(axes.get_lines()) for axes in figure.axes] == [3, 3]
    samples, minutes = (axes.get_lines()[1].get_xydata()[0] for axes in figure.axes)
    assert tuple(samples) == pytest.approx((1000.0, 90.0))
    assert tuple(minutes) == pytest.approx((1.0, 90.0))


@pytest.mark.parametrize(
    ("config", "policy"),
    [
        ({"name": "sac", "seed": 4, "ablation": "no_step_gain"}, "sac, no step gain"),
        ({"name": "sac", "seed": 4, "algorithm": "improvement"}, "sac, improved"),
        ({"name": "paper_sac", "seed": 4, "algorithm": "paper_sac"}, "paper_sac"),
    ],
)
def test_a_curve_comes_from_the_folder_of_a_run(tmp_path, config, policy) -> None:
    validation = vars(Validation(10, 1, 2.0, 0.1, 0.3, {}))
    write_checkpoint(tmp_path, {}, {"config": config, "validations": [validation]})
    read = read_curve(tmp_path)
    assert (read.policy, read.seed) == (policy, 4)
    assert read.best.share == 0.3


def test_a_folder_without_a_run_is_refused(tmp_path) -> None:
    with pytest.raises(InvalidInput, match="holds no checkpoint"):
        read_curve(tmp_path)
    (tmp_path / "checkpoint.safetensors").write_bytes(b"no checkpoint")
    with pytest.raises(InvalidInput, match="cannot be read"):
        read_curve(tmp_path)
    write_checkpoint(tmp_path, {}, {"config": {}, "validations": []})
    with pytest.raises(InvalidInput, match="first validation"):
        read_curve(tmp_path)


def test_a_policy_is_judged_on_fresh_maps_from_the_folder_of_its_run(tmp_path, capsys) -> None:
    config = SacConfig(
        steps=80, environments=4, warm_up_steps=32, updates=0.5, batch=8, replay=128, seed=3,
        validation_maps=2, validation_every=80, sac=SacSettings(channels=4, blocks=1),
    )  # fmt: skip
    run = SacRun(config, tmp_path, torch.device("cpu"))
    list(run.train())
    policy = fly_maps(lambda shown: run.sac.act(shown, None), 3, fresh_generator(run.device))
    assert main(["curves", str(tmp_path), "--fresh-maps", "3"]) == 0
    title, _, row = capsys.readouterr().out.splitlines()
    assert title.endswith("on fresh maps |")
    assert row.endswith(f"| {100.0 * float(policy.share.mean()):.1f}% |")
    assert main(["curves", str(tmp_path), "--fresh-maps", "0"]) == 2
    assert "must be at least 1, not 0" in capsys.readouterr().err
