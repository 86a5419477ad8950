"""One row of the benchmark."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class BenchRow:
    """A measured figure, beside that of a peer where there is one.

    Parameters
    ----------
    name : str
        Name of the row that others rely on.
    unit : str
        Unit of `ours` and `peer`.
    ours : float
        What this library takes or reaches.
    peer : float, optional
        The same for the peer, measured in the same run.
    peer_name : str, optional
        Name and version of the peer.
    ratio : float, optional
        Above 1 where ours is better.
    details : dict
        Whatever else was measured.
    """

    name: str
    unit: str
    ours: float
    peer: float | None = None
    peer_name: str | None = None
    ratio: float | None = None
    details: dict[str, Any] = field(default_factory=dict)
