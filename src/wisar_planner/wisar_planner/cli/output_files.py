"""The files that a command writes: checked before the work, written one by one after it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path


def check_names(
    inputs: Mapping[str, Path], outputs: Iterable[tuple[str, Path, tuple[str, ...]]]
) -> None:
    """Find out about hopeless file names before anything is read; touches nothing.

    Parameters
    ----------
    inputs : mapping of str to Path
        What is read, by its name for the message.
    outputs : iterable of (option, path, suffixes)
        What is to be written, by which option, and the suffixes that it may have; none for any.

    Raises
    ------
    InvalidInput
        If an output has another suffix, is a folder, or is the same file as an input or as
        another output.
    """
    from wisar_planner.errors import InvalidInput

    taken = {_identity(path): name for name, path in inputs.items()}
    for option, path, suffixes in outputs:
        if suffixes and path.suffix.lower() not in suffixes:
            raise InvalidInput(f"{option}: {path} must end in one of {' '.join(suffixes)}")
        if path.is_dir():
            raise InvalidInput(f"{option}: {path} is a folder; give the name of a file")
        identity = _identity(path)
        if identity in taken:
            raise InvalidInput(
                f"{option}: {path} is the same file as {taken[identity]}; choose another name"
            )
        taken[identity] = f"{option} {path}"


def make_places(paths: Iterable[tuple[str, Path]]) -> None:
    """Make the folders of files to be written, and see that the files can be.

    Parameters
    ----------
    paths : iterable of (option, path)
        The files and the options that named them.

    Raises
    ------
    InvalidInput
        If a folder cannot be made or a file in it not be written.
    """
    from wisar_planner.errors import InvalidInput

    for option, path in paths:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            _try_to_open(path)
        except OSError as error:
            raise InvalidInput(
                f"{option}: {path} cannot be written ({error.strerror}); choose another place"
            ) from None


def write_each(writers: Iterable[tuple[Path, Callable[[Path], None]]]) -> tuple[list[Path], str]:
    """Write every file that can be written; a bad one does not cost the others.

    Parameters
    ----------
    writers : iterable of (path, write)
        The files, and what writes each.

    Returns
    -------
    written : list of Path
        The files that are whole.
    failures : str
        Which are not, and why; empty if all are.
    """
    written, failures = [], []
    for path, write in writers:
        try:
            write(path)
        except (OSError, ValueError) as error:
            reason = getattr(error, "strerror", None) or str(error)
            failures.append(f"{path} was not written ({reason})")
        else:
            written.append(path)
    return written, "; ".join(failures)


def _identity(path: Path) -> tuple[int, int] | Path:
    """Return what is equal for all names of a file: links lead to the same one."""
    try:
        status = path.stat()
    except OSError:
        return path.resolve()
    return status.st_dev, status.st_ino


def _try_to_open(path: Path) -> None:
    """Open a file for writing and leave everything as it was."""
    if path.is_file():
        path.open("r+b").close()
    elif not path.exists():
        path.open("xb").close()
        path.unlink()
    # A device or a pipe is left alone: to open it may wait, or be noticed at its other end.
