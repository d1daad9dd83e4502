"""docs/formats.md: its examples are accepted by the readers it describes, and no key is left out."""

import re
from pathlib import Path

import pytest
from formats_page import with_formats, with_models
from generated_pages import WRITE

from camcal.cameras.catalogue import MODELS
from camcal.formats import (
    boards,
    correspondences,
    covariance,
    detections,
    frames,
    native,
    native_entry,
    tags,
    trajectories,
)
from camcal.formats.boards import BOARD_KEYS, SPACING, lengths
from camcal.formats.cameras import FORMATS
from camcal.formats.detections import COLUMNS, OPTIONAL
from camcal.formats.native_entry import KEY_OF_CLASS, KEY_OF_TERM, PROJECTION_FIGURES
from camcal.targets.board import TIERS, parse_board

PAGE = (Path(__file__).parents[2] / "docs" / "formats.md").read_text(encoding="utf-8")
EXAMPLES = re.findall(r"^```(\w+ \w+)\n(.*?)^```$", PAGE, flags=re.MULTILINE | re.DOTALL)


def read_camera_file(path):
    assert native.read(path).warnings == ()


def read_board(path):
    board = boards.read(path)
    assert board.count == 54 or board.type != "chessboard"


def read_csv(path):
    found = detections.read(path)
    assert len(found.views) == 2


def read_vnl(path):
    found = detections.read(path, parse_board("chessboard:2x2"), (640, 480))
    assert [len(view.ids) for view in found.views] == [3, 0]


def read_tags(path):
    assert tags.read(path).find(20)[0] == "cube"


def read_frames(path):
    assert len(frames.read(path)) == 3


def read_points(path):
    (view,) = correspondences.read(path, (640, 480)).views
    assert len(view.points) == 2


def read_trajectory(path):
    assert trajectories.read(path).frames == "world_T_camera"


READERS = {
    "yaml camera": (".yaml", read_camera_file),
    "yaml board": (".yaml", read_board),
    "csv detections": (".csv", read_csv),
    "vnl corners": (".vnl", read_vnl),
    "yaml tags": (".yaml", read_tags),
    "yaml frames": (".yaml", read_frames),
    "csv correspondences": (".csv", read_points),
    "yaml correspondences": (".yaml", read_points),
    "yaml trajectory": (".yaml", read_trajectory),
}


@pytest.mark.parametrize(("kind", "content"), EXAMPLES)
def test_an_example_of_the_page_is_accepted(tmp_path, kind, content):
    suffix, reader = READERS[kind]
    path = tmp_path / f"example{suffix}"
    path.write_text(content, encoding="utf-8")
    reader(path)


def test_the_page_has_examples_of_every_kind():
    assert {kind for kind, _ in EXAMPLES} == set(READERS)


def keys_of_boards():
    for keys in BOARD_KEYS.values():
        yield from (keys.size, *lengths(keys.scale), *lengths(keys.part))
        yield from (key for key, _ in (*keys.required.values(), *keys.optional.values()))
        if keys.part:
            yield f"{keys.part}_ratio"
    yield SPACING


def test_every_key_and_column_is_named_on_the_page():
    keys = [
        *covariance.KEYS,
        *native_entry.VALID,
        *native_entry.SENSOR,
        *native_entry.FIGURES,
        *native_entry.COUNTS,
        *PROJECTION_FIGURES,
        *KEY_OF_TERM.values(),
        *KEY_OF_CLASS.values(),
        *keys_of_boards(),
        *COLUMNS,
        *OPTIONAL,
        *TIERS,
        *MODELS,
    ]
    assert [key for key in keys if f"`{key}`" not in PAGE] == []


def test_the_table_of_lens_models_is_what_the_models_say():
    page = with_models(PAGE, list(MODELS.values())[1:])
    assert "| `pinhole` |" not in page
    assert with_models(page, MODELS.values()) == PAGE, WRITE


def test_the_table_of_camera_formats_is_what_the_formats_say():
    page = with_formats(PAGE, list(FORMATS.values())[1:])
    assert "| `camcal` |" not in page
    assert with_formats(page, FORMATS.values()) == PAGE, WRITE


def test_the_comparison_counts_lens_models_and_the_formats_that_are_read_and_written():
    parametric = [name for name, model in MODELS.items() if not model.is_view and name != "splined_stereographic"]
    others = [form for name, form in FORMATS.items() if name != "camcal"]
    read = [form for form in others if "write_only" not in form.read.__qualname__]
    written = [form for form in others if form.suffixes]
    comparison = (Path(__file__).parents[2] / "docs" / "comparison.md").read_text(encoding="utf-8")
    assert f"**{len(read)} read, {len(written)} written**" in comparison
    assert f"| {len(parametric)} parametric ones, **spline** |" in comparison
