"""What a run reads and writes: no input is overwritten, nor what others wrote, and what camcal wrote carries its mark.

The one rule for all commands. What is read: every file that the options name, the images that folders and patterns
stand for, and whatever is opened on the way, such as the covariance beside a camera file. What is written: the
outputs that the options name, those that a task claims before its work, and whatever else is written; none of it may
be a file that is read, by whatever name, link or address.

A file that is there already is replaced if camcal wrote it: one that the user names, if it says so itself (the comment
or the format of a text, `camcal` in its provenance); any file, if it is listed in `.camcal-output` of its folder (see
`fingerprint`) and was not changed since. Files without a mark of their own are listed there, and those whose names the
user did not choose.
"""

import os
import re
import stat
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from collections.abc import Set as AbstractSet
from contextlib import contextmanager, suppress
from functools import wraps
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

from camcal import files
from camcal.errors import FileError, InvalidInput, reason
from camcal.options import Declared, declared
from camcal.parsing import in_one_line
from camcal.run import fingerprint
from camcal.run.fingerprint import MANIFEST, Entry
from camcal.run.options import inputs_of, is_folder, outputs_of, refuse_one_place, require_folder
from camcal.system import KNOWN, OutputFolders, require_writable

_HEAD = 4096  # bytes in which a text says who wrote it
_MARK = re.compile(rb'\A(?:%YAML[^\n]*\n---\n)?# (?:[^\n]*\b)?camcal\b|"(?:format|schema|tool)": "camcal\b')

P = ParamSpec("P")
R = TypeVar("R")
FileId = tuple[int, int]
FileVersion = tuple[FileId, int]  # with the time of its last change, ns


def writes(task: Callable[P, R]) -> Callable[P, R]:
    """Return a task whose first argument, its options, says what is read and written: the rule holds while it runs.

    The paths of its options are checked before its work; raises InvalidInput or FileError if the rule is broken.
    """

    @wraps(task)
    def watched(*arguments: P.args, **named: P.kwargs) -> R:
        with watch_files() as run:
            options: Any = arguments[0] if arguments else named["options"]
            run.add({each: each.of(options) for each in declared(type(options))})
            return task(*arguments, **named)

    return watched


@contextmanager
def watch_files(read: Iterable[Path] = ()) -> Iterator["Run"]:
    """Yield the run that keeps account of files during the block, the one around it if there is one.

    read: files that have been read for it before.
    """
    known = files.LEDGER.get()
    run = known if isinstance(known, Run) else Run()
    token, outer = files.LEDGER.set(run), KNOWN.get()
    own = KNOWN.set({} if outer is None else outer)
    if run is not known and outer is not None:  # a part of another run, perhaps of another process
        run.folders.shared = True
    try:
        for path in read:
            files.note_read(path)
        yield run
    finally:
        files.LEDGER.reset(token)
        if run is not known:
            run.close()
        KNOWN.reset(own)


def claim(outputs: Iterable[Path], *, elsewhere: bool = False) -> None:
    """Raise InvalidInput or FileError, before the work, if one of these outputs must not or cannot be written.

    They are listed in their folders from now on; a resumed run lists new ones only if other processes write them.
    """
    run = files.LEDGER.get()
    if isinstance(run, Run):
        run.claim(outputs, elsewhere=elsewhere)


@contextmanager
def owned(folder: Path) -> Iterator[None]:
    """Take all that the block writes below a folder, which something else marks as camcal's, as marked by that."""
    run = files.LEDGER.get()
    folders = run.owned if isinstance(run, Run) else []
    folders.append(folder.absolute())
    try:
        yield
    finally:
        folders.pop()


def overwrites() -> bool:
    """Return whether the run may replace files that camcal did not write."""
    run = files.LEDGER.get()
    return isinstance(run, Run) and run.overwrite


class Run:
    """The account of a run, which its threads share.

    read, written, replaced: files by device and number; to be replaced is what stands in the place of an output.
    sources: the paths of what was read. planned: outputs, and what was in their place (None: nothing). intact: those of
    them that are as camcal left them. shortened: those that are shorter than that, and may be the beginning of it.
    made: what was written. results: those of a whole run, which are listed. found_before: images that an earlier run
    has searched for this one. elsewhere: how many fan-outs a cluster has not finished; its workers may still write.
    """

    def __init__(self) -> None:
        self.overwrite = False
        self.resume = False
        self.read: set[FileId] = set()
        self.sources: set[Path] = set()
        self.written: set[FileId] = set()
        self.replaced: set[FileId] = set()
        self.planned: dict[Path, FileVersion | None] = {}
        self.named: set[Path] = set()
        self.unlisted: set[Path] = set()
        self.owned: list[Path] = []
        self.folders = OutputFolders()
        self.intact: dict[Path, Entry] = {}
        self.shortened: set[Path] = set()
        self.made: dict[Path, Entry] = {}
        self.results: dict[Path, Entry] = {}
        self.found_before = 0
        self.elsewhere = 0
        self._examined: set[Path] = set()
        self._unmade: set[Path] = set()
        self._lists: dict[Path, dict[str, Entry | None]] = {}
        self._has_options = False

    def add(self, values: Mapping[Declared, Any]) -> None:
        """Check what options read, and the outputs that they name against it; those of the first are the user's own.

        Raises InvalidInput or FileError.
        """
        given = {each.name for each, value in values.items() if value is True}
        self.overwrite |= "--overwrite" in given
        self.resume |= "--resume" in given
        for each, value in values.items():
            for path in inputs_of(each, value):
                files.note_read(path)
        outputs = [(each, path) for each, value in values.items() for path in outputs_of(each, value)]
        refuse_one_place(outputs)
        named = not self._has_options
        self._has_options = True
        for each, path in outputs:
            self._add_output(each, path, named)
        for path in (path for each, value in values.items() for path in inputs_of(each, value)):
            files.require_content(path)

    def _add_output(self, each: Declared, path: Path, named: bool) -> None:
        self._refuse_input(path)
        if is_folder(each, path):
            require_folder(path, each.name)
            self.folders.options[path] = each.name
            if not self.resume:  # where nothing is left to do, nothing is written
                require_writable(path / MANIFEST)
            return
        check = self.plan_named if named else self.plan
        check(path)

    def plan_named(self, path: Path) -> None:
        """Check an output whose name the user chose; see `plan`."""
        self.named.add(path.absolute())
        self.plan(path)

    def claim(self, outputs: Iterable[Path], *, elsewhere: bool) -> None:
        """Check outputs and list them in their folders; see the function of this name."""
        paths = [path for path in outputs if str(path) != files.STANDARD]
        self._hold_folders(paths)
        self._examine(paths)
        for path in paths:
            self.plan(path)
        self._list([path for path in paths if path.absolute() not in self.unlisted], elsewhere)

    def plan(self, path: Path) -> None:
        """Check an output; raises InvalidInput or FileError if it must not or cannot be written."""
        if str(path) == files.STANDARD:
            return
        place = path.absolute()
        with files.unwatched():
            if place in self.planned:
                return
            self._hold_folders([path])
            if any(folder in place.parents for folder in self.owned):
                self.unlisted.add(place)
            found = _status(path)
            if found is not None:
                self._require_replaceable(path, found)
            if found is None or (stat.S_ISREG(found.st_mode) and place not in self.intact):
                require_writable(path)
            self.planned[place] = found and _version(found)
            if found is not None:
                self.replaced.add(_id(found))

    def _hold_folders(self, paths: Iterable[Path]) -> None:
        """Keep other runs, until this one ends, from the output folders that some files go to; raises FileError."""
        if self.folders.hold_above(paths):
            self._lists.clear()  # another run may have written there since

    def _require_replaceable(self, path: Path, found: os.stat_result) -> None:
        if stat.S_ISDIR(found.st_mode):
            raise FileError("is a folder, not a file", where=str(path))
        self._refuse_input(path)
        if _id(found) in self.written or self.overwrite or not stat.S_ISREG(found.st_mode):
            return
        if path.absolute() not in self.unlisted and not self._is_own(path):
            raise changed(path) if self._is_listed(path) else _foreign(path, "was not written by camcal")

    def _refuse_input(self, path: Path) -> None:
        found = _status(path)
        if found is not None and _id(found) in self.read - self.written:
            raise _is_input(path)

    def _is_own(self, path: Path) -> bool:
        place = path.absolute()
        if place in self.named and says_camcal(path):
            return True
        self._examine([path])
        unknown = self._is_listed(path) and self._entry(path) is None
        return unknown or place in self.intact or place in self.shortened

    def known(self, path: Path) -> Entry | None:
        """Return what is known of an output that is as camcal left it, else None."""
        self._examine([path])
        return self.intact.get(path.absolute())

    def _examine(self, paths: Iterable[Path]) -> None:
        """Find out which of some outputs are as camcal left them, as far as that is known."""
        known = {path: entry for path in paths if (entry := self._entry(path)) and path.is_file()}
        new = [item for item in known.items() if item[0].absolute() not in self._examined]
        for (path, entry), is_intact in zip(new, fingerprint.unchanged(new), strict=True):
            place = path.absolute()
            self._examined.add(place)
            if is_intact:
                self.intact[place] = entry
            elif path.stat().st_size < entry.size and not self.overwrite:
                self.shortened.add(place)

    def reads(self, path: Path, file: os.stat_result) -> None:
        """Note a file that is read; raises InvalidInput if it is to be replaced."""
        if not stat.S_ISREG(file.st_mode) or _id(file) in self.written:
            return
        self.read.add(_id(file))
        self.sources.add(path.absolute())
        if _id(file) in self.replaced:
            raise _is_input(path)

    def writes(self, path: Path) -> None:
        """Raise InvalidInput or FileError if a file must not or cannot be written now."""
        self.plan(path)

    def completes(self, path: Path, temporary: Path) -> bool:
        """Note what is about to take the place of a file; return whether it does, not if a resumed run leaves it so."""
        place = path.absolute()
        if place in self.unlisted:
            return True
        made = self.made[place] = completed(path, temporary, shortened=place in self.shortened)
        if self.resume and path.is_file() and made.is_of(path):
            return False
        if place in self._unmade or self._entry(path) is not None:  # a kill is to leave no hash of the old file
            fingerprint.change(path.parent, {path.name: None})
        return True

    def wrote(self, file: os.stat_result) -> None:
        """Note a file that was written."""
        self.written.add(_id(file))

    def _list(self, paths: Sequence[Path], elsewhere: bool) -> None:
        """List outputs in their folders before they are written, so that a killed run leaves none unlisted.

        What is known of their contents is left out until they are written, or kept if they may stay as they are. A
        resumed run lists those that are not there once they are made: perhaps nothing is left to do.
        """
        folders: dict[Path, dict[str, Entry | None]] = {}
        for path in paths:
            place = path.absolute()
            if self.planned[place] is None and self.resume and not elsewhere:
                self._unmade.add(place)
            elif self.planned[place] is None or self._is_listed(path):  # others' files are not before they are replaced
                stays = place in self.shortened or (self.resume and place in self.intact)
                folders.setdefault(path.parent, {})[path.name] = self._entry(path) if stays else None
        for folder in {path.parent for path in paths}:
            self.folders.note_new(folder)
        for folder, names in folders.items():
            fingerprint.change(folder, names)
            self._lists.pop(folder.absolute(), None)

    def _entry(self, path: Path) -> Entry | None:
        return self._list_of(path).get(in_one_line(path.name))

    def _is_listed(self, path: Path) -> bool:
        return in_one_line(path.name) in self._list_of(path)

    def _list_of(self, path: Path) -> dict[str, Entry | None]:
        folder = path.absolute().parent
        if folder not in self._lists:
            self._lists[folder] = fingerprint.entries(folder)
        return self._lists[folder]

    def close(self) -> None:
        """Bring the lists of all folders up to date, and remove folders that were made for nothing."""
        self._lists.clear()
        folders: dict[Path, tuple[dict[str, Entry | None], set[str]]] = {}
        for path in self.planned.keys() - self.unlisted:
            if self.elsewhere and not path.exists():  # it stays listed, for it may still come
                continue
            added, removed = folders.setdefault(path.parent, ({}, set()))
            if path in self.results:
                added[path.name] = self.results[path]
            elif self._has_to_be_listed(path):
                added[path.name] = self.made.get(path) or self._entry_now(path)
            else:
                removed.add(path.name)
        for folder, (added, removed) in folders.items():
            if folder.is_dir() and (added or (folder / MANIFEST).is_file()):
                with suppress(FileError):  # a folder that became read-only; what was written is there
                    fingerprint.change(folder, added, removed)
        self.folders.close()

    def _has_to_be_listed(self, path: Path) -> bool:
        """Return whether an output is there, new or camcal's before, and carries no mark of its own that would do."""
        found, before = _status(path), self.planned[path]
        if found is None or not stat.S_ISREG(found.st_mode):
            return False
        if before == _version(found):
            return self._is_listed(path)
        return path not in self.named or not says_camcal(path)

    def _entry_now(self, path: Path) -> Entry | None:
        """Return what is known of a file; one that another process has written for this run is read for it."""
        known, now = self._entry(path), _status(path)
        is_new = known is None and now is not None and self.planned[path] != _version(now)
        return Entry.of(path) if is_new else known


def says_camcal(path: Path) -> bool:
    """Return whether the beginning of a file has the mark of camcal."""
    try:
        with files.unwatched(), files.opened(path) as stream:
            return _MARK.search(stream.read(_HEAD)) is not None
    except FileError:
        return False


def listed(folder: Path) -> AbstractSet[str]:
    """Return the names of the files in a folder that are listed as written by camcal."""
    return fingerprint.entries(folder).keys()


def completed(path: Path, temporary: Path, *, shortened: bool) -> Entry:
    """Return the entry of a file that is about to take the place of another one.

    Raises InvalidInput if the other one, which is shorter than it was written, is not the beginning of it.
    """
    if shortened and path.is_file() and not fingerprint.begins_with(temporary, path):
        raise changed(path)
    return Entry.of(temporary)


def changed(path: Path) -> InvalidInput:
    """Return the error of an output that is no longer what camcal wrote."""
    return _foreign(path, "was changed after camcal wrote it")


def _foreign(path: Path, why: str) -> InvalidInput:
    return InvalidInput(f"exists and {why}; use --overwrite or another output", where=str(path))


def _status(path: Path) -> os.stat_result | None:
    """Return what is known of a file, None if there is none; raises FileError for a path that cannot be one."""
    try:
        return path.stat()
    except (FileNotFoundError, NotADirectoryError):
        return None
    except OSError as error:
        raise FileError(f"cannot be written: {reason(error)}", where=str(path)) from error


def _version(file: os.stat_result) -> FileVersion:
    return _id(file), file.st_mtime_ns


def _id(file: os.stat_result) -> FileId:
    return file.st_dev, file.st_ino


def _is_input(path: Path) -> InvalidInput:
    return InvalidInput("is an input and is not overwritten; choose another output", where=str(path))
