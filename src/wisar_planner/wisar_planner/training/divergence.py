"""Trainings that have gone astray: their numbers are no numbers any more."""

from __future__ import annotations

import torch
from torch import Tensor

from wisar_planner.errors import InvalidInput


class Diverged(InvalidInput):
    """A training whose policy or losses are no longer finite."""


def check_finite(what: str, values: Tensor) -> None:
    """Raise Diverged where a value is not finite.

    Parameters
    ----------
    what : str
        What the values are, a plural.
    values : Tensor
        The values.
    """
    if not bool(torch.isfinite(values).all()):
        raise Diverged(
            f"the training diverged, {what} are not finite: lower its learning rates, the fields "
            "of the configuration that end in `rate`"
        )
