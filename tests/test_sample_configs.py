"""Every file under sample_configs is what its folder says and would be accepted by the command that reads it."""

from pathlib import Path

import pytest
from command_page import REGISTERED
from generated_pages import command_of

from camcal.cli.main import app
from camcal.formats import boards, documents, native, tags

FOLDER = Path(__file__).parents[1] / "sample_configs"
FILES = sorted(path.relative_to(FOLDER).as_posix() for path in FOLDER.rglob("*") if path.is_file())

SETTINGS = [name for name in FILES if "/" not in name]


def load_board(path: Path) -> None:
    board = boards.read(path)
    assert board.count >= 4


def load_camera(path: Path) -> None:
    file = native.read(path)
    assert file.cameras
    assert file.warnings == ()


def load_tags(path: Path) -> None:
    found = tags.read(path)
    assert found.size is not None or found.bundles


def load_settings(path: Path) -> None:
    """A file at the top holds the options of the command it is named after; --config is read before --help answers."""
    with pytest.raises(SystemExit) as ended:
        app([*path.stem.split("_"), "--config", str(path), "--help"])
    assert ended.value.code == 0


def load_pipeline(path: Path) -> None:
    """Its inputs are not there: `test_sample_pipelines` runs it with some."""
    assert {"variables", "steps"} <= set(documents.load(path))


LOADERS = {
    "pipelines": load_pipeline,
    "boards": load_board,
    "cameras": load_camera,
    "tags": load_tags,
    ".": load_settings,
}


@pytest.mark.parametrize("name", FILES)
def test_a_sample_is_loaded_by_what_it_is_a_sample_of(name):
    path = Path(name)
    LOADERS[path.parent.as_posix()](FOLDER / path)


def test_there_are_samples_of_every_kind_and_of_every_command():
    assert {Path(name).parent.as_posix() for name in FILES} == set(LOADERS)
    assert {command_of(FOLDER / name) for name in SETTINGS} == set(REGISTERED)


def test_a_settings_file_with_an_unknown_key_would_be_noticed(tmp_path):
    path = tmp_path / "demosaic.yaml"
    path.write_text("algorythm: bilinear\n")
    with pytest.raises(SystemExit) as ended:
        app(["demosaic", "--config", str(path), "--help"])
    assert ended.value.code == 2
