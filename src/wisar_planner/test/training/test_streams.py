"""Training and validation never draw the same maps."""

import pytest
import torch

from wisar_planner.errors import InvalidInput
from wisar_planner.training.streams import (
    check_seed,
    fresh_generator,
    training_generator,
    validation_generator,
)

CPU = torch.device("cpu")


@pytest.mark.parametrize("seed", [0, 1, 2**31 - 1])
def test_training_validation_and_fresh_maps_have_streams_of_their_own(seed) -> None:
    generators = training_generator(seed, CPU), validation_generator(CPU), fresh_generator(CPU)
    draws = [torch.rand(64, generator=generator) for generator in generators]
    assert len(torch.cat(draws).unique()) == 3 * 64


@pytest.mark.parametrize("make", [validation_generator, fresh_generator])
def test_maps_to_judge_on_are_the_same_each_time(make) -> None:
    first, again = (torch.rand(8, generator=make(CPU)) for _ in range(2))
    assert torch.equal(first, again)


@pytest.mark.parametrize("seed", [-1, 2**31, 2**31 + 1, 2**32, 2**40])
def test_seeds_that_wrap_around_are_refused(seed) -> None:
    """A CPU generator keeps 32 bits of a seed: 2^40 would give the stream of 0."""
    with pytest.raises(InvalidInput, match="seed must be at least 0 and below"):
        check_seed(seed)
