"""Tables and figures of trainings."""

import dataclasses
import json

import pytest

pytest.importorskip("torch")

import torch

from wisar_planner.cli.main import main
from wisar_planner.errors import InvalidInput
from wisar_planner.evaluation.training_curves import (
    TrainingCurve,
    check_seeds,
    draw,
    fly_fresh_maps,
    markdown,
    read_curve,
)
from wisar_planner.policy.model import Model, find_model, load_model
from wisar_planner.training.judging import fly_problem
from wisar_planner.training.problems import random_problems
from wisar_planner.training.records import Validation, read_checkpoint, write_checkpoint
from wisar_planner.training.sac.config import SacConfig
from wisar_planner.training.sac.learner import SacSettings
from wisar_planner.training.sac.run import SacRun
from wisar_planner.training.streams import fresh_generator
from wisar_planner.training.worlds import WorldDistribution


def curve(policy: str, seed: int, *points: tuple[float, float], **config) -> TrainingCurve:
    """Make a curve of points (minutes, e_p); the share is three times e_p."""
    validations = [
        Validation(1000 * (i + 1), i, 60.0 * minutes, e_p, 3.0 * e_p, {})
        for i, (minutes, e_p) in enumerate(points)
    ]
    return TrainingCurve(policy, seed, validations, config={"seed": seed, **config})


def lines_of(*curves: TrainingCurve) -> list[tuple[str, int]]:
    """Return the names and numbers of runs of the lines of the table, sorted."""
    rows = [row.split(" | ") for row in markdown(curves).splitlines()[2:]]
    return sorted((row[0].removeprefix("| "), int(row[1])) for row in rows)


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


POINT = (1.0, 0.2)


def test_runs_of_other_configurations_are_no_seeds() -> None:
    runs = [
        curve("sac", 0, POINT, steps=600_000, sac={"rate": 0.1}),
        curve("sac", 1, POINT, steps=600_000, sac={"rate": 0.1}),
        curve("sac", 0, POINT, steps=60_000, sac={"rate": 0.1}),
        curve("paper", 0, POINT, steps=60_000),
    ]
    assert lines_of(*runs) == [("paper", 1), ("sac, steps 60,000", 1), ("sac, steps 600,000", 2)]
    labels = [text.get_text() for text in draw(runs).axes[0].get_legend().get_texts()]
    assert labels == ["sac, steps 600,000", "sac, steps 60,000", "paper"]
    runs.append(curve("sac", 0, POINT, steps=60_000, sac={"rate": 0.2}))
    assert lines_of(*runs)[1:] == [
        ("sac, steps 60,000, sac rate 0.1", 1),
        ("sac, steps 60,000, sac rate 0.2", 1),
        ("sac, steps 600,000, sac rate 0.1", 2),
    ]


def test_a_name_takes_only_what_tells_configurations_apart() -> None:
    few = curve("sac", 0, POINT, steps=10, batch=1, worlds={"paper_share": 0.5, "cells": [1, 2]})
    many = curve("sac", 0, POINT, steps=20, batch=2, worlds={"paper_share": 0.5, "cells": [1, 3]})
    assert lines_of(few, many) == [("sac, steps 10 and 2 more", 1), ("sac, steps 20 and 2 more", 1)]
    older = curve("sac", 0, POINT, steps=10, batch=1, worlds={"paper_share": 0.5})
    assert lines_of(few, older) == [("sac, no worlds cells", 1), ("sac, worlds cells [1, 2]", 1)]


def test_improvements_of_the_runs_of_their_seeds_are_one_line() -> None:
    starts = [f"out/train/sac-{seed}/sac.safetensors" for seed in range(3)]
    runs = [curve("sac, improved", seed, POINT, start=starts[seed]) for seed in range(3)]
    assert lines_of(*runs) == [("sac, improved", 3)]
    other = curve("sac, improved", 0, POINT, start="models/sac_plain.safetensors")
    assert [seeds for _, seeds in lines_of(*runs, other)] == [1, 3]
    same = [curve("sac, improved", seed, POINT, start=starts[1]) for seed in range(3)]
    assert lines_of(*same) == [("sac, improved", 3)]


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
    assert (read.policy, read.seed, read.config) == (policy, 4, config)
    assert read.best.share == 0.3


def test_the_best_policy_is_the_one_that_is_kept() -> None:
    """By both kinds of worlds, where both were flown."""
    early = Validation(10, 1, 2.0, 0.3, 0.87, {"other_worlds": 0.78})
    late = Validation(20, 2, 4.0, 0.3, 0.88, {"other_worlds": 0.75})
    curve = TrainingCurve("sac", 0, [early, late], config={"worlds": {"paper_share": 0.5}})
    assert curve.best is early
    assert dataclasses.replace(curve, config={"worlds": {"paper_share": 0.9}}).best is late


def test_a_figure_of_an_unknown_kind_is_refused_before_flying(tmp_path, capsys) -> None:
    assert main(["curves", str(tmp_path), "--figure", str(tmp_path / "curves.xyz")]) == 2
    error = capsys.readouterr().err
    assert "--figure" in error
    assert len(error.splitlines()) == 1


def test_a_table_is_not_written_over_what_a_run_keeps(tmp_path, capsys) -> None:
    kept = tmp_path / "checkpoint.safetensors"
    kept.write_bytes(b"kept")
    assert main(["curves", str(tmp_path), "--markdown", str(kept)]) == 2
    assert "is the same file as the run's own" in capsys.readouterr().err
    assert kept.read_bytes() == b"kept"


def test_a_folder_without_a_run_is_refused(tmp_path) -> None:
    with pytest.raises(InvalidInput, match="holds no checkpoint"):
        read_curve(tmp_path)
    (tmp_path / "checkpoint.safetensors").write_bytes(b"no checkpoint")
    with pytest.raises(InvalidInput, match="cannot be read"):
        read_curve(tmp_path)
    write_checkpoint(tmp_path, {}, {"config": {}, "validations": []})
    with pytest.raises(InvalidInput, match="first validation"):
        read_curve(tmp_path)


TINY = SacConfig(
    name="tiny", steps=80, environments=4, warm_up_steps=32, updates=0.5, batch=8, replay=128,
    seed=3, validation_maps=2, validation_every=80, sac=SacSettings(channels=4, blocks=1),
)  # fmt: skip


@pytest.fixture
def trained(tmp_path, monkeypatch):
    """A function that trains in the folder."""
    monkeypatch.setattr(torch, "get_num_threads", lambda: 1)  # flies here, in no other process

    def train(config):
        run = SacRun(config, tmp_path, torch.device("cpu"))
        list(run.train())
        return run

    return train


def on_fresh_maps(folder, capsys) -> str:
    """Return the last column of the table's only line."""
    assert main(["curves", str(folder), "--fresh-maps", "3"]) == 0
    title, _, row = capsys.readouterr().out.splitlines()
    assert title.endswith("of the last, on fresh maps |")
    return row.split("|")[-2].strip()


def test_a_policy_is_judged_as_it_is_planned_with(tmp_path, trained, capsys) -> None:
    """Its last one, by the exact seen probability."""
    run = trained(TINY)
    weights = {name: each.detach().numpy() for name, each in run.sac.actor.items()}
    problems = random_problems(3, 0, WorldDistribution(), fresh_generator(run.device))
    shares = [fly_problem(each, Model(weights, {}))[1] for each in problems]
    flown: list[int] = []
    curve = fly_fresh_maps(read_curve(tmp_path), tmp_path, 3, flown.append)
    assert curve.fresh_share == pytest.approx(sum(shares) / 3.0, rel=1e-12)
    assert sum(flown) == 3
    assert on_fresh_maps(tmp_path, capsys) == f"{100.0 * sum(shares) / 3.0:.1f}%"
    assert main(["curves", str(tmp_path), "--fresh-maps", "0"]) == 2
    assert "must be at least 1, not 0" in capsys.readouterr().err


@pytest.mark.parametrize("ablation", ["mlp", "no_fine_scale", "absolute_heading"])
def test_what_no_planner_can_fly_is_judged_exactly_too(tmp_path, trained, capsys, ablation) -> None:
    """Which is what the raster of its environment tells, but for the width of its cells."""
    run = trained(dataclasses.replace(TINY, ablation=ablation))
    flown: list[int] = []
    curve = fly_fresh_maps(read_curve(tmp_path), tmp_path, 3, flown.append)
    by_raster = float(run.fly(3, fresh_generator(run.device)).share.mean())
    assert curve.fresh_share == pytest.approx(by_raster, rel=0.03)
    assert curve.fresh_share != by_raster
    assert sum(flown) == 3
    assert on_fresh_maps(tmp_path, capsys) == f"{100.0 * curve.fresh_share:.1f}%"


def test_flights_in_the_environment_are_those_of_plans(trained) -> None:
    """So that ablations are flown over the same maps as what they are compared with.

    Rounding differs, so that some flights part from each other.
    """
    plain = load_model(find_model("sac_plain"))
    run = trained(dataclasses.replace(TINY, sac=SacSettings(channels=32, blocks=3)))
    run.sac.actor = {name: torch.tensor(each) for name, each in plain.weights.items()}
    problems = random_problems(24, 0, WorldDistribution(), fresh_generator(run.device))
    planned = torch.tensor([fly_problem(each, plain)[1] for each in problems])
    judged = run.judge(24, fresh_generator(run.device), lambda _: None)
    assert judged.exact
    assert float(judged.share.mean()) == pytest.approx(float(planned.mean()), rel=0.01)
    assert int(((judged.share - planned).abs() < 0.01).sum()) > 12


@pytest.mark.parametrize("ablation", ["", "mlp"])
def test_a_run_begun_on_a_gpu_is_judged_and_not_gone_on_with_on_a_cpu(
    tmp_path, trained, capsys, ablation
) -> None:
    config = dataclasses.replace(TINY, ablation=ablation)
    trained(config)
    tensors, counters = read_checkpoint(tmp_path, dataclasses.asdict(config), torch.device("cpu"))
    # The state of a GPU's generator has 16 bytes.
    tensors["generator"] = torch.zeros(16, dtype=torch.uint8)
    write_checkpoint(tmp_path, tensors, counters)
    assert on_fresh_maps(tmp_path, capsys)
    file = tmp_path / "tiny.yaml"
    file.write_text(json.dumps(dataclasses.asdict(config)))  # JSON is YAML, too
    assert main(["train", str(file), "--out", str(tmp_path), "--threads", "1"]) == 2
    error = capsys.readouterr().err
    assert "begun on cuda; go on with --device cuda" in error
    assert len(error.splitlines()) == 1


def test_two_runs_of_one_seed_are_no_two_seeds() -> None:
    curves = [curve("sac", 0, POINT), curve("sac", 1, POINT), curve("sac", 1, POINT)]
    check_seeds(curves[:2])
    with pytest.raises(InvalidInput, match="sac: there are 2 runs of seed 1"):
        check_seeds(curves)
