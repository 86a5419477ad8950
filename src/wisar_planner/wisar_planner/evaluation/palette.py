"""One look per planner in every figure: a colour that colour-blind readers tell apart, and a dash.

Colours after Okabe and Ito (2008), "Color universal design", and Tol's muted scheme; families
share a dash, so that the lines stay apart in grey print too.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Look:
    """How a planner is drawn.

    Attributes
    ----------
    colour : str
        Hexadecimal RGB.
    dash : str or tuple
        Matplotlib line style.
    """

    colour: str
    dash: str | tuple[float, tuple[float, ...]] = "-"


_LOOKS: Mapping[str, Look] = {
    "lawnmower": Look("#555555", (0, (1, 1))),
    "lhc_gw_conv": Look("#009E73", (0, (5, 1.5, 1, 1.5))),
    "greedy": Look("#56B4E9", (0, (5, 1.5))),
    "lookahead": Look("#0072B2"),
    "expanding_square": Look("#CC79A7", (0, (3, 1))),
    "sector": Look("#882255", (0, (3, 1, 1, 1))),
    "creeping_line": Look("#999933", (0, (1, 2))),
    "sac": Look("#E69F00"),
    "sac_search": Look("#D55E00"),
}
_OTHERS = (Look("#332288", "--"), Look("#117733", "-."), Look("#AA4499", ":"), Look("#661100"))

BOUND_COLOUR = "#8C8C8C"


def looks(names: list[str]) -> dict[str, Look]:
    """Return a look for each planner; planners that are not known here share the spare ones."""
    unknown = [name for name in names if name not in _LOOKS]
    spare = {name: _OTHERS[i % len(_OTHERS)] for i, name in enumerate(unknown)}
    return {name: _LOOKS.get(name) or spare[name] for name in names}
