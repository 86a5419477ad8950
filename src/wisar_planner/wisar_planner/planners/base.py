"""What a planner is, and how it declares its options."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol

from wisar_planner.errors import InvalidInput
from wisar_planner.search.path import SearchPath
from wisar_planner.search.problem import SearchProblem


@dataclass(frozen=True)
class PlanProgress:
    """How far a running plan is.

    Parameters
    ----------
    elapsed_s : float
        Seconds since the plan was asked for.
    efficiency : float
        Probability efficiency e_p of the best path so far, from 0 to 1; an estimate until the
        plan is returned.
    fraction : float
        Share of the work that is done, from 0 to 1.
    """

    elapsed_s: float
    efficiency: float
    fraction: float


OnProgress = Callable[[PlanProgress], None]
ShouldStop = Callable[[], bool]


class Planner(Protocol):
    """Turns a search problem into a path."""

    @property
    def name(self) -> str:
        """The planner's name in the registry."""

    def plan(
        self,
        problem: SearchProblem,
        *,
        on_progress: OnProgress | None = None,
        should_stop: ShouldStop | None = None,
    ) -> SearchPath:
        """Return a path for `problem`, never longer than its `max_distance`.

        Parameters
        ----------
        problem : SearchProblem
            What to search, from where, and with what.
        on_progress : callable, optional
            Called now and then from the planning thread with the best so far; not after `plan`
            has returned.
        should_stop : callable, optional
            Asked now and then; once it says True, `plan` returns its best path so far.
        """


@dataclass(frozen=True)
class Option:
    """One option of a planner, as a command line or a ROS parameter needs to know it.

    Parameters
    ----------
    name : str
        Name of the option and of the planner's field.
    type : type
        bool, int, float or str.
    default : bool, int, float or str
        Value unless given.
    help : str
        What it means, with its unit.
    minimum, maximum : float or None
        Allowed range, ends included; None leaves that side open.
    """

    name: str
    type: type
    default: Any
    help: str
    minimum: float | None = None
    maximum: float | None = None

    def checked(self, value: Any) -> Any:
        """Return `value` in the option's type.

        Raises
        ------
        InvalidInput
            When it has another type, is not finite, or lies outside the range.
        """
        if self.type is bool:
            if not isinstance(value, bool):
                raise InvalidInput(f"{self.name} must be true or false, not {value!r}")
            return value
        if self.type is str:
            if not (isinstance(value, str) and value):
                raise InvalidInput(f"{self.name} must be a text that is not empty, not {value!r}")
            return value
        try:
            number = self.type(value)
            same = not isinstance(value, bool | str) and number == value
        except (TypeError, ValueError, OverflowError):
            same = False
        if not same or not math.isfinite(number):
            kind = "a whole number" if self.type is int else "a finite number"
            raise InvalidInput(f"{self.name} must be {kind}, not {value!r}")
        if self.minimum is not None and number < self.minimum:
            raise InvalidInput(f"{self.name} must be at least {self.minimum:g}, not {number:g}")
        if self.maximum is not None and number > self.maximum:
            raise InvalidInput(f"{self.name} must be at most {self.maximum:g}, not {number:g}")
        return number


def option(
    default: bool | int | float | str,
    help_text: str,
    *,
    minimum: float | None = None,
    maximum: float | None = None,
) -> Any:
    """Declare a field of a planner as an option; see `Option`."""
    return dataclasses.field(
        default=default, metadata={"help": help_text, "minimum": minimum, "maximum": maximum}
    )


@dataclass(frozen=True)
class OptionedPlanner:
    """Base of planners: a frozen dataclass whose fields are its options, checked when made."""

    name: ClassVar[str]

    def __post_init__(self) -> None:
        for name, each in self.options().items():
            object.__setattr__(self, name, each.checked(getattr(self, name)))

    @classmethod
    def options(cls) -> dict[str, Option]:
        """Return the options by name, in the order of their declaration."""
        return {
            field.name: Option(field.name, type(field.default), field.default, **field.metadata)
            for field in dataclasses.fields(cls)
        }
