"""How every YAML file is read."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import yaml

from wisar_planner.errors import InvalidInput


class _Loader(yaml.SafeLoader):
    """Reads as numbers what YAML 1.2 takes for floats.

    PyYAML follows YAML 1.1, to which 1e4 and -.5 are words: it wants 1.0e+4 and -0.5.
    """


_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(r"[-+]?(?:(?:\.[0-9]+|[0-9]+\.[0-9]*)(?:[eE][-+]?[0-9]+)?|[0-9]+[eE][-+]?[0-9]+)\Z"),
    list("-+.0123456789"),
)


def read_yaml(path: Path) -> Any:
    """Return what a YAML file holds, plain values alone.

    Parameters
    ----------
    path : Path
        The file.

    Raises
    ------
    InvalidInput
        If it is not YAML.
    OSError
        If it cannot be read.
    """
    try:
        return yaml.load(path.read_text(encoding="utf-8"), _Loader)
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise InvalidInput(f"{path}: this is not YAML ({' '.join(str(error).split())})") from None
