"""Ring networks that learn, what they say, and how they learn."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from wisar_planner.policy import heading
from wisar_planner.policy.heading import value_at, wrapped
from wisar_planner.policy.network import MIRROR, forward, initial_parameters
from wisar_planner.policy.observation import Observation

Networks = dict[str, Tensor]
#: From what searches show to their turns in units of pi.
Policy = Callable[[Observation], Tensor]

# Values are tens of steps over the most probable ground, outputs of networks are near one.
_VALUE_SCALE = 10.0
# Deviation of what is added to the copies of channels, in those of the weights.
_SPLIT = 0.01
# Turns that may replace the policy's own, as deviations to either side, degrees.
_FAN = (8.0, 14.0, 20.0, 27.0, 35.0, 45.0, 60.0, 90.0)


def make_networks(
    rng: np.random.Generator,
    *,
    networks: int,
    channels: int,
    blocks: int,
    device: torch.device,
    outputs: int = 1,
) -> Networks:
    """Return random networks side by side; see `initial_parameters`."""
    made = initial_parameters(
        rng, networks=networks, outputs=outputs, channels=channels, blocks=blocks
    )
    return {k: torch.tensor(v, device=device, requires_grad=True) for k, v in made.items()}


def widened(
    weights: Mapping[str, npt.NDArray[np.float32]], channels: int, rng: np.random.Generator
) -> dict[str, npt.NDArray[np.float32]]:
    """Return ring networks that say about the same as others and have more channels to learn with.

    Channels are copied, and what reads them is shared out among the copies (Chen et al. 2016,
    "Net2Net", section 2.2). A little noise makes the copies learn different things: Adam would take
    the same steps for all.

    Parameters
    ----------
    weights : mapping of str to float32 arrays
        See `network.forward`.
    channels : int
        Channels wanted, at least as many as there are.
    rng : numpy.random.Generator
        Source of randomness.
    """
    before = weights["view"].shape[1]
    if channels == before:
        return dict(weights)
    source = np.arange(channels) % before
    # Unequal shares, so that copies differ from the beginning.
    drawn = rng.uniform(0.5, 1.5, channels)
    share = (drawn / np.bincount(source, drawn)[source]).astype(np.float32)
    wider = {}
    for name, value in weights.items():
        wide = value if name.startswith("output") else value[:, source]
        if name.startswith("mix") or name == "output":
            wide = wide[:, :, source] * share
        if "bias" not in name:
            wide = wide + _SPLIT * value.std() * rng.standard_normal(wide.shape)
        wider[name] = wide.astype(np.float32)
    return wider


def likeliest_turn(actor: Mapping[str, Tensor], distribution: str, shown: Observation) -> Tensor:
    """Return the turns, (B,), of a policy as planners fly them; see `heading.likeliest_turn`."""
    result: Tensor = heading.likeliest_turn(forward(actor, *shown)[0], distribution)
    return result


def state_value(value: Mapping[str, Tensor], shown: Observation) -> Tensor:
    """Return what the policy will gain from here on, (B,), in steps over the reference density."""
    result: Tensor = _VALUE_SCALE * forward(value, *shown)[0, 0].mean(dim=-1)
    return result


def corrected_turn(
    own: Tensor, critics: Mapping[str, Tensor], shown: Observation, margin: float
) -> Tensor:
    """Return a policy's own turns, (B,), or others that the critics' mean prefers by `margin`.

    Only turns some way off the policy's own are compared: nearby ones differ by chance.
    """
    values = mean_value(critics, shown)
    fan = torch.tensor([0.0, *(s * f for f in _FAN for s in (1.0, -1.0))], device=own.device)
    turns = wrapped(own[:, None] + fan / 180.0)
    advantage = value_at(values, turns)
    advantage = advantage - advantage[:, :1]
    best, which = advantage.max(dim=1)
    other = turns.gather(1, which[:, None])[:, 0]
    return torch.where(best > margin, other, own)


def mean_value(critics: Mapping[str, Tensor], shown: Observation) -> Tensor:
    """Return the critics' mean value of each direction, (B, DIRECTIONS).

    They are asked about the mirror image, too: what is best to the left is best to the right there.
    """
    order = torch.as_tensor(MIRROR, device=shown.view.device)
    both = torch.cat([shown.view, shown.view[:, order]])
    values = forward(critics, both, shown.numbers.repeat(2, 1))
    straight, mirror = values[:, 0].mean(dim=0).chunk(2)
    return 0.5 * (straight + mirror[:, order])


def mirrored(view: Tensor, turns: Tensor, which: Tensor) -> tuple[Tensor, Tensor]:
    """Mirror the views and turns of some searches, given by a mask, left to right."""
    order = torch.as_tensor(MIRROR, device=view.device)
    flipped = torch.where(which[:, None, None], view[:, order], view)
    sign = torch.where(which, -1.0, 1.0).reshape(-1, *(1,) * (turns.dim() - 1))
    return flipped, sign * turns


def optimizer_of(networks: Networks, rate: float) -> torch.optim.Optimizer:
    """Return Adam for networks."""
    return torch.optim.Adam(networks.values(), lr=rate, fused=True)


def learn(optimizer: torch.optim.Optimizer, loss: Tensor, rate: float, done: float) -> None:
    """Make one update; the rate falls linearly to 3% as the share done goes to 1."""
    optimizer.param_groups[0]["lr"] = rate * max(1.0 - done, 0.03)
    optimizer.zero_grad(set_to_none=True)
    loss.backward()  # type: ignore[no-untyped-call]
    optimizer.step()
