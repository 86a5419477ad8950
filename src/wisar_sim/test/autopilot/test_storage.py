"""The file in which missions survive a restart."""

import json
import math
from dataclasses import asdict, replace

import pytest
from pymavlink.dialects.v20 import common as mav

from wisar_planner.errors import InvalidInput
from wisar_planner.pdm.geodesy import GeoOrigin
from wisar_sim.autopilot.autopilot import Autopilot
from wisar_sim.autopilot.cli import main
from wisar_sim.autopilot.mission_server import StoredItem
from wisar_sim.autopilot.profile import PROFILES
from wisar_sim.autopilot.storage import load_lists, save_lists

ITEM = StoredItem(16, 6, (0.0, 2.5, 0.0, math.inf), 570_000_000, -40_000_000, 20.0)
ROW = asdict(ITEM)


def autopilot(*items):
    made = Autopilot(PROFILES["px4"], GeoOrigin(57.0, -4.0))
    made.missions.lists[mav.MAV_MISSION_TYPE_MISSION] = items
    return made


def test_what_was_saved_is_loaded(tmp_path):
    saved, loaded = autopilot(ITEM, replace(ITEM, x=1)), autopilot()
    saved.missions.lists[mav.MAV_MISSION_TYPE_FENCE] = (ITEM,)
    save_lists(tmp_path / "lists.json", saved)
    load_lists(tmp_path / "lists.json", loaded)
    assert loaded.missions.lists == saved.missions.lists
    assert loaded.vehicle.items == (ITEM, replace(ITEM, x=1))
    assert [file.name for file in tmp_path.iterdir()] == ["lists.json"]


def test_a_missing_file_is_no_mistake(tmp_path):
    holder = autopilot(ITEM)
    load_lists(tmp_path / "lists.json", holder)
    assert holder.missions.flight_items == (ITEM,)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"not JSON",
        b"\xff\xfe",
        b"[]",
        b"3",
        *(
            json.dumps(content).encode()
            for content in (
                {"9": []},
                {"mission": []},
                {"0": 3},
                {"0": [3]},
                {"0": ["text"]},
                {"0": [{"command": 16}]},
                {"0": [{**ROW, "more": 1}]},
                {"0": [{**ROW, "params": 0.0}]},
                {"0": [{**ROW, "params": [0.0]}]},
                {"0": [{**ROW, "params": ["0"] * 4}]},
                {"0": [{**ROW, "x": 1.5}]},
                {"0": [{**ROW, "y": 2**31}]},
                {"0": [{**ROW, "z": None}]},
                {"0": [{**ROW, "z": 1e300}]},
                {"0": [{**ROW, "command": -1}]},
                {"0": [{**ROW, "frame": 256}]},
                {"0": [ROW], "1": [{**ROW, "autocontinue": "1"}]},
            )
        ),
    ],
)
def test_a_file_of_something_else_is_refused_in_one_line(content, tmp_path, capsys):
    path = tmp_path / "lists.json"
    path.write_bytes(content)
    holder = autopilot()
    with pytest.raises(InvalidInput, match=r"--storage.*holds no missions"):
        load_lists(path, holder)
    assert holder.missions.lists == autopilot().missions.lists
    assert main(("--storage", str(path))) == 2
    error = capsys.readouterr().err
    assert str(path) in error
    assert error.count("\n") == 1
    assert path.read_bytes() == content


def test_a_save_that_fails_leaves_the_old_file_and_names_the_option(tmp_path, monkeypatch):
    path = tmp_path / "lists.json"
    save_lists(path, autopilot(ITEM))
    before = path.read_bytes()
    write_text = type(path).write_text

    def half(file, text, **options):
        write_text(file, text[: len(text) // 2], **options)
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(type(path), "write_text", half)
    with pytest.raises(InvalidInput, match=r"--storage: cannot write .*No space left"):
        save_lists(path, autopilot(ITEM, ITEM))
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_a_link_stays_a_link(tmp_path):
    (tmp_path / "elsewhere").mkdir()
    path = tmp_path / "lists.json"
    path.symlink_to(tmp_path / "elsewhere" / "lists.json")
    save_lists(path, autopilot(ITEM))
    assert path.is_symlink()
    loaded = autopilot()
    load_lists(path, loaded)
    assert loaded.missions.flight_items == (ITEM,)
