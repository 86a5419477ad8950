"""Training configurations, one YAML file per run: how they are read and checked."""

from __future__ import annotations

import dataclasses
import math
import re
import typing
from pathlib import Path
from typing import Any

from wisar_planner.errors import InvalidInput
from wisar_planner.yaml_files import read_yaml


def read_fields(path: Path) -> dict[str, Any]:
    """Return the fields in a YAML file.

    Raises
    ------
    InvalidInput
        When the file is not YAML or no mapping.
    """
    content = read_yaml(path)
    if not isinstance(content, dict):
        raise InvalidInput(f"{path} must be a mapping of fields, see config/sac.yaml")
    return content


def build(kind: type[Any], content: dict[str, Any], where: str) -> Any:
    """Make a dataclass of plain values, which must have the types of its fields."""
    types = typing.get_type_hints(kind)
    known = {each.name: each for each in dataclasses.fields(kind)}
    values = {}
    for name, value in content.items():
        if name not in known:
            raise InvalidInput(f"{where}: unknown field {name}; the fields are {', '.join(known)}")
        values[name] = _value(types[name], value, f"{where}: {name}")
    try:
        return kind(**values)
    except InvalidInput as error:
        raise InvalidInput(f"{where}: {error}") from None


def _value(kind: Any, value: Any, where: str) -> Any:
    if dataclasses.is_dataclass(kind):
        if not isinstance(value, dict):
            raise InvalidInput(f"{where} must be a mapping, not {value!r}")
        return build(typing.cast(type[Any], kind), value, where)
    if typing.get_origin(kind) is tuple:
        kinds = typing.get_args(kind)
        if not isinstance(value, list | tuple):
            raise InvalidInput(f"{where} must be a list, not {value!r}")
        if kinds[-1] is Ellipsis:
            kinds = (kinds[0],) * len(value)
        if len(value) != len(kinds):
            raise InvalidInput(f"{where} must be a list of {len(kinds)} numbers, not {value!r}")
        return tuple(_value(k, v, where) for k, v in zip(kinds, value, strict=True))
    if kind is float and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    if not isinstance(value, kind) or (kind is int and isinstance(value, bool)):
        raise InvalidInput(f"{where} must be of type {kind.__name__}, not {value!r}")
    return value


# What dataclasses of settings check of themselves.


def rounds(count: int, size: int) -> int:
    """Return how many rounds of a size it takes to reach a count."""
    return -(-count // size)


def check_name(name: str) -> None:
    """Raise InvalidInput where a run's folder cannot hold a model of that name."""
    if not re.fullmatch(r"[\w-][\w.-]*", name) or name.lower() == "checkpoint":
        raise InvalidInput(
            f"name must be made of letters, digits, '.', '_' and '-', begin with no '.' and not be "
            f"checkpoint, not {name!r}"
        )


def check_at_least(settings: object, **limits: float) -> None:
    """Raise InvalidInput where a field is under its limit or no number."""
    for name, least in limits.items():
        if not (value := getattr(settings, name)) >= least:
            raise InvalidInput(f"{name} must be at least {least}, not {value}")


def check_positive(settings: object, *names: str) -> None:
    """Raise InvalidInput where a field is not above 0 and finite."""
    for name in names:
        if not 0.0 < (value := getattr(settings, name)) < math.inf:
            raise InvalidInput(f"{name} must be above 0 and finite, not {value}")


def check_share(settings: object, *names: str) -> None:
    """Raise InvalidInput where a field is not from 0 to 1."""
    for name in names:
        if not 0.0 <= (value := getattr(settings, name)) <= 1.0:
            raise InvalidInput(f"{name} must be from 0 to 1, not {value}")


def check_positive_share(settings: object, *names: str) -> None:
    """Raise InvalidInput where a field is not over 0 and at most 1."""
    for name in names:
        if not 0.0 < (value := getattr(settings, name)) <= 1.0:
            raise InvalidInput(f"{name} must be over 0 and at most 1, not {value}")


def check_all_finite(settings: object, *names: str) -> None:
    """Raise InvalidInput where a field has a number that is not finite."""
    for name in names:
        if not all(map(math.isfinite, value := getattr(settings, name))):
            raise InvalidInput(f"{name} must be finite, not {value}")


def check_algorithm(found: str, expected: str) -> None:
    """Raise InvalidInput where a configuration is for another algorithm."""
    if found != expected:
        raise InvalidInput(f"algorithm must be {expected}, not {found!r}")
