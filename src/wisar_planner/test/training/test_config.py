"""What the configurations of all algorithms check."""

import pytest

from wisar_planner.errors import InvalidInput
from wisar_planner.training.algorithms import ALGORITHMS, read_any_config
from wisar_planner.training.config import build
from wisar_planner.training.expert_iteration.config import ExpertConfig


@pytest.fixture(params=ALGORITHMS)
def file(request, tmp_path):
    """A function that writes a configuration."""

    def write(fields):
        path = tmp_path / "config.yaml"
        algorithm = f"algorithm: {request.param}\n" if request.param else ""
        path.write_text(algorithm + fields)
        return path

    return write


@pytest.mark.parametrize(
    "name", ["checkpoint", "Checkpoint", "a/b", "../x", ".x", "", "a b", "sac\\n"]
)
def test_a_name_that_no_file_of_a_run_can_have_is_refused(file, name) -> None:
    with pytest.raises(InvalidInput, match="name must be made of"):
        read_any_config(file(f'name: "{name}"'))


@pytest.mark.parametrize("name", ["sac", "paper_sac-2", "v1.2", "checkpoint-2", "größer"])
def test_other_names_are_taken(file, name) -> None:
    assert read_any_config(file(f"name: {name}")).name == name


@pytest.mark.parametrize("algorithm", ["dqn", "", "[ppo]", "'sac'", "{}", "3"])
def test_an_unknown_algorithm_is_refused(tmp_path, algorithm) -> None:
    path = tmp_path / "config.yaml"
    path.write_text(f"algorithm: {algorithm}")
    with pytest.raises(InvalidInput, match="algorithm must be improvement or ppo or"):
        read_any_config(path)


def test_a_list_of_any_length_is_taken_and_its_values_are_checked() -> None:
    assert build(ExpertConfig, {"labels": ["a", "b", "c"]}, "file").labels == ("a", "b", "c")
    for wrong in ("a", [1]):
        with pytest.raises(InvalidInput, match="file: labels must be"):
            build(ExpertConfig, {"labels": wrong}, "file")
