"""What the commands around training need: PyTorch, and a device that is there."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import torch


def require(what: str, *modules: str) -> None:
    """Raise InvalidInput where a module is not installed.

    Parameters
    ----------
    what : str
        Beginning of the sentence: who needs it.
    *modules : str
        The modules to import.
    """
    try:
        for module in modules:
            import_module(module)
    except ImportError:
        # Not at the top: NumPy comes with it, and `wisar --help` imports this module.
        from wisar_planner.errors import InvalidInput

        raise InvalidInput(
            f"{what}, which planning does not: run `make train-setup` first"
        ) from None


def checked_device(name: str) -> torch.device:
    """Return the device of `--device`; raise InvalidInput where this machine has none such."""
    import torch

    from wisar_planner.errors import InvalidInput

    try:
        device = torch.device(name)
        torch.zeros(1, device=device)
    except (RuntimeError, AssertionError) as error:
        reason = str(error).splitlines()[0]
        raise InvalidInput(f"--device {name} is not to be had here: {reason}") from None
    return device
