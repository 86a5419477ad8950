"""Work in as many processes as PyTorch has threads."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Any

import joblib
import torch


def in_processes(function: Callable[..., Any], tasks: Iterable[tuple[Any, ...]]) -> Iterator[Any]:
    """Yield what a function returns for each tuple of arguments, in their order."""
    parallel = joblib.Parallel(n_jobs=torch.get_num_threads(), return_as="generator")
    yield from parallel(joblib.delayed(function)(*task) for task in tasks)
