"""Settings files: what they may hold and what is said of those that do not."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from camcal.errors import FileError, InvalidInput
from camcal.run.settings import read_settings

OPTIONS = {"square_mm": False, "flat_board": False, "jobs": False, "fix": True, "model": False}


@pytest.fixture
def settings(tmp_path):
    def read(text: str):
        path = tmp_path / "settings.yaml"
        path.write_text(text)
        return read_settings(path, OPTIONS)

    return read


def test_values_arrive_as_typed_on_a_command_line(settings):
    read = settings("square-mm: 25.4\nflat_board: true\njobs: 2\nfix: [k3, p1]\nmodel: opencv8\n")
    assert read.values == {
        "square_mm": "25.4",
        "flat_board": True,
        "jobs": "2",
        "fix": ["k3", "p1"],
        "model": "opencv8",
    }
    assert read.lines == {"square_mm": 1, "flat_board": 2, "jobs": 3, "fix": 4, "model": 5}


def test_keys_that_begin_with_x_are_notes_and_may_hold_anything(settings):
    read = settings("jobs: 2\nx_record: {source: a.dng, black: [1, 2], nothing: null}\n")
    assert read.values == {"jobs": "2"}


def test_one_value_stands_for_a_list_of_one(settings):
    assert settings("fix: k3\n").values == {"fix": ["k3"]}


@pytest.mark.parametrize(
    ("text", "line", "words"),
    [
        ("jobs: 2\nsquare-m: 3\n", 2, "square-m: unknown key. Did you mean 'square-mm'?"),
        ("qqqq: 3\n", 1, "qqqq: unknown key; --write-config lists those of the command"),
        ("square-mm: 3\nsquare_mm: 4\n", 2, "square_mm: given twice"),
        ("jobs: 2\njobs: 3\n", 2, "duplicate key 'jobs' (first at line 1)"),
        ("jobs: [1, 2]\n", 1, "jobs: takes one value, not a list"),
        ("jobs:\n", 1, "jobs: has no value"),
        ("fix: [k3, {a: 1}]\n", 1, "fix: expects a plain value"),
        ("model: {name: opencv5}\n", 1, "model: expects a plain value"),
        ("model: &m opencv5\nfix: *m\n", 1, "model: anchor &m"),
        ("model: !!str opencv5\n", 1, "model: tag"),
    ],
)
def test_a_faulty_line_is_named_with_its_file_and_key(settings, text, line, words):
    with pytest.raises(InvalidInput) as caught:
        settings(text)
    assert f"settings.yaml:{line}: {words}" in str(caught.value)


def test_a_file_that_is_not_yaml_is_a_file_error(settings):
    with pytest.raises(FileError, match=r"settings\.yaml:2: invalid or truncated YAML"):
        settings("{")


@given(st.dictionaries(st.sampled_from(["jobs", "model"]), st.integers() | st.text("abc-_.:#", max_size=8)))
def test_any_plain_text_or_number_survives(tmp_path_factory, values):
    path = tmp_path_factory.getbasetemp() / "settings.yaml"
    path.write_text("{" + ", ".join(f"{key}: '{value}'" for key, value in values.items()) + "}")
    assert read_settings(path, OPTIONS).values == {key: str(value) for key, value in values.items()}
