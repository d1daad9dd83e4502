"""Where results go: by name in a folder, never two to one place."""

from pathlib import Path

import pytest

from camcal.errors import InvalidInput
from camcal.run.paths import place

FRAMES = [Path("raw/a.png"), Path("raw/b.png")]
KINDS = (".tiff", ".png")


def test_several_inputs_go_into_a_folder_by_their_names():
    assert place(FRAMES, Path("out"), ".tiff", KINDS) == {
        FRAMES[0]: Path("out/a.tiff"),
        FRAMES[1]: Path("out/b.tiff"),
    }


def test_a_single_input_may_go_into_a_file():
    assert place(FRAMES[:1], Path("out.png"), ".tiff", KINDS) == {FRAMES[0]: Path("out.png")}


def test_a_folder_whose_name_has_a_dot_is_still_a_folder(tmp_path):
    folder = tmp_path / "out.d"
    folder.mkdir()
    assert place(FRAMES[:1], folder, ".tiff", KINDS) == {FRAMES[0]: folder / "a.tiff"}


@pytest.mark.parametrize(
    ("inputs", "output", "message"),
    [
        (FRAMES, "out.png", "2 inputs cannot be written to one file"),
        (FRAMES[:1], "out.exr", "use .tiff, .png"),
        (FRAMES[:1], ".PNG", "a suffix without a name; write NAME.PNG"),
        (FRAMES, "new/.tiff", "a suffix without a name"),
        ([Path("raw/a.png"), Path("other/a.png")], "out", "both be written"),
    ],
)
def test_what_would_lose_something_is_refused(inputs, output, message):
    with pytest.raises(InvalidInput, match=message):
        place(inputs, Path(output), ".tiff", KINDS)
