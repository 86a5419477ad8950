"""Entry point of the `wisar` command.

Every module of this package with an ``add_parser(subparsers)`` is a subcommand. It adds its
parser, sets ``func(args) -> int`` as a default and imports what it needs inside ``func``, so that
``wisar --help`` answers at once.
"""

from __future__ import annotations

import argparse
import os
import pkgutil
import sys
from collections.abc import Sequence
from importlib import import_module
from typing import Any, NoReturn

from wisar_planner import cli

_DESCRIPTION = """\
Search-and-rescue path planning: from a map of where a missing person may be to a flight path that
sees the most probability soonest."""

_EXAMPLES = """\
examples:
  wisar plan map.tif --start 56.117,-3.937 --budget 10000 --swath-radius 33 --step 64 \\
      --planner sac_search --out plan.geojson
                                       plan 10 km over a probability map from a GIS
  wisar evaluate --planner lawnmower,greedy --runs 100 --figures out/figures
                                       compare planners on the paper's setup
  wisar bench --only search            measure the speed of this installation

`wisar COMMAND --help` explains a command with more examples."""

#: Exit status after a user's mistake, as argparse has it, and after Ctrl-C, as shells have it.
_EXIT_MISTAKE = 2
_EXIT_INTERRUPTED = 130


def main(argv: Sequence[str] | None = None) -> int:
    """Run the `wisar` command.

    Parameters
    ----------
    argv : sequence of str, optional
        Arguments after the program's name; those of the process unless given.

    Returns
    -------
    int
        Exit status: 0 when all went well, 2 after a user's mistake (one line on standard error
        says which), 130 after Ctrl-C.
    """
    args = build_parser().parse_args(argv)
    try:
        status: int = args.func(args)
        sys.stdout.flush()
        return status
    except KeyboardInterrupt:
        print("wisar: stopped", file=sys.stderr)
        return _EXIT_INTERRUPTED
    except BrokenPipeError:
        # The reader, for example `head`, has had enough. Python would complain at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except OSError as error:
        what = f"{error.filename}: {error.strerror}" if error.filename else str(error)
        return _mistake(what)
    except ValueError as error:
        from wisar_planner.errors import InvalidInput

        if not isinstance(error, InvalidInput):
            raise
        return _mistake(str(error))


def build_parser() -> argparse.ArgumentParser:
    """Return the parser of the command with all subcommands."""
    parser = _Parser(
        prog="wisar",
        description=_DESCRIPTION,
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action=_Version, nargs=0, help="show the version and exit")
    subparsers = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
    for module in sorted(pkgutil.iter_modules(cli.__path__), key=lambda found: found.name):
        if module.name in ("main", "__main__"):
            continue
        add_parser = getattr(import_module(f"{cli.__name__}.{module.name}"), "add_parser", None)
        if add_parser is not None:
            add_parser(subparsers)
    return parser


class _Parser(argparse.ArgumentParser):
    """A parser that says in one line what is wrong; `--help` has the rest."""

    def error(self, message: str) -> NoReturn:
        self.exit(_EXIT_MISTAKE, f"{self.prog}: {message} (see {self.prog} --help)\n")


class _Version(argparse.Action):
    """Prints the version; looks it up only when asked, since that takes its time."""

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> NoReturn:
        from importlib.metadata import PackageNotFoundError, version

        try:
            number = version("wisar_planner")
        except PackageNotFoundError:
            number = "from a source tree that is not installed"
        print(f"wisar {number}")
        parser.exit()


def _mistake(message: str) -> int:
    print("wisar: " + " ".join(message.split()), file=sys.stderr)
    return _EXIT_MISTAKE


if __name__ == "__main__":
    sys.exit(main())
