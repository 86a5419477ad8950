import hashlib
import json

import numpy as np
import pytest

from wisar_planner.errors import InvalidInput
from wisar_planner.evaluation.run import PlannerSpec, RunRecord
from wisar_planner.evaluation.store import RunStore, setup_digest
from wisar_planner.policy.heading import ACTOR_OUTPUTS
from wisar_planner.policy.model import save_model
from wisar_planner.policy.network import initial_parameters

SETUP = {"seed": 0, "persons": 10}
LAWNMOWER = PlannerSpec("lawnmower")


def record(index: int, planner: str = "lawnmower") -> RunRecord:
    return RunRecord(
        planner=planner,
        index=index,
        p_d=0.1,
        e_p=0.1 / 0.7,
        p_a=0.7,
        bound=1.0 / 3.0,
        curve=[0.0, 0.1 / 0.7],
        persons=10,
        found=1,
        find_total=12.5,
        find_squares=156.25,
        find_counts=[0, 1],
        seconds=0.01,
        length=512.0,
        transit=0.0,
        offset=0.0,
        start=[1.0, 2.0],
        waypoints=[[1.0, 2.0], [3.0, 4.0]],
    )


def trained(path, seed: int) -> PlannerSpec:
    """Write an untrained policy to a path and return the planner that flies it."""
    networks = initial_parameters(
        np.random.default_rng(seed), networks=1, outputs=ACTOR_OUTPUTS, channels=4, blocks=1
    )
    save_model(path, networks, {})
    return PlannerSpec("sac", {"model": str(path)})


def lines_of(path) -> list[dict]:
    return [json.loads(line) for line in path.read_text().splitlines()]


def fill(path, indices, setup=SETUP, planners=(LAWNMOWER,)):
    with RunStore(path, setup, planners) as store:
        store.append(record(index) for index in indices)
        return store.path


def test_what_was_written_is_read_back_to_the_last_digit(tmp_path):
    path = fill(tmp_path / "runs.jsonl", range(3))
    with RunStore(path, SETUP, [LAWNMOWER]) as store:
        assert store.records == [record(0), record(1), record(2)]


def test_a_last_line_that_was_torn_off_is_dropped_and_written_over(tmp_path):
    path = fill(tmp_path / "runs.jsonl", range(2))
    whole = path.read_bytes()
    path.write_bytes(whole[:-40])
    fill(path, [1])
    assert path.read_bytes() == whole


def test_a_torn_header_starts_the_file_over(tmp_path):
    path = tmp_path / "runs.jsonl"
    fill(path, [])
    whole = path.read_bytes()
    for length in (0, 3, 20):
        path.write_bytes(whole[:length])
        fill(path, [])
        assert path.read_bytes() == whole


def test_another_setup_is_refused_with_the_difference(tmp_path):
    path = fill(tmp_path / "runs.jsonl", range(2))
    with pytest.raises(InvalidInput, match="seed is 0 there and 1 here"):
        RunStore(path, {**SETUP, "seed": 1}, [LAWNMOWER])


def test_other_options_of_a_planner_are_refused_with_the_difference(tmp_path):
    path = fill(tmp_path / "runs.jsonl", range(2))
    with pytest.raises(InvalidInput, match=r"lane_spacing is 0\.0 there and 5\.0 here"):
        RunStore(path, SETUP, [PlannerSpec("lawnmower", {"lane_spacing": 5.0})])


def test_other_weights_under_the_same_path_are_refused_with_the_difference(tmp_path):
    runs, model = tmp_path / "runs.jsonl", tmp_path / "policy.safetensors"
    with RunStore(runs, SETUP, [trained(model, 0)]) as store:
        store.append([record(0, "sac")])
    first = hashlib.sha256(model.read_bytes()).hexdigest()
    with RunStore(runs, SETUP, [trained(model, 0)]) as store:
        assert store.records == [record(0, "sac")]
    trained(model, 1)
    second = hashlib.sha256(model.read_bytes()).hexdigest()
    with pytest.raises(InvalidInput, match=f"model_sha256 is '{first}' there and '{second}' here"):
        RunStore(runs, SETUP, [PlannerSpec("sac", {"model": str(model)})])
    with RunStore(runs, SETUP, [LAWNMOWER]) as store:
        assert store.records == []


def test_a_file_from_before_the_hash_is_continued_and_holds_it_from_then_on(tmp_path):
    runs, model = tmp_path / "runs.jsonl", tmp_path / "policy.safetensors"
    spec = trained(model, 0)
    with RunStore(runs, SETUP, [spec]) as store:
        store.append([record(0, "sac")])
    setup, planner, run = lines_of(runs)
    del planner["options"]["model_sha256"]
    runs.write_text("".join(json.dumps(line) + "\n" for line in (setup, planner, run)))
    with RunStore(runs, SETUP, [spec]) as store:
        assert store.records == [record(0, "sac")]
        store.append([record(1, "sac"), record(2, "sac")])
    assert [next(iter(line)) for line in lines_of(runs)] == [
        "setup", "planner", "run", "planner", "run", "run",
    ]  # fmt: skip
    with RunStore(runs, SETUP, [spec]) as store:
        assert [each.index for each in store.records] == [0, 1, 2]
    with pytest.raises(InvalidInput, match="model_sha256"):
        RunStore(runs, SETUP, [trained(model, 1)])


def test_runs_of_planners_that_are_not_asked_for_are_left_alone(tmp_path):
    path = fill(tmp_path / "runs.jsonl", range(2))
    with RunStore(path, SETUP, [PlannerSpec("lhc_gw_conv")]) as store:
        assert store.records == []
        store.append([record(0, "lhc_gw_conv")])
    with RunStore(path, SETUP, [LAWNMOWER, PlannerSpec("lhc_gw_conv")]) as store:
        assert [(r.planner, r.index) for r in store.records] == [
            ("lawnmower", 0),
            ("lawnmower", 1),
            ("lhc_gw_conv", 0),
        ]


def test_a_folder_has_a_file_per_setup(tmp_path):
    first = fill(tmp_path, [0])
    second = fill(tmp_path, [0], setup={**SETUP, "seed": 1})
    assert first != second
    assert first.name == f"runs-{setup_digest(SETUP)}.jsonl"
    assert fill(tmp_path, [1]) == first


@pytest.mark.parametrize(
    "content",
    [
        b"not json\n",
        b'{"other": 1}\n',
        b"[1, 2]\n",
        b"no line end",
        b'{"setup": 3}\n',
        b"II*\x00\x80\xff\n",
    ],
)
def test_a_foreign_file_is_refused_and_left_as_it_is(tmp_path, content):
    path = tmp_path / "notes.txt"
    path.write_bytes(content)
    with pytest.raises(InvalidInput, match=r"notes\.txt"):
        RunStore(path, SETUP, [LAWNMOWER])
    assert path.read_bytes() == content


def test_a_damaged_line_in_the_middle_is_named(tmp_path):
    path = fill(tmp_path / "runs.jsonl", range(3))
    lines = path.read_text().splitlines(keepends=True)
    lines[3] = lines[3][:50] + "\n"
    path.write_text("".join(lines))
    with pytest.raises(InvalidInput, match="line 4"):
        RunStore(path, SETUP, [LAWNMOWER])


@pytest.mark.parametrize("options", ["ab", None, 3, [1]])
def test_options_that_are_no_mapping_are_named(tmp_path, options):
    path = fill(tmp_path / "runs.jsonl", [0])
    setup, planner, run = lines_of(path)
    planner["options"] = options
    path.write_text("".join(json.dumps(line) + "\n" for line in (setup, planner, run)))
    with pytest.raises(InvalidInput, match="line 2"):
        RunStore(path, SETUP, [PlannerSpec("greedy")])


def test_every_line_is_on_disk_before_the_next_run(tmp_path):
    path = tmp_path / "runs.jsonl"
    with RunStore(path, SETUP, [LAWNMOWER]) as store:
        store.append([record(0)])
        kept = [json.loads(line) for line in path.read_text().splitlines()]
    assert [next(iter(line)) for line in kept] == ["setup", "planner", "run"]
