"""`wisar card`: what a policy reaches, in its card."""

import json
import shutil

import pytest

from wisar_planner.cli.main import main
from wisar_planner.policy.model import find_model, load_model


@pytest.fixture
def model(tmp_path):
    """A copy of the shipped policy whose card tells of no evaluation."""
    shipped, path = find_model("sac"), tmp_path / "copy.safetensors"
    shutil.copy(shipped, path)
    card = load_model(shipped).card
    del card["evaluation"]
    path.with_suffix(".json").write_text(json.dumps(card))
    return path


def test_the_card_tells_what_the_policy_reaches(model, tmp_path, capsys) -> None:
    before, weights = load_model(model).card, model.read_bytes()
    assert main(["card", str(model), "--runs", "32", "--jobs", "1"]) == 0
    assert str(model.with_suffix(".json")) in capsys.readouterr().out
    card = load_model(model).card
    found = card.pop("evaluation")
    assert card == before
    assert model.read_bytes() == weights
    # The shipped card was written on these maps, too.
    shipped = load_model(find_model("sac")).card["evaluation"]
    assert found["check"]["e_p_mean"] == pytest.approx(shipped["check"]["e_p_mean"], abs=1e-3)
    assert found["check"]["maps"] == found["maps"] == 32
    assert found["e_p_mean"] == found["check"]["e_p_mean"]
    json_file = tmp_path / "runs.json"
    options = ["--option", f"sac.model={model}", "--jobs", "1", "--json", str(json_file)]
    assert main(["evaluate", "--planner", "sac", "--runs", "32", *options]) == 0
    told = json.loads(json_file.read_text())["planners"]["sac"]
    for name in ("e_p_mean", "e_p_std", "share_of_bound"):
        assert found[name] == pytest.approx(told[name], abs=1e-5)
    assert found["e_p_95"] == pytest.approx(told["e_p_mean_ci"], abs=1e-5)


def test_too_few_maps_are_refused_and_the_card_stays(model, capsys) -> None:
    before = model.with_suffix(".json").read_bytes()
    assert main(["card", str(model), "--runs", "31"]) == 2
    error = capsys.readouterr().err
    assert "--runs must be at least 32, not 31" in error
    assert len(error.splitlines()) == 1
    assert model.with_suffix(".json").read_bytes() == before
