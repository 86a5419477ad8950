"""The ring network: one column per direction, weights shared over the directions.

Each block mixes the directions of each channel by a circular convolution over the whole ring, then
the channels of each direction. So the network is equivariant under a turn of the ring, sees all of
it in every block, and costs a fraction of a convolution over channels and neighbours. Several
networks of the same shape run side by side (twin critics).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
from array_api_compat import array_namespace, device

from wisar_planner.policy.observation import DIRECTIONS, NUMBERS, VIEW_WIDTH
from wisar_planner.policy.unseen_map import Array

Parameters = Mapping[str, Array]

#: Where each direction lies in the mirror image.
MIRROR = -np.arange(DIRECTIONS) % DIRECTIONS

# Spreads a ring kernel k to the matrix M[j, i] = k[(i - j) % DIRECTIONS], flat; as a matrix
# product, whose gradient is one, too.
_TURN = (np.arange(DIRECTIONS)[None, :] - np.arange(DIRECTIONS)[:, None]) % DIRECTIONS
_SPREAD = np.eye(DIRECTIONS, dtype=np.float32)[:, _TURN.reshape(-1)]


def initial_parameters(
    rng: np.random.Generator, *, networks: int, outputs: int, channels: int, blocks: int
) -> dict[str, npt.NDArray[np.float32]]:
    """Return random parameters.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of randomness.
    networks : int
        Networks side by side.
    outputs : int
        Values per direction.
    channels : int
        Channels per direction inside.
    blocks : int
        Number of blocks.
    """

    def normal(*shape: int, scale: float) -> npt.NDArray[np.float32]:
        return (scale * rng.standard_normal((networks, *shape))).astype(np.float32)

    parameters = {
        "view": normal(channels, VIEW_WIDTH, scale=math.sqrt(2.0 / VIEW_WIDTH)),
        "numbers": normal(channels, NUMBERS, scale=math.sqrt(1.0 / NUMBERS)),
        "bias": normal(channels, 1, scale=0.0),
    }
    for block in range(blocks):
        ring = normal(channels, DIRECTIONS, scale=0.5 / math.sqrt(DIRECTIONS))
        ring[..., 0] += 1.0
        parameters[f"ring{block}"] = ring
        parameters[f"mix{block}"] = normal(
            channels, channels, scale=math.sqrt(2.0 / channels / blocks)
        )
        parameters[f"bias{block}"] = normal(channels, 1, scale=0.0)
    parameters["output"] = normal(outputs, channels, scale=0.1 / math.sqrt(channels))
    parameters["output_bias"] = normal(outputs, 1, scale=0.0)
    return parameters


def forward(parameters: Parameters, view: Array, numbers: Array) -> Array:
    """Return the outputs of all networks, (networks, outputs, B, DIRECTIONS).

    Parameters
    ----------
    parameters : mapping of str to array
        As from `initial_parameters`.
    view, numbers
        See `Observation`.
    """
    xp = array_namespace(view)
    batch, directions, _ = view.shape
    networks, channels = parameters["view"].shape[:2]
    # Channels first, then searches and directions: every layer is one large matrix product.
    columns = xp.permute_dims(view, (2, 0, 1)).reshape((1, -1, batch * directions))
    row = xp.matmul(parameters["numbers"], numbers.T[None]) + parameters["bias"]
    hidden = xp.matmul(parameters["view"], columns).reshape((networks, channels, batch, directions))
    hidden = _relu(xp, hidden + row[..., None]).reshape((networks, channels, -1))
    for block in range(sum(name.startswith("ring") for name in parameters)):
        ring = _matrices(parameters[f"ring{block}"])
        turned = xp.matmul(hidden.reshape((networks, channels, batch, directions)), ring).reshape(
            (networks, channels, -1)
        )
        mixed = _affine(xp, parameters[f"mix{block}"], turned, parameters[f"bias{block}"])
        hidden = hidden + _relu(xp, mixed)
    output = _affine(xp, parameters["output"], hidden, parameters["output_bias"])
    return output.reshape((networks, -1, batch, directions))


def _matrices(ring: Array) -> Array:
    """Return ring kernels, (networks, channels, DIRECTIONS), as matrices."""
    xp = array_namespace(ring)
    spread = xp.asarray(_SPREAD, device=device(ring))
    return xp.matmul(ring, spread).reshape((*ring.shape, DIRECTIONS))


# PyTorch's own functions spare passes over memory, and with them a tenth of an update's time.


def _affine(xp: Any, weights: Array, x: Array, bias: Array) -> Array:
    return weights @ x + bias if isinstance(x, np.ndarray) else xp.baddbmm(bias, weights, x)


def _relu(xp: Any, x: Array) -> Array:
    """Return what of x is positive; x is lost."""
    return np.maximum(x, 0.0) if isinstance(x, np.ndarray) else xp.relu_(x)
