import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
import yaml
from scipy import stats

from wisar_planner.cli.main import main
from wisar_planner.errors import InvalidInput
from wisar_planner.evaluation import sweep as sweep_module
from wisar_planner.evaluation.sweep import Sweep, SweepRecord
from wisar_planner.evaluation.sweep_report import markdown, save_figures
from wisar_planner.evaluation.sweep_statistics import summarise
from wisar_planner.training.paper.config import PaperConfig
from wisar_planner.training.paper.run import PaperRun

TINY = {
    "algorithm": "paper_sac",
    "environments": 4,
    "learning_starts": 24,
    "train_every": 3,
    "gradient_steps": 2,
    "validation_maps": 3,
    "task": {"waypoints": 6, "gaussians": 2},
    "sac": {"learning_rate": 1e-3, "batch": 16},
}
RANGES = ["--layers", "1,3", "--width", "4,24", "--path-features", "4,24", "--steps", "48"]


@pytest.fixture
def config(tmp_path):
    path = tmp_path / "tiny.yaml"
    path.write_text(yaml.safe_dump(TINY))
    return str(path)


def without_times(path):
    results = json.loads(path.read_text())
    for sample in results["samples"]:
        del sample["seconds"]
    return results


def made_up(count, seed=0):
    """Samples whose e_p rises with the width and is higher for one extractor, with noise."""
    rng = np.random.default_rng(seed)
    names = ("fcn", "cnn_1d", "cnn_2d")
    records = []
    for i in range(count):
        layers, width, features = (int(rng.integers(1, n)) for n in (12, 2000, 1000))
        name = names[i % 3]
        e_p = 0.05 + 4e-5 * width + 0.05 * (name == "cnn_2d") + rng.normal(0.0, 0.01)
        records.append(
            SweepRecord(i, layers, width, features, name, layers * width**2, e_p, 2 * e_p, 1.0)
        )
    return records


def test_four_samples_give_p_values_tables_and_figures(tmp_path, config, capsys):
    paths = [tmp_path / "new" / name for name in ("out.json", "table.md", "figures")]
    outputs = ["--json", str(paths[0]), "--markdown", str(paths[1]), "--figures", str(paths[2])]
    assert main(["sweep", config, "--samples", "4", *RANGES, *outputs]) == 0
    results = json.loads(paths[0].read_text())
    assert results["setup"]["samples"] == len(results["samples"]) == 4
    for name in ("layers", "width", "path_features", "parameters"):
        values = [each[name] for each in results["samples"]]
        if len(set(values)) > 1:
            wanted = stats.linregress(values, [each["e_p"] for each in results["samples"]])
            fit = results["ols"][name]
            assert fit["p_value"] == pytest.approx(wanted.pvalue, rel=1e-6)
            assert fit["slope"] == pytest.approx(wanted.slope, rel=1e-6)
    assert results["ols"]["width"]["p_value"] is not None
    assert paths[1].read_text().startswith("| e_p on | slope |")
    assert len(list(paths[2].glob("*.png"))) == 6
    assert "Welch" in capsys.readouterr().out
    # Finished: the samples that were kept for continuing are gone.
    assert sorted(p.name for p in paths[0].parent.iterdir()) == ["figures", "out.json", "table.md"]


def test_resumed_file_is_kept_and_gives_the_same_numbers(tmp_path, config, capsys):
    kept, command = tmp_path / "kept.jsonl", ["sweep", config, *RANGES]
    outs = [tmp_path / f"{i}.json" for i in range(2)]
    assert main([*command, "--samples", "1", "--resume", str(kept)]) == 0
    with kept.open("a") as file:
        file.write('{"index": 1, "lay')  # stopped while it wrote
    assert main([*command, "--samples", "3", "--resume", str(kept), "--json", str(outs[0])]) == 0
    assert len(kept.read_text().splitlines()) == 4
    assert main([*command, "--samples", "3", "--json", str(outs[1])]) == 0
    assert without_times(outs[0]) == without_times(outs[1])
    assert main([*command, "--samples", "3", "--seed", "1", "--resume", str(kept)]) == 2
    assert "another sweep (seed differ)" in capsys.readouterr().err
    other = tmp_path / "other.txt"
    other.write_text("a letter\n")
    assert main([*command, "--samples", "1", "--resume", str(other)]) == 2
    assert other.read_text() == "a letter\n"


def test_more_samples_than_a_smaller_sweep_tells_are_kept(tmp_path, config, capsys):
    out, kept = tmp_path / "out.json", tmp_path / "out.json.samples.jsonl"
    command = ["sweep", config, *RANGES]
    assert main([*command, "--samples", "2", "--resume", str(kept)]) == 0
    assert main([*command, "--samples", "1", "--json", str(out)]) == 0
    assert len(kept.read_text().splitlines()) == 3
    assert f"1 more samples, not in these results, are kept in {kept}" in capsys.readouterr().err
    assert main([*command, "--samples", "2", "--json", str(out)]) == 0
    assert not kept.exists()


def test_outputs_are_checked_before_training(tmp_path, config, monkeypatch, capsys):
    def fail(*_args, **_options):
        raise AssertionError("it trains")

    monkeypatch.setattr("wisar_planner.evaluation.sweep.run_sweep", fail)
    before = Path(config).read_text()
    assert main(["sweep", config, "--markdown", config]) == 2
    assert "same file" in capsys.readouterr().err
    assert Path(config).read_text() == before
    (tmp_path / "file").touch()
    assert main(["sweep", config, "--figures", str(tmp_path / "file")]) == 2
    assert "--figures" in capsys.readouterr().err


def test_samples_that_diverge_are_told_and_left_out(tmp_path, config, monkeypatch, capsys):
    """A sweep goes on after them, and from a file that holds them."""
    command = ["sweep", config, *RANGES, "--samples", "5"]
    whole, some, kept = (tmp_path / name for name in ("whole.json", "some.json", "kept.jsonl"))
    assert main([*command, "--json", str(whole)]) == 0
    assert "Diverged" not in capsys.readouterr().out
    astray = Sweep(PaperConfig()).sample(2).seed

    class Run(PaperRun):
        """One of the samples learns far too fast."""

        def __init__(self, config, folder, device):
            rate = 1e9 if config.seed == astray else config.sac.learning_rate
            sac = dataclasses.replace(config.sac, learning_rate=rate)
            super().__init__(dataclasses.replace(config, sac=sac), folder, device)

    monkeypatch.setattr(sweep_module, "PaperRun", Run)
    for _ in range(2):
        assert main([*command, "--json", str(some), "--resume", str(kept)]) == 0
        assert "samples 2." in capsys.readouterr().out
        found, expected = without_times(some), without_times(whole)
        assert found["setup"]["samples"] == 4
        lost = found["samples"].pop(2)
        assert lost["e_p"] is None
        assert lost["parameters"] == expected["samples"].pop(2)["parameters"]
        assert found["samples"] == expected["samples"]
        sizes, reached = zip(
            *((each["width"], each["e_p"]) for each in found["samples"]), strict=True
        )
        fit = stats.linregress(sizes, reached)
        assert found["ols"]["width"]["slope"] == pytest.approx(fit.slope, rel=1e-6)
    assert len(kept.read_text().splitlines()) == 6


def test_a_sweep_of_which_all_diverges_ends_in_words(tmp_path, capsys):
    path, figures = tmp_path / "fast.yaml", tmp_path / "figures"
    path.write_text(yaml.safe_dump(TINY | {"sac": {"learning_rate": 1e9, "batch": 16}}))
    command = ["sweep", str(path), *RANGES, "--samples", "2", "--figures", str(figures)]
    assert main(command) == 0
    assert "samples 0, 1." in capsys.readouterr().out
    assert len(list(figures.glob("*.png"))) == 6


def test_a_sample_depends_on_seed_and_index_alone():
    few, many = Sweep(PaperConfig(), samples=3), Sweep(PaperConfig(), samples=300)
    assert few.sample(2) == many.sample(2)
    assert few.sample(2) != Sweep(PaperConfig(), seed=1).sample(2)
    networks = [many.sample(i).network for i in range(300)]
    assert {each.layers for each in networks} == set(range(1, 13))
    assert {each.path_extractor for each in networks} == {"fcn", "cnn_1d", "cnn_2d"}
    assert all(100 <= each.width <= 2000 for each in networks)
    assert min(each.path_features for each in networks) < 150
    assert len({many.sample(i).seed for i in range(300)}) == 300


def test_statistics_find_what_was_put_in():
    records = made_up(60)
    results = summarise(Sweep(PaperConfig(), samples=60), records)
    assert results["ols"]["width"]["p_value"] < 1e-6
    assert results["ols"]["width"]["slope"] == pytest.approx(4e-5, rel=0.3)
    assert results["ols"]["path_features"]["p_value"] > 0.05
    assert results["ols_together"]["width"]["p_value"] < 1e-6
    groups = {
        name: [r.e_p for r in records if r.path_extractor == name]
        for name in ("fcn", "cnn_1d", "cnn_2d")
    }
    table = results["extractor_p_values"]
    for one in groups:
        for other in groups.keys() - {one}:
            wanted = stats.ttest_ind(groups[one], groups[other], equal_var=False).pvalue
            assert table[one][other] == pytest.approx(wanted)
    assert table["cnn_2d"]["fcn"] < 0.05


def test_what_cannot_be_estimated_is_left_open(tmp_path):
    results = summarise(Sweep(PaperConfig(), samples=2), made_up(2))
    assert results["ols"]["width"]["p_value"] is None
    assert results["extractor_p_values"]["fcn"]["cnn_2d"] is None
    json.dumps(results, allow_nan=False)
    assert "| – |" in markdown(results)
    assert len(save_figures(tmp_path, results)) == 6


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--samples", "0"], "samples must be at least 1"),
        (["--width", "9,3"], "width must be a range"),
        (["--path-extractors", "fcn,gru"], "path_extractors must be some of"),
        (["--steps", "0"], "steps must be at least 1"),
    ],
)
def test_wrong_values_are_refused_by_name(config, arguments, message, capsys):
    assert main(["sweep", config, *arguments]) == 2
    assert message in capsys.readouterr().err


def test_a_file_of_another_algorithm_is_refused(tmp_path, capsys):
    path = tmp_path / "sac.yaml"
    path.write_text("steps: 1000")
    assert main(["sweep", str(path)]) == 2
    assert "algorithm" in capsys.readouterr().err
    with pytest.raises(InvalidInput, match="seed must not be negative"):
        Sweep(PaperConfig(), seed=-1)
