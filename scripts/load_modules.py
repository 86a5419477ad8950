"""Import every module of some packages once: ``python scripts/load_modules.py PACKAGE ...``.

Python then keeps the bytecode of all that they import. Otherwise, where Python is told to write
none, as in many containers, every node compiles a thousand modules again at each start, which takes
longer than all else that it does then.
"""

from __future__ import annotations

import contextlib
import importlib
import pkgutil
import sys


def main(names: list[str]) -> None:
    """Import the packages and all modules in them, but for those whose libraries are missing."""
    sys.dont_write_bytecode = False
    for name in names:
        package = importlib.import_module(name)
        for module in pkgutil.walk_packages(package.__path__, f"{name}."):
            if not module.name.endswith("__main__"):
                # Training and the benchmark's peers may not be installed.
                with contextlib.suppress(ImportError):
                    importlib.import_module(module.name)


if __name__ == "__main__":
    main(sys.argv[1:])
