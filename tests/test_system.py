"""What differs between systems: the case of names, here of a folder that two names stand for."""

import errno
import os

import pytest

from camcal import system
from camcal.errors import InvalidInput
from camcal.run.paths import refuse_collisions


@pytest.fixture
def ignoring(tmp_path):
    """A folder that is there under its name in other letters, as where a file system ignores case."""
    folder = tmp_path / "Out"
    folder.mkdir()
    (tmp_path / "oUT").symlink_to(folder)
    return folder


def test_a_folder_that_ignores_case_is_known_by_its_name(tmp_path, ignoring):
    assert system.ignores_case(ignoring)
    assert system.ignores_case(ignoring / "not" / "there")
    assert not system.ignores_case(tmp_path / "Other")
    (tmp_path / "Other").mkdir()
    assert not system.ignores_case(tmp_path / "Other")
    (tmp_path / "oTHER").mkdir()
    assert not system.ignores_case(tmp_path / "Other")


def test_two_results_whose_names_differ_in_case_need_a_folder_that_tells_them_apart(tmp_path, ignoring):
    def results(folder):
        return {tmp_path / "a" / "IMG.jpg": folder / "IMG.png", tmp_path / "b" / "img.jpg": folder / "img.png"}

    refuse_collisions(results(tmp_path / "other"))
    with pytest.raises(InvalidInput, match=r"img\.png.*IMG\.jpg and .*img\.jpg would both be written to it"):
        refuse_collisions(results(ignoring))


def test_a_pipe_has_data_when_something_was_written_or_its_end_has_come():
    theirs, ours = os.pipe()
    with os.fdopen(theirs, "rb") as pipe:
        assert not system.wait_for_data(pipe, 0.0)
        os.write(ours, b"some")
        assert system.wait_for_data(pipe, 0.0)
        assert os.get_blocking(pipe.fileno())
        os.close(ours)
        assert pipe.read() == b"some"
        assert system.wait_for_data(pipe, 0.0)


@pytest.mark.skipif(not system.HAS_LOCKS, reason="this system has no locks")
@pytest.mark.parametrize("for_writing", [False, True], ids=["any", "as NFS, opened for writing"])
def test_a_held_file_is_refused_to_others_until_the_block_ends(tmp_path, monkeypatch, for_writing):
    def lock_of_nfs(handle, operation):
        if fcntl.fcntl(handle, fcntl.F_GETFL) & os.O_ACCMODE == os.O_RDONLY:
            raise OSError(errno.EBADF, "not opened for writing")
        flock(handle, operation)

    fcntl, flock = system.fcntl, system.fcntl.flock
    if for_writing:
        monkeypatch.setattr(fcntl, "flock", lock_of_nfs)
    path = tmp_path / "file"
    path.write_bytes(b"content")
    with system.held(path), pytest.raises(BlockingIOError), system.held(path):
        pass
    with system.held(path):
        assert path.read_bytes() == b"content"


def test_a_lock_is_held_by_one_at_a_time(tmp_path):
    path = tmp_path / "file"
    path.write_bytes(b"")
    first, second = system.open_to_read(path), system.open_to_read(path)
    system.lock(first)
    with pytest.raises(BlockingIOError):
        system.lock(second)
    os.close(first)
    system.lock(second)
    os.close(second)


def test_a_link_is_not_followed_where_that_is_said(tmp_path):
    (tmp_path / "file").write_bytes(b"")
    (tmp_path / "link").symlink_to(tmp_path / "file")
    os.close(system.open_to_read(tmp_path / "link"))
    with pytest.raises(OSError, match="symbolic links"):
        system.open_to_read(tmp_path / "link", follow=False)
