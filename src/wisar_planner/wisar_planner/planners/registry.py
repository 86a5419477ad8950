"""Planners by name."""

from __future__ import annotations

import difflib
from importlib import import_module
from typing import Any, cast

from wisar_planner.errors import InvalidInput
from wisar_planner.planners.base import Option, OptionedPlanner, Planner

# Module and class of each planner; a module is imported when its planner is first asked for.
_HOMES = {
    "lawnmower": ("lawnmower", "Lawnmower"),
    "lhc_gw_conv": ("lhc_gw_conv", "LhcGwConv"),
    "expanding_square": ("expanding_square", "ExpandingSquare"),
    "sector": ("sector", "Sector"),
    "creeping_line": ("creeping_line", "CreepingLine"),
    "greedy": ("greedy", "Greedy"),
    "lookahead": ("lookahead", "Lookahead"),
    "sac": ("sac", "SacPolicy"),
    "sac_search": ("sac_search", "SacSearch"),
}


def planner_names() -> tuple[str, ...]:
    """Return the names of all planners."""
    return tuple(_HOMES)


def planner_options(name: str) -> dict[str, Option]:
    """Return the options of a planner by their names.

    Raises
    ------
    InvalidInput
        When no planner has that name.
    """
    return _planner_class(name).options()


def make_planner(name: str, **options: Any) -> Planner:
    """Return the planner of that name.

    Parameters
    ----------
    name : str
        One of `planner_names`.
    **options
        Options of that planner, see `planner_options`.

    Raises
    ------
    InvalidInput
        When no planner has that name, it has no such option, or an option's value cannot be
        right.
    """
    planner_class = _planner_class(name)
    known = planner_class.options()
    for given in options:
        if given not in known:
            listed = f"its options are {', '.join(known)}" if known else "it has none"
            raise InvalidInput(
                f"planner {name} has no option {given}{_hint(given, known)}; {listed}"
            )
    return cast(Planner, planner_class(**options))


def _planner_class(name: str) -> type[OptionedPlanner]:
    if name not in _HOMES:
        raise InvalidInput(
            f"no planner is called {name!r}{_hint(name, _HOMES)}; "
            f"the planners are {', '.join(_HOMES)}"
        )
    module, class_name = _HOMES[name]
    return cast(
        type[OptionedPlanner],
        getattr(import_module(f"wisar_planner.planners.{module}"), class_name),
    )


def _hint(name: str, known: Any) -> str:
    close = difflib.get_close_matches(str(name), known, n=1)
    return f" (did you mean {close[0]}?)" if close else ""
