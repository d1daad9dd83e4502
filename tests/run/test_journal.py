"""What was found in images is kept until the result is written."""

from pathlib import Path

import numpy as np
import pytest

from camcal.errors import FileError, InvalidInput
from camcal.run import fingerprint
from camcal.run.journal import journal_beside, journaled, path_beside, resume_hint
from camcal.run.options import DEFAULT_BATCH, BatchOptions
from camcal.run.resume import Items
from camcal.targets.board import Board
from camcal.targets.detection import BoardDetection

OUTPUT = Path("result.csv")
RESUME = BatchOptions(resume=True)


class Stopped(BaseException):
    """Ends a run as Ctrl-C does."""


@pytest.fixture
def images(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for number in range(4):
        Path(f"{number}.png").write_bytes(bytes([number]))
    return [Path(f"{number}.png") for number in range(4)]


def look(images, batch=DEFAULT_BATCH, stop=None, error=None, settings="any"):
    """Search images, up to one where the run ends; return those that were searched, and what was found."""
    searched = []

    def search(path):
        if path == stop:
            raise error or Stopped
        searched.append(path.stem)
        return BoardDetection(path.name, (4, 3), np.array([2, 5]), np.array([[0.1, 1 / 3], [2.5, np.pi]]))

    found = Items(settings, lambda path: [path], result=BoardDetection)
    with journal_beside(OUTPUT, batch):
        outcomes = list(journaled(search, images, found, jobs=1, batch=batch))
    return searched, [outcome.value for outcome in outcomes]


def stopped(images, at):
    with pytest.raises(Stopped):
        look(images, stop=images[at])


def test_images_that_a_stopped_run_has_searched_are_not_searched_again(images):
    _, whole = look(images)
    assert not path_beside(OUTPUT).exists()
    stopped(images, 2)
    assert path_beside(OUTPUT).exists()
    searched, found = look(images, RESUME)
    assert searched == ["2", "3"]
    assert all(np.array_equal(view.pixels, other.pixels) for view, other in zip(found, whole, strict=True))
    assert not path_beside(OUTPUT).exists()


def test_without_resume_all_images_are_searched(images):
    stopped(images, 2)
    assert look(images)[0] == ["0", "1", "2", "3"]


def test_images_that_changed_and_other_settings_are_searched_again(images):
    stopped(images, 3)
    images[1].write_bytes(b"other")
    with pytest.raises(Stopped):
        look(images, RESUME, stop=images[3])
    assert look(images, RESUME, settings="other")[0] == ["0", "1", "2", "3"]
    stopped(images, 3)
    images[1].write_bytes(b"another")
    assert look(images, RESUME)[0] == ["1", "3"]


@pytest.mark.parametrize("left", [b"", b"half a line", b"{}\t\n", b"\xff\xfe\n"])
def test_a_line_that_cannot_be_read_is_ignored(images, left):
    stopped(images, 2)
    with path_beside(OUTPUT).open("ab") as stream:
        stream.write(left)
    with pytest.raises(Stopped):
        look(images, RESUME, stop=images[3])
    assert look(images, RESUME)[0] == ["3"]


def fail_after_looking(images, error):
    with journal_beside(OUTPUT, DEFAULT_BATCH):
        look(images)
        raise error


@pytest.mark.parametrize(("error", "stays"), [(InvalidInput("wrong"), False), (FileError("the disk is full"), True)])
def test_a_run_that_fails_leaves_a_journal_where_it_is_of_use(images, error, stays):
    with pytest.raises(type(error)):
        fail_after_looking(images, error)
    assert path_beside(OUTPUT).exists() == stays


def test_a_run_for_which_images_failed_leaves_a_journal_until_they_are_repaired(images):
    look(images, stop=images[1], error=FileError("is damaged"))
    assert resume_hint(OUTPUT) == "; with --resume the others are not searched again"
    images[1].write_bytes(b"repaired")
    assert look(images, RESUME)[0] == ["1"]
    assert resume_hint(OUTPUT) == ""


def test_records_of_detection_are_the_same_after_a_round_trip():
    view = BoardDetection(
        "a.png",
        (640, 480),
        np.array([0, 7]),
        np.array([[0.1, 0.2], [1e-17, 3.0]]),
        covariance=np.full((2, 2, 2), 1 / 3),
        other=Board("chessboard", 5, 4, 0.03),
        colours={"red": BoardDetection("a.png", (640, 480), reason="dark")},
        time=0.25,
    )
    back = fingerprint.value_of_plain(BoardDetection, fingerprint.as_plain(view))
    assert (back.other, back.time, back.colours["red"].reason, back.size) == (view.other, 0.25, "dark", (640, 480))
    assert np.array_equal(back.pixels, view.pixels)
    assert np.array_equal(back.covariance, view.covariance)
    assert np.isnan(back.blur_px)
