#!/usr/bin/env python3
"""Create what is missing of the environment and build the packages.

Standard library only: it runs before anything is installed. Every stage leaves
a stamp that holds the hash of what it was made from, so a stage runs again only
when that has changed; a second run takes a fraction of a second.

    stage         made from                             leaves
    environment   requirements*.txt, the Python version .venv/
    cmake paths   the ROS 2 wheels                      .venv/share/**/*.cmake, rewritten
    build         src/**, config/, models/              build/, install/
    bytecode      all that is installed                 __pycache__ of what is used
    kernels       the compiled kernels                  .cache/numba/

Where a ROS 2 Jazzy installation is sourced (ROS_DISTRO=jazzy and an
AMENT_PREFIX_PATH), it is used instead of the wheels.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import platform
import shutil
import subprocess
import sys
import sysconfig
import time
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
VENV = ROOT / ".venv"
PYTHON = VENV / "bin" / "python"
INSTALL = ROOT / "install"
LOGS = ROOT / "log"


class SetupError(Exception):
    """Something the person at the keyboard has to mend; the text says what."""


def main() -> int:
    """Run the stages; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--bench", action="store_true", help="also install training and the benchmark's peers"
    )
    parser.add_argument("--train", action="store_true", help="also install what training needs")
    arguments = parser.parse_args()
    try:
        check_machine()
        create_environment()
        if arguments.bench or arguments.train:
            install_extra("train", "PyTorch and what else training needs (5 GB)")
        if arguments.bench:
            install_extra("bench", "the benchmark's peers")
        remove_other_builds()
        build_python_packages()
        link_command("wisar")
        # Most of both runs on one core.
        with ThreadPoolExecutor() as pool:
            kernels = pool.submit(compile_kernels)
            build_messages()
            keep_bytecode()
            kernels.result()
    except SetupError as error:
        print(f"setup: {error}", file=sys.stderr)
        return 1
    except subprocess.CalledProcessError as error:
        print(f"setup: `{' '.join(map(str, error.cmd[:4]))} ...` failed", file=sys.stderr)
        return 1
    return 0


def ros_is_sourced() -> bool:
    """Whether a ROS 2 installation is in the environment.

    Wheels in a virtual environment are none: env.sh puts those of this checkout or another there.
    """
    prefixes = map(Path, filter(None, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)))
    marker = Path("share", "ament_index", "resource_index", "packages", "rcl_interfaces")
    if not any((p / marker).exists() and not (p / "pyvenv.cfg").exists() for p in prefixes):
        return False
    if (distribution := os.environ.get("ROS_DISTRO", "")) != "jazzy":
        raise SetupError(
            f"ROS 2 {distribution or 'of an unknown distribution'} is sourced, wisar needs Jazzy: "
            "open a shell without it, or source Jazzy's setup.bash"
        )
    return True


def check_machine() -> None:
    """Say in one line what this machine lacks."""
    version = ".".join(map(str, sys.version_info[:2]))
    if sys.implementation.name != "cpython" or not (3, 10) <= sys.version_info[:2] <= (3, 13):
        raise SetupError(
            f"Python {version} is not supported: run `make PYTHON=python3.12 ...` "
            "with CPython 3.10, 3.11, 3.12 or 3.13"
        )
    if not ros_is_sourced() and (sys.platform, platform.machine()) != ("linux", "x86_64"):
        raise SetupError(
            f"the ROS 2 wheels exist for Linux on x86-64 only, this is {sys.platform} on "
            f"{platform.machine()}: install ROS 2 Jazzy and source its setup.bash first"
        )
    if not any(shutil.which(name) for name in (os.environ.get("CXX") or "c++", "g++", "clang++")):
        raise SetupError("no C++ compiler found: install one (Debian, Ubuntu: apt install g++)")
    try:
        import ensurepip  # noqa: F401
        import venv  # noqa: F401
    except ImportError:
        raise SetupError(
            f"Python {version} lacks venv: install it (Debian, Ubuntu: "
            f"apt install python{version}-venv)"
        ) from None
    header = Path(sysconfig.get_path("include")) / "Python.h"
    if not header.is_file():
        raise SetupError(
            f"Python's headers are missing ({header}): install them (Debian, Ubuntu: "
            f"apt install python{version}-dev)"
        )


def create_environment() -> None:
    """Create .venv with the pinned packages, with or without the ROS 2 wheels."""
    use_wheels = not ros_is_sourced()
    locks = [ROOT / "requirements.txt", ROOT / "requirements-uv.txt"]
    if use_wheels:
        locks.append(ROOT / "requirements-ros.txt")
    key = digest(locks, sys.version, str(use_wheels), str(VENV))
    stamp = VENV / ".wisar-stamp"
    if is_current(stamp, key):
        return
    announce("creating .venv with the pinned packages")
    # A half-made or outdated environment is not worth repairing: it takes seconds to make anew.
    shutil.rmtree(VENV, ignore_errors=True)
    venv_options = [] if use_wheels else ["--system-site-packages"]
    # Not sys.executable: with env.sh sourced, that is the environment just removed.
    base = Path(sys.base_prefix) / "bin" / f"python{sys.version_info[0]}.{sys.version_info[1]}"
    # What a sourced ROS 2 has on PYTHONPATH must not count as installed here.
    alone = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    run([base, "-m", "venv", *venv_options, VENV], "venv", alone)
    pip: list[str | Path] = [
        PYTHON,
        "-m",
        "pip",
        "install",
        "--quiet",
        "--disable-pip-version-check",
    ]
    run([*pip, "--require-hashes", "-r", ROOT / "requirements-uv.txt"], "uv", alone)
    install_locked(locks[0], *locks[2:])
    if use_wheels:
        rewrite_cmake_paths()
    stamp.write_text(key)


def install_extra(name: str, what: str) -> None:
    """Install the packages of requirements-NAME.txt, which planning does without."""
    lock = ROOT / f"requirements-{name}.txt"
    stamp = VENV / f".wisar-{name}-stamp"
    if not is_current(stamp, key := digest([lock])):
        announce(f"installing {what}")
        install_locked(lock)
        stamp.write_text(key)


def install_locked(*locks: Path) -> None:
    """Install the packages of lock files, their hashes checked."""
    files = [option for lock in locks for option in ("-r", str(lock))]
    uv: list[str | Path] = [VENV / "bin" / "uv", "pip", "install", "--quiet", "--python", PYTHON]
    run([*uv, "--require-hashes", *files], "packages")


def rewrite_cmake_paths() -> None:
    """Point the wheels' CMake files at this machine's Python and NumPy headers.

    They carry two paths of the machine that built the wheels.
    """
    tag = f"cp{sys.version_info[0]}{sys.version_info[1]}"
    python = f"python{sys.version_info[0]}.{sys.version_info[1]}"
    prefix = f"/opt/python/{tag}-{tag}"
    numpy_include = subprocess.run(
        [PYTHON, "-c", "import numpy; print(numpy.get_include())"],
        check=True,
        capture_output=True,
        text=True,
    ).stdout.strip()
    replacements = {
        f"{prefix}/lib/{python}/site-packages/numpy/_core/include": numpy_include,
        f"{prefix}/include/{python}": sysconfig.get_path("include"),
    }
    for file in (VENV / "share").rglob("*.cmake"):
        text = original = file.read_text(encoding="utf-8", errors="surrogateescape")
        for old, new in replacements.items():
            text = text.replace(old, new)
        if text != original:
            file.write_text(text, encoding="utf-8", errors="surrogateescape")


def remove_other_builds() -> None:
    """Remove what was built for another environment or place: it would be picked up again."""
    key = digest([], (VENV / ".wisar-stamp").read_text(), str(ROOT))
    stamp = INSTALL / ".wisar-stamp"
    if is_current(stamp, key):
        return
    for folder in ("build", "install"):
        shutil.rmtree(ROOT / folder, ignore_errors=True)
    INSTALL.mkdir()
    stamp.write_text(key)


def build_python_packages() -> None:
    """Build wisar_planner and wisar_sim: seconds, and all that compiling kernels needs."""
    names = ("wisar_planner", "wisar_sim")
    key = digest(sources("src/wisar_planner", "src/wisar_sim", "config", "models"))
    stamp = INSTALL / ".wisar-python-stamp"
    if is_current(stamp, key):
        return
    announce(f"building {', '.join(names)} (colcon)")
    stamp.unlink(missing_ok=True)
    for name in names:
        # colcon leaves deleted modules in place; these are quick to install anew.
        shutil.rmtree(ROOT / "build" / name, ignore_errors=True)
        for installed in INSTALL.glob(f"lib/python3*/site-packages/{name}*"):
            shutil.rmtree(installed, ignore_errors=True)
    colcon_build(*names)
    stamp.write_text(key)


def build_messages() -> None:
    """Build wisar_msgs."""
    key = digest(sources("src/wisar_msgs"))
    stamp = INSTALL / ".wisar-messages-stamp"
    if is_current(stamp, key):
        return
    announce("building wisar_msgs (colcon)")
    stamp.unlink(missing_ok=True)
    colcon_build("wisar_msgs")
    stamp.write_text(key)


def sources(*folders: str) -> list[Path]:
    """Return the files that a build of some folders is made from."""
    return sorted(
        path
        for folder in folders
        for path in (ROOT / folder).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts and "test" not in path.parts
    )


def colcon_build(*packages: str) -> None:
    """Build packages with colcon into the one prefix, install/."""
    environment = dict(os.environ, PATH=f"{VENV / 'bin'}{os.pathsep}{os.environ['PATH']}")
    if not ros_is_sourced():
        environment.pop("PYTHONPATH", None)
        environment["AMENT_PREFIX_PATH"] = environment["CMAKE_PREFIX_PATH"] = str(VENV)
        environment["_ROS_WHEELS_BOOTSTRAP_COMPLETE"] = "1"
        environment["LD_LIBRARY_PATH"] = wheel_libraries()
    build: list[str | Path] = [
        PYTHON,
        "-m",
        "colcon",
        "--log-base",
        LOGS,
        "build",
        "--merge-install",
    ]
    build += ["--base-paths", *(ROOT / "src" / name for name in packages)]
    build += ["--build-base", ROOT / "build", "--install-base", INSTALL]
    build += ["--event-handlers", "console_direct-"]
    build += ["--cmake-args", "-GNinja", f"-DPython3_EXECUTABLE={PYTHON}", "-DBUILD_TESTING=OFF"]
    run(build, f"build-{packages[0]}", environment)


def link_command(name: str) -> None:
    """Put a command of wisar_planner beside the environment's Python, so it is on PATH."""
    link = VENV / "bin" / name
    link.unlink(missing_ok=True)
    link.symlink_to(INSTALL / "lib" / "wisar_planner" / name)


def installed_modules(package: str) -> list[Path]:
    """Return the installed modules of a package."""
    packages = next(INSTALL.glob("lib/python3*/site-packages"))
    return sorted(packages.glob(f"{package}/**/*.py"))


def keep_bytecode() -> None:
    """Load all modules once, so that no node compiles them at its start; see load_modules.py."""
    names = ("wisar_planner", "wisar_sim")
    installed = [path.read_text() for path in sorted(VENV.glob(".wisar*-stamp"))]
    modules = [path for name in names for path in installed_modules(name)]
    key = digest(modules, *installed, str(ROOT))
    stamp = VENV / ".bytecode-stamp"
    if is_current(stamp, key):
        return
    announce("loading all modules once")
    load = f"python '{ROOT}/scripts/load_modules.py' {' '.join(names)}"
    run(["bash", "-c", f". '{ROOT}/env.sh' && exec {load}"], "modules")
    stamp.write_text(key)


def compile_kernels() -> None:
    """Compile the numerical kernels into the cache, so that no node waits for it."""
    modules = installed_modules("wisar_planner")
    key = digest(modules, (VENV / ".wisar-stamp").read_text(), str(ROOT))
    stamp = ROOT / ".cache" / "numba" / ".wisar-stamp"
    if is_current(stamp, key):
        return
    announce("compiling the numerical kernels")
    # numba notices a change in a kernel's own file, but not in a kernel of another file it calls.
    shutil.rmtree(stamp.parent, ignore_errors=True)
    command = f". '{ROOT}/env.sh' && exec python -m wisar_planner.cli.warm_up"
    run(["bash", "-c", command], "kernels")
    stamp.parent.mkdir(parents=True, exist_ok=True)
    stamp.write_text(key)


def wheel_libraries() -> str:
    """Return the library path of the ROS 2 wheels, as in env.sh."""
    site = Path(sysconfig.get_path("purelib", vars={"base": str(VENV)}))
    return os.pathsep.join([str(VENV / "lib"), *map(str, sorted(site.glob("ros_*.libs")))])


def digest(files: Iterable[Path], *more: str) -> str:
    """Return a hash of the files' names and contents and of further strings."""
    value = hashlib.sha256("\0".join(more).encode())
    for file in files:
        value.update(str(file.relative_to(ROOT)).encode() + b"\0" + file.read_bytes())
    return value.hexdigest()


def is_current(stamp: Path, key: str) -> bool:
    """Whether a stage was last run from the same inputs."""
    return stamp.is_file() and stamp.read_text() == key


def run(command: list[str | Path], stage: str, environment: dict[str, str] | None = None) -> None:
    """Run a command with its output in log/setup-STAGE.log; show the end of it on failure."""
    LOGS.mkdir(exist_ok=True)
    log = LOGS / f"setup-{stage}.log"
    with log.open("wb") as output:
        result = subprocess.run(
            list(map(str, command)), stdout=output, stderr=subprocess.STDOUT, env=environment
        )
    if result.returncode != 0:
        lines = log.read_text(errors="replace").splitlines()[-25:]
        raise SetupError("\n  ".join([f"this stage failed; the end of {log}:", *lines]))


_STARTED = time.monotonic()


def announce(text: str) -> None:
    """Print a progress line with the seconds since the start."""
    print(f"setup [{time.monotonic() - _STARTED:4.0f} s] {text}", flush=True)


if __name__ == "__main__":
    sys.exit(main())
