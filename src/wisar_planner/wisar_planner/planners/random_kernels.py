"""A small random generator for compiled kernels, with its state in an array."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from numba import njit

StateArray = npt.NDArray[np.uint64]


def random_state(rng: np.random.Generator) -> StateArray:
    """Return a state drawn from a generator, (1,) uint64, never zero."""
    return rng.integers(1, 1 << 63, size=1, dtype=np.uint64)


@njit(cache=True, nogil=True, inline="always")
def uniform(state: StateArray) -> float:
    """Return the next number from [0, 1) (xorshift64, Marsaglia 2003)."""
    x = state[0]
    x ^= x << np.uint64(13)
    x ^= x >> np.uint64(7)
    x ^= x << np.uint64(17)
    state[0] = x
    return float(x >> np.uint64(11)) * 2.0**-53
