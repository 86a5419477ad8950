"""What this machine lacks is said in one line, and a ROS 2 installation is recognised."""

from __future__ import annotations

import importlib.util
import platform
import shutil
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).resolve().parent.parent


@pytest.fixture
def setup(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    path = ROOT / "scripts" / "setup_environment.py"
    spec = importlib.util.spec_from_file_location("setup_environment", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    for name in ("AMENT_PREFIX_PATH", "ROS_DISTRO", "CXX"):
        monkeypatch.delenv(name, raising=False)
    return module


def ros_prefix(folder: Path) -> Path:
    marker = folder / "share" / "ament_index" / "resource_index" / "packages" / "rcl_interfaces"
    marker.parent.mkdir(parents=True)
    marker.touch()
    return folder


def test_this_machine_will_do(setup: ModuleType) -> None:
    setup.check_machine()


def test_a_missing_compiler_is_named(setup: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shutil, "which", lambda *_: None)
    with pytest.raises(setup.SetupError, match=r"no C\+\+ compiler.*apt install g\+\+"):
        setup.check_machine()


@pytest.mark.parametrize("version", [(3, 9, 0), (3, 14, 0)])
def test_an_unsupported_python_is_named(
    setup: ModuleType, monkeypatch: pytest.MonkeyPatch, version: tuple[int, int, int]
) -> None:
    monkeypatch.setattr(sys, "version_info", version)
    with pytest.raises(setup.SetupError, match=rf"Python 3\.{version[1]} is not supported"):
        setup.check_machine()


def test_an_unsupported_processor_is_named(
    setup: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(platform, "machine", lambda: "aarch64")
    with pytest.raises(setup.SetupError, match=r"aarch64: install ROS 2 Jazzy"):
        setup.check_machine()


def test_a_sourced_jazzy_is_used(
    setup: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    assert not setup.ros_is_sourced()
    monkeypatch.setenv("ROS_DISTRO", "jazzy")
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"{tmp_path / 'overlay'}:{ros_prefix(tmp_path)}")
    assert setup.ros_is_sourced()
    # Then the processor does not matter: the wheels are not needed.
    monkeypatch.setattr(platform, "machine", lambda: "aarch64")
    setup.check_machine()


def test_another_distribution_is_refused(
    setup: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("ROS_DISTRO", "humble")
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(ros_prefix(tmp_path)))
    with pytest.raises(setup.SetupError, match="ROS 2 humble is sourced, wisar needs Jazzy"):
        setup.check_machine()


def test_wheels_of_this_or_another_checkout_are_no_installation(
    setup: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    other = ros_prefix(tmp_path / "other" / ".venv")
    (other / "pyvenv.cfg").touch()
    monkeypatch.setenv("ROS_DISTRO", "jazzy")
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"{other}:{ROOT / '.venv'}:{ROOT / 'install'}")
    assert not setup.ros_is_sourced()
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"{other}:{ros_prefix(tmp_path / 'ros')}")
    assert setup.ros_is_sourced()


def test_a_build_for_another_environment_is_removed(
    setup: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(setup, "ROOT", tmp_path)
    monkeypatch.setattr(setup, "VENV", tmp_path / ".venv")
    monkeypatch.setattr(setup, "INSTALL", tmp_path / "install")
    (tmp_path / ".venv").mkdir()
    environment = tmp_path / ".venv" / ".wisar-stamp"
    environment.write_text("one")
    setup.remove_other_builds()
    built = [tmp_path / folder / "some_package" for folder in ("build", "install")]
    for folder in built:
        folder.mkdir(parents=True)
    setup.remove_other_builds()
    assert all(folder.exists() for folder in built)
    environment.write_text("another")
    setup.remove_other_builds()
    assert not any(folder.exists() for folder in built)


def test_a_change_of_code_builds_its_package_alone(
    setup: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    built: list[tuple[str, ...]] = []
    monkeypatch.setattr(setup, "ROOT", tmp_path)
    monkeypatch.setattr(setup, "INSTALL", tmp_path / "install")
    monkeypatch.setattr(setup, "colcon_build", lambda *names: built.append(names))
    (tmp_path / "install").mkdir()
    for name in ("wisar_msgs", "wisar_planner", "wisar_sim"):
        (tmp_path / "src" / name).mkdir(parents=True)
        (tmp_path / "src" / name / "package.xml").touch()

    def build() -> list[tuple[str, ...]]:
        built.clear()
        setup.build_python_packages()
        setup.build_messages()
        return list(built)

    python, messages = ("wisar_planner", "wisar_sim"), ("wisar_msgs",)
    assert build() == [python, messages]
    assert build() == []
    (tmp_path / "src" / "wisar_sim" / "package.xml").write_text("changed")
    assert build() == [python]
    (tmp_path / "src" / "wisar_msgs" / "package.xml").write_text("changed")
    assert build() == [messages]


def test_lock_files_pin_hashes_and_name_no_address() -> None:
    for path in ROOT.glob("requirements*.txt"):
        text = path.read_text()
        assert "://" not in text
        assert "--hash=sha256:" in text
        for line in text.splitlines():
            assert line.startswith((" ", "#")) or "==" in line, f"{path.name}: {line}"


def test_env_sh_works_in_a_clean_shell() -> None:
    command = (
        f". {ROOT}/env.sh && . {ROOT}/env.sh && wisar --version && "
        'python -c "import wisar_msgs.msg" && echo $ROS_AUTOMATIC_DISCOVERY_RANGE && '
        'ls "$WISAR_PREFIX/lib/wisar_planner/planner" && echo "$PATH"'
    )
    done = subprocess.run(
        ["bash", "--norc", "-c", command],
        env={"PATH": "/usr/bin:/bin", "HOME": "/nonexistent"},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert "LOCALHOST" in done.stdout
    assert done.stdout.splitlines()[-1].count(".venv/bin") == 1  # sourced twice, set once


def test_the_checkout_sourced_last_wins(tmp_path: Path) -> None:
    other = tmp_path / "env.sh"
    other.write_text((ROOT / "env.sh").read_text())
    (tmp_path / "install").mkdir()
    command = f". {ROOT}/env.sh && . {other} && . {ROOT}/env.sh && env"
    done = subprocess.run(
        ["bash", "--norc", "-c", command],
        env={"PATH": "/usr/bin:/bin"},
        capture_output=True,
        text=True,
        check=True,
    )
    found = dict(line.split("=", 1) for line in done.stdout.splitlines() if "=" in line)
    for name in ("AMENT_PREFIX_PATH", "LD_LIBRARY_PATH", "PATH", "PYTHONPATH"):
        folders = found[name].split(":")
        assert folders[0].startswith(f"{ROOT}/"), name
        assert len(folders) == len(set(folders)), name
        assert any(folder.startswith(f"{tmp_path}/") for folder in folders), name


def test_loaded_modules_keep_their_bytecode_where_python_is_to_write_none(tmp_path: Path) -> None:
    package = tmp_path / "some_package"
    package.mkdir()
    for name, text in (("__init__", ""), ("part", "import json"), ("extra", "import not_there")):
        (package / f"{name}.py").write_text(text)
    command = [sys.executable, str(ROOT / "scripts" / "load_modules.py"), "some_package"]
    environment = {"PYTHONPATH": str(tmp_path), "PYTHONDONTWRITEBYTECODE": "1"}
    subprocess.run(command, env=environment, check=True)
    kept = {path.name.partition(".")[0] for path in (package / "__pycache__").iterdir()}
    assert kept == {"__init__", "part", "extra"}
