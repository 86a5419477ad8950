"""Training and validation never draw the same maps."""

import pytest
import torch

from wisar_planner.errors import InvalidInput
from wisar_planner.training.streams import check_seed, training_generator, validation_generator

CPU = torch.device("cpu")


@pytest.mark.parametrize("seed", [0, 1, 2**31 - 1])
def test_no_training_has_the_stream_of_the_validation(seed) -> None:
    draws = [
        torch.rand(64, generator=generator)
        for generator in (training_generator(seed, CPU), validation_generator(CPU))
    ]
    assert not torch.isin(*draws).any()


def test_validation_is_the_same_each_time() -> None:
    first, again = (torch.rand(8, generator=validation_generator(CPU)) for _ in range(2))
    assert torch.equal(first, again)


@pytest.mark.parametrize("seed", [-1, 2**31, 2**31 + 1, 2**32, 2**40])
def test_seeds_that_wrap_around_are_refused(seed) -> None:
    """A CPU generator keeps 32 bits of a seed: 2^40 would give the stream of 0."""
    with pytest.raises(InvalidInput, match="seed must be at least 0 and below"):
        check_seed(seed)
