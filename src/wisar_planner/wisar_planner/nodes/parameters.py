"""Declaring parameters with their meaning and range, and reading them."""

from __future__ import annotations

import math
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.node import Node
from rclpy.parameter import Parameter

from wisar_planner.errors import InvalidInput

_LARGEST_INTEGER = 2**31 - 1


def declare(
    node: Node,
    name: str,
    default: bool | int | float | str,
    description: str,
    *,
    minimum: float | None = None,
    maximum: float | None = None,
    read_only: bool = False,
) -> Any:
    """Declare a parameter and return its value; rclpy refuses values outside the range.

    Parameters
    ----------
    node : Node
        Its owner.
    name, default, description
        The parameter; `description` gives meaning and unit.
    minimum, maximum : float, optional
        Allowed range, ends included.
    read_only : bool
        Whether it can be set only when the node starts.
    """
    descriptor = ParameterDescriptor(description=description, read_only=read_only)
    if minimum is not None or maximum is not None:
        if isinstance(default, int):
            descriptor.integer_range = [
                IntegerRange(
                    from_value=int(-_LARGEST_INTEGER if minimum is None else minimum),
                    to_value=int(_LARGEST_INTEGER if maximum is None else maximum),
                    step=1,
                )
            ]
        else:
            descriptor.floating_point_range = [
                FloatingPointRange(
                    from_value=-math.inf if minimum is None else float(minimum),
                    to_value=math.inf if maximum is None else float(maximum),
                )
            ]
    return node.declare_parameter(name, default, descriptor).value


def declare_point(node: Node, name: str, description: str) -> None:
    """Declare a parameter of two numbers that may stay unset."""
    descriptor = ParameterDescriptor(description=description)
    node.declare_parameter(name, Parameter.Type.DOUBLE_ARRAY, descriptor)


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
