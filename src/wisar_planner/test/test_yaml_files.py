"""Numbers in YAML files are those of YAML 1.2, and what is no YAML is told in a line."""

import pytest

from wisar_planner.errors import InvalidInput
from wisar_planner.yaml_files import read_yaml


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("4e-3", 0.004), ("1e4", 1e4), ("-1E+3", -1000.0), ("-.5", -0.5), ("6.e1", 60.0),
        ("12", 12), ("0x10", 16), ("1.5", 1.5), (".inf", float("inf")),
        ("e4", "e4"), ("'1e4'", "1e4"), ("1e", "1e"), ("4e-3 m", "4e-3 m"),
    ],
)  # fmt: skip
def test_numbers_are_numbers_and_words_are_words(tmp_path, text, value) -> None:
    file = tmp_path / "file.yaml"
    file.write_text(f"value: {text}\n")
    found = read_yaml(file)["value"]
    assert found == value
    assert type(found) is type(value)


@pytest.mark.parametrize("content", [b"a: [", b"\xff\xfe\x00", b"a: !!python/object:os.system {}"])
def test_what_is_no_yaml_is_told_in_a_line(tmp_path, content) -> None:
    file = tmp_path / "file.yaml"
    file.write_bytes(content)
    with pytest.raises(InvalidInput, match="is not YAML") as told:
        read_yaml(file)
    assert len(str(told.value).splitlines()) == 1
