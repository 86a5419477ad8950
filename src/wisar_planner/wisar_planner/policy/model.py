"""Trained policies: weights as safetensors, a model card as JSON beside them."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from safetensors import SafetensorError
from safetensors.numpy import load as load_tensors
from safetensors.numpy import save as save_tensors

from wisar_planner.errors import InvalidInput
from wisar_planner.policy import observation
from wisar_planner.policy.heading import (
    ACTOR_OUTPUTS,
    DISTRIBUTIONS,
    GAUSSIAN,
)
from wisar_planner.policy.network import initial_parameters
from wisar_planner.policy.observation import DIRECTIONS, NUMBERS, VIEW_WIDTH
from wisar_planner.policy.ring_kernels import RingWeights

#: Name of the policy that the planners load unless told otherwise.
DEFAULT_MODEL = "sac"

# Largest network that a card may ask memory for.
_LARGEST = {"channels": 1024, "blocks": 32}

Weights = dict[str, npt.NDArray[np.float32]]


@dataclass(frozen=True)
class Model:
    """A trained policy.

    Parameters
    ----------
    weights : dict of str to float32 arrays
        Parameters of the actor's network, see `network.forward`.
    card : dict
        The model card: what it is, how it was trained, how good it is.
    """

    weights: Weights
    card: dict[str, Any]

    @property
    def distribution(self) -> str:
        """How its turns are distributed, one of `heading.DISTRIBUTIONS`."""
        return distribution_of(self.card)

    @cached_property
    def ring_weights(self) -> RingWeights:
        """The weights, laid out for `ring_network`."""
        return RingWeights.of(self.weights)

    def noise(self, rng: np.random.Generator, searches: int) -> npt.NDArray[np.float32]:
        """Return draws that make turns random, (searches, DIRECTIONS); see `decide`."""
        size = (searches, DIRECTIONS)
        if self.distribution == GAUSSIAN:
            return rng.standard_normal(size, dtype=np.float32)
        return rng.gumbel(size=size).astype(np.float32)


def distribution_of(card: dict[str, Any]) -> str:
    """Return what a card says of the distribution of turns; that of the first models unless so."""
    return str(card.get("distribution", GAUSSIAN))


def interface() -> dict[str, int]:
    """Return what a model and this code must agree on; stands in the card as `interface`."""
    return {
        "observation_version": observation.VERSION,
        "directions": DIRECTIONS,
        "view_width": VIEW_WIDTH,
        "numbers": NUMBERS,
        "outputs": ACTOR_OUTPUTS,
    }


def save_model(path: Path, weights: Weights, card: dict[str, Any]) -> None:
    """Write `path` (.safetensors) and the card (.json) beside it.

    Parameters
    ----------
    path : Path
        Where to; ends in .safetensors.
    weights : dict of str to float32 arrays
        Parameters of the actor's network.
    card : dict
        What to say of it; the interface, the network's size and the hash of the weights are added.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    content = save_tensors({name: np.ascontiguousarray(weights[name]) for name in sorted(weights)})
    path.write_bytes(content)
    described = {
        **card,
        "interface": interface(),
        "network": _size(weights),
        "weights_sha256": hashlib.sha256(content).hexdigest(),
    }
    path.with_suffix(".json").write_text(json.dumps(described, indent=2) + "\n", encoding="utf-8")


def find_model(name: str) -> Path:
    """Return the weights' path of a model that is given by its path or by its name.

    Raises
    ------
    InvalidInput
        When there is none.
    """
    if name.endswith(".safetensors"):
        path = Path(name).expanduser()
        if not path.is_file():
            raise InvalidInput(f"model: there is no file {path}")
        return path
    # In an installation below share/, in a source tree at its top.
    shipped = [
        folder / place
        for folder in Path(__file__).resolve().parents
        for place in (Path("share/wisar_planner/models"), Path("models"))
    ]
    for folder in shipped:
        if (path := folder / f"{name}.safetensors").is_file():
            return path
    known = sorted({p.stem for folder in shipped for p in folder.glob("*.safetensors")})
    listed = f"the shipped ones are {', '.join(known)}" if known else "none is installed"
    raise InvalidInput(
        f"model: {name!r} is neither a shipped model ({listed}) nor a path that ends in "
        ".safetensors"
    )


def load_model(path: Path) -> Model:
    """Return a trained policy, checked against its card and this code.

    Raises
    ------
    InvalidInput
        When weights or card cannot be read, do not belong together, or are of another observation
        or network than this code's.
    """
    card = _read_card(path.with_suffix(".json"))
    try:
        content = path.read_bytes()
    except OSError as error:
        raise InvalidInput(f"model: {path} cannot be read: {error.strerror}") from None
    found = hashlib.sha256(content).hexdigest()
    if found != card["weights_sha256"]:
        raise InvalidInput(
            f"model: {path} is not the file that its card describes (SHA-256 {found[:12]}..., the "
            f"card says {str(card['weights_sha256'])[:12]}...); copy both files again"
        )
    if card["interface"] != interface():
        raise InvalidInput(
            f"model: {path} was trained for another observation ({card['interface']}) than this "
            f"version computes ({interface()}); train it anew or install the version it belongs to"
        )
    if distribution_of(card) not in DISTRIBUTIONS:
        raise InvalidInput(
            f"model: the card of {path} says that turns are distributed as "
            f"{distribution_of(card)!r}; this version knows {' and '.join(DISTRIBUTIONS)}"
        )
    try:
        weights = load_tensors(content)
    except (SafetensorError, ValueError, KeyError) as error:
        raise InvalidInput(f"model: {path} is no safetensors file: {error}") from None
    _check_weights(path, weights, card["network"])
    return Model(weights, card)


def _read_card(path: Path) -> dict[str, Any]:
    try:
        card = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InvalidInput(
            f"model: its card {path} cannot be read ({error.strerror}); it belongs beside the "
            "weights"
        ) from None
    except ValueError as error:
        raise InvalidInput(f"model: its card {path} is not JSON: {error}") from None
    wanted = {"weights_sha256": str, "interface": dict, "network": dict}
    for name, kind in wanted.items():
        if not isinstance(card, dict) or not isinstance(card.get(name), kind):
            raise InvalidInput(f"model: its card {path} lacks {name}")
    return card


def _size(weights: Weights) -> dict[str, int]:
    return {
        "channels": int(weights["view"].shape[1]),
        "blocks": sum(name.startswith("ring") for name in weights),
    }


def _check_weights(path: Path, weights: Weights, network: dict[str, Any]) -> None:
    """Raise where the weights are not those of a network of the card's size."""
    size: dict[str, Any] = {name: network.get(name) for name in ("channels", "blocks")}
    if not all(isinstance(n, int) and 0 < n <= _LARGEST[name] for name, n in size.items()):
        raise InvalidInput(f"model: the card of {path} gives no network size: {network}")
    expected = initial_parameters(
        np.random.default_rng(0),
        networks=1,
        outputs=ACTOR_OUTPUTS,
        channels=size["channels"],
        blocks=size["blocks"],
    )
    if weights.keys() != expected.keys():
        odd = sorted(weights.keys() ^ expected.keys())
        raise InvalidInput(f"model: {path} lacks or has beyond its network: {', '.join(odd)}")
    for name, value in weights.items():
        if value.shape != expected[name].shape or value.dtype != np.float32:
            raise InvalidInput(
                f"model: {name} in {path} is {value.dtype}{list(value.shape)}, its network needs "
                f"float32{list(expected[name].shape)}"
            )
        if not np.isfinite(value).all():
            raise InvalidInput(f"model: {name} in {path} has values that are not finite")
