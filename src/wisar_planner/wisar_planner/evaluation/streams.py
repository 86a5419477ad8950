"""Random streams of evaluations that never overlap, one per run and facet.

Map `i` of seed `S` depends on `(S, i)` alone: not on how many runs there are, on
which worker makes it, or on what was drawn before. This is what spawn keys of
`numpy.random.SeedSequence` are for; a key here is ``(0, index, facet)``.

Training and validation draw from PyTorch's generators (`training.streams`), so a policy is never
judged on a map that it was trained on or selected with, whatever the seeds.
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np

from wisar_planner.errors import InvalidInput

# First number of every key; like the values below part of every published number: never change.
_EVALUATION = 0


class Facet(IntEnum):
    """Which draw of a run, so that one more draw of one kind leaves the others as they are."""

    MAP = 0
    START = 1
    PERSONS = 2


def stream(seed: int, index: int, facet: Facet) -> np.random.Generator:
    """Return the generator for one draw of one run.

    Parameters
    ----------
    seed
        The user's seed, not negative.
    index
        Number of the run, from 0.
    facet
        Which draw of the run.

    Raises
    ------
    InvalidInput
        If `seed` or `index` is negative.
    """
    if seed < 0:
        raise InvalidInput(f"seed: {seed} is negative; use 0 or a positive integer")
    if index < 0:
        raise InvalidInput(f"index: {index} is negative; runs count from 0")
    key = (_EVALUATION, index, int(facet))
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))
