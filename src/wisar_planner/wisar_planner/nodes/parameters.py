"""Declaring parameters with their meaning and range, and reading them."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.node import Node
from rclpy.parameter import Parameter

from wisar_planner.errors import InvalidInput

_LARGEST_INTEGER = 2**31 - 1
_LARGEST_NUMBER = 1e9
"""Bounds of parameters without limits of their own: they keep infinity and NaN out."""


def declare(
    node: Node,
    name: str,
    default: bool | int | float | str,
    description: str,
    *,
    minimum: float | None = None,
    maximum: float | None = None,
    choices: Sequence[str] = (),
    read_only: bool = False,
) -> Any:
    """Declare a parameter and return its value; what is outside its range is refused from then on.

    Parameters
    ----------
    node : Node
        Its owner.
    name, default, description
        The parameter; `description` gives meaning and unit.
    minimum, maximum : float, optional
        Allowed range of a number, ends included.
    choices : sequence of str, optional
        Allowed values of a text.
    read_only : bool
        Whether it can be set only when the node starts.

    Raises
    ------
    InvalidInput
        When the value given at the start is none of the choices.
    """
    descriptor = ParameterDescriptor(description=description, read_only=read_only)
    if type(default) is int:
        descriptor.integer_range = [
            IntegerRange(
                from_value=int(-_LARGEST_INTEGER if minimum is None else minimum),
                to_value=int(_LARGEST_INTEGER if maximum is None else maximum),
                step=1,
            )
        ]
    elif isinstance(default, float):
        descriptor.floating_point_range = [
            FloatingPointRange(
                from_value=float(-_LARGEST_NUMBER if minimum is None else minimum),
                to_value=float(_LARGEST_NUMBER if maximum is None else maximum),
            )
        ]
    elif choices:
        descriptor.additional_constraints = f"one of {', '.join(choices)}"
    value = node.declare_parameter(name, default, descriptor).value
    if choices:

        def check(given: Any) -> None:
            if given not in choices:
                raise InvalidInput(f"{name} must be one of {', '.join(choices)}, not {given!r}")

        check(value)
        check_changes(node, name, check)
    return value


def check_changes(node: Node, name: str, check: Callable[[Any], object]) -> None:
    """Refuse changes of a parameter for which `check` raises InvalidInput."""

    def on_set(changed: list[Parameter]) -> SetParametersResult:
        try:
            for parameter in changed:
                if parameter.name == name:
                    check(parameter.value)
        except InvalidInput as error:
            node.get_logger().warning(f"parameter refused, the old value stays: {error}")
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    node.add_on_set_parameters_callback(on_set)


def declare_point(node: Node, name: str, description: str) -> None:
    """Declare a parameter of two numbers that may stay unset.

    Raises
    ------
    InvalidInput
        When the value given at the start is not two finite numbers.
    """
    descriptor = ParameterDescriptor(
        description=description, additional_constraints="two finite numbers, or none"
    )
    node.declare_parameter(name, Parameter.Type.DOUBLE_ARRAY, descriptor)
    point(node, name)
    check_changes(node, name, lambda value: checked_point(name, value))


def point(node: Node, name: str) -> tuple[float, float] | None:
    """Return a parameter of `declare_point`, None where it is unset or empty.

    Raises
    ------
    InvalidInput
        When it does not have two finite values.
    """
    value = node.get_parameter_or(name, None)
    return None if value is None else checked_point(name, value.value)


def checked_point(name: str, value: Any) -> tuple[float, float] | None:
    """Return two finite numbers, None for an empty or unset value.

    Raises
    ------
    InvalidInput
        When there are not two values, or one is not finite.
    """
    if value is None or len(value) == 0:
        return None
    numbers = [float(v) for v in value]
    if len(numbers) != 2 or not all(map(math.isfinite, numbers)):
        raise InvalidInput(f"{name} must be two finite numbers, not {numbers}")
    return numbers[0], numbers[1]
