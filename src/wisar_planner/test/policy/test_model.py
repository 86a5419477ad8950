import hashlib
import json
import pickle
from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import save

from wisar_planner import InvalidInput
from wisar_planner.policy import model as module
from wisar_planner.policy.heading import (
    ACTOR_OUTPUTS,
    DIRECTED,
    GAUSSIAN,
)
from wisar_planner.policy.model import DEFAULT_MODEL, Model, find_model, load_model, save_model
from wisar_planner.policy.network import initial_parameters
from wisar_planner.policy.observation import DIRECTIONS


def weights():
    rng = np.random.default_rng(1)
    return initial_parameters(rng, networks=1, outputs=ACTOR_OUTPUTS, channels=4, blocks=2)


@pytest.fixture
def path(tmp_path):
    """A good model; tests spoil it."""
    path = tmp_path / "new" / "good.safetensors"
    save_model(path, weights(), {"name": "good", "validation": {"e_p": 0.25}})
    load_model(path)
    return path


def rewrite(path, content):
    """Write weights, and their hash into the card."""
    path.write_bytes(content)
    card = json.loads(path.with_suffix(".json").read_text())
    card["weights_sha256"] = hashlib.sha256(content).hexdigest()
    path.with_suffix(".json").write_text(json.dumps(card))


def spoil_card(path, **changes):
    card = path.with_suffix(".json")
    card.write_text(json.dumps({**json.loads(card.read_text()), **changes}))


def test_what_was_saved_is_loaded(path):
    loaded = load_model(path)
    assert loaded.weights.keys() == weights().keys()
    for name, value in weights().items():
        np.testing.assert_array_equal(loaded.weights[name], value)
        assert loaded.weights[name].dtype == np.float32
    assert loaded.card["name"] == "good"
    assert loaded.card["validation"] == {"e_p": 0.25}
    assert loaded.card["network"] == {"channels": 4, "blocks": 2}


def test_the_same_weights_give_the_same_file(path, tmp_path):
    other = tmp_path / "other.safetensors"
    save_model(other, dict(reversed(weights().items())), {})
    assert other.read_bytes() == path.read_bytes()


def test_the_shipped_model_loads():
    found = load_model(find_model(DEFAULT_MODEL))
    assert found.weights["output"].shape[1] == ACTOR_OUTPUTS


def test_a_card_tells_how_turns_are_distributed_and_older_ones_mean_gaussian(path):
    assert load_model(path).distribution == GAUSSIAN
    spoil_card(path, distribution=DIRECTED)
    assert load_model(path).distribution == DIRECTED


def test_noise_is_of_the_policys_distribution_and_repeats_by_seed():
    gaussian, directed = (Model({}, {"distribution": each}) for each in (GAUSSIAN, DIRECTED))
    noise = [each.noise(np.random.default_rng(3), 2000) for each in (gaussian, directed)]
    assert noise[0].shape == noise[1].shape == (2000, DIRECTIONS)
    assert abs(noise[0].mean()) < 0.02
    assert noise[0].std() == pytest.approx(1.0, abs=0.02)
    assert noise[1].mean() == pytest.approx(np.euler_gamma, abs=0.02)
    assert noise[1].std() == pytest.approx(np.pi / np.sqrt(6.0), abs=0.02)
    np.testing.assert_array_equal(noise[1], directed.noise(np.random.default_rng(3), 2000))


def test_a_model_is_found_by_its_path(path):
    assert find_model(str(path)) == path


@pytest.mark.parametrize("name", ["sca", "", "sac.pt", "../sac2"])
def test_an_unknown_name_is_refused_with_the_known_ones(name):
    with pytest.raises(InvalidInput, match=rf"'{name}' is neither .*shipped ones are .*\bsac\b"):
        find_model(name)


def test_a_path_without_a_file_is_refused(tmp_path):
    with pytest.raises(InvalidInput, match=r"there is no file .*none\.safetensors"):
        find_model(str(tmp_path / "none.safetensors"))


def remove_weights(path):
    path.unlink()


def remove_card(path):
    path.with_suffix(".json").unlink()


def flip_a_bit(path):
    content = bytearray(path.read_bytes())
    content[-1] ^= 1
    path.write_bytes(content)


def cut_short(path):
    rewrite(path, path.read_bytes()[:-8])


def claim_a_huge_header(path):
    rewrite(path, b"\xff" * 8 + path.read_bytes()[8:])


def empty(path):
    rewrite(path, b"")


def card_that_is_no_json(path):
    path.with_suffix(".json").write_text("name: good")


def card_that_is_no_text(path):
    path.with_suffix(".json").write_bytes(b"\xff\xfe\x00")


def card_that_is_a_list(path):
    path.with_suffix(".json").write_text("[1, 2]")


def card_without(field):
    def spoil(path):
        card = json.loads(path.with_suffix(".json").read_text())
        del card[field]
        path.with_suffix(".json").write_text(json.dumps(card))

    return spoil


def card_with(**changes):
    return lambda path: spoil_card(path, **changes)


def another_observation(path):
    interface = module.interface()
    changed = {**interface, "observation_version": interface["observation_version"] + 1}
    spoil_card(path, interface=changed)


def tensors(**changes):
    """Write weights with some replaced, or left out where None."""

    def spoil(path):
        changed = {**weights(), **changes}
        rewrite(path, save({name: each for name, each in changed.items() if each is not None}))

    return spoil


def not_a_number(path):
    values = weights()["mix1"]
    values[0, 1, 2] = np.nan
    tensors(mix1=values)(path)


def infinite(path):
    tensors(bias=np.full((1, 4, 1), np.inf, dtype=np.float32))(path)


def half_the_bits(path):
    """Safetensors of a type that NumPy lacks."""
    header = json.dumps({"view": {"dtype": "BF16", "shape": [1], "data_offsets": [0, 2]}}).encode()
    rewrite(path, len(header).to_bytes(8, "little") + header + b"\x00\x00")


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (remove_weights, r"good\.safetensors cannot be read: No such file"),
        (remove_card, r"card .*good\.json cannot be read .*beside the weights"),
        (flip_a_bit, "not the file that its card describes"),
        (cut_short, "no safetensors file"),
        (claim_a_huge_header, "no safetensors file"),
        (empty, "no safetensors file"),
        (half_the_bits, r"good\.safetensors"),
        (card_that_is_no_json, "is not JSON"),
        (card_that_is_no_text, "is not JSON"),
        (card_that_is_a_list, "lacks weights_sha256"),
        (card_without("weights_sha256"), "lacks weights_sha256"),
        (card_without("interface"), "lacks interface"),
        (card_without("network"), "lacks network"),
        (card_with(weights_sha256=None), "lacks weights_sha256"),
        (
            card_with(distribution="cubic"),
            "distributed as 'cubic'",
        ),
        (card_with(network={}), "no network size"),
        (card_with(network={"channels": 4, "blocks": "2"}), "no network size"),
        (card_with(network={"channels": 4, "blocks": -1}), "no network size"),
        (card_with(network={"channels": 4096, "blocks": 4096}), "no network size"),
        (card_with(network={"channels": 4, "blocks": 3}), "lacks .*ring2"),
        (card_with(network={"channels": 8, "blocks": 2}), "its network needs"),
        (another_observation, "trained for another observation"),
        (tensors(view=None), "lacks .*view"),
        (tensors(extra=np.zeros(3, np.float32)), "beyond its network: extra"),
        (tensors(mix0=np.zeros((1, 4, 5), np.float32)), r"mix0 .* float32\[1, 4, 5\]"),
        (tensors(mix0=np.zeros((1, 4, 4))), "mix0 .* float64"),
        (not_a_number, "mix1 .* not finite"),
        (infinite, "bias .* not finite"),
    ],
)
def test_a_bad_model_is_refused_in_words(path, spoil, said):
    spoil(path)
    with pytest.raises(InvalidInput, match=said) as refusal:
        load_model(path)
    assert str(path.parent) in str(refusal.value)


class Boom:
    """Leaves a file behind when it is unpickled."""

    def __init__(self, mark: Path) -> None:
        self.mark = mark

    def __reduce__(self):
        return (Path.touch, (self.mark,))


def test_nothing_is_unpickled(path, tmp_path):
    mark = tmp_path / "mark"
    rewrite(path, pickle.dumps(Boom(mark)))
    with pytest.raises(InvalidInput, match="no safetensors file"):
        load_model(path)
    assert not mark.exists()
    pickle.loads(path.read_bytes())
    assert mark.exists()
