"""What a run reads and writes: no input is overwritten, nor what others wrote, and what camcal wrote carries its mark.

The one rule for all commands. What is read: every file that the options name, the images that folders and patterns
stand for, and whatever is opened on the way, such as the covariance beside a camera file. What is written: the
outputs that the options name, those that a task claims before its work, and whatever else is written; none of it may
be a file that is read, by whatever name, link or address.

A file that is there already is replaced if camcal wrote it: one that the user names, if it says so itself (the comment
or the format of a text, `camcal` in its provenance); any file, if it is listed in `.camcal-output` of its folder, one
name per line. Files without a mark of their own are listed there, and those whose names the user did not choose.
"""

import os
import re
import stat
from collections.abc import Callable, Iterable, Iterator, Mapping
from collections.abc import Set as AbstractSet
from contextlib import contextmanager, suppress
from functools import wraps
from itertools import combinations
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

from camcal import files, system
from camcal.errors import FileError, InvalidInput, in_one_line, reason
from camcal.files import STANDARD
from camcal.options import GENERAL, OUTPUT, Declared, declared

OUTPUT_INDEX = ".camcal-output"

_HEAD = 4096  # bytes in which a text says who wrote it
_MARK = re.compile(rb'\A(?:%YAML[^\n]*\n---\n)?# (?:[^\n]*\b)?camcal\b|"(?:format|schema|tool)": "camcal\b')

P = ParamSpec("P")
R = TypeVar("R")
FileId = tuple[int, int]


def writes(task: Callable[P, R]) -> Callable[P, R]:
    """Return a task whose first argument, its options, says what is read and written: the rule holds while it runs.

    The paths of its options are checked before its work; raises InvalidInput or FileError if the rule is broken.
    """

    @wraps(task)
    def watched(*arguments: P.args, **named: P.kwargs) -> R:
        with watching() as run:
            options: Any = arguments[0] if arguments else named["options"]
            run.add({each: each.of(options) for each in declared(type(options))})
            return task(*arguments, **named)

    return watched


@contextmanager
def watching(read: Iterable[Path] = ()) -> Iterator["Run"]:
    """Yield the run that keeps account of files during the block, the one around it if there is one.

    read: files that have been read for it before.
    """
    known = files.LEDGER.get()
    run = known if isinstance(known, Run) else Run()
    token = files.LEDGER.set(run)
    try:
        for path in read:
            files.note_read(path)
        yield run
    finally:
        files.LEDGER.reset(token)
        if run is not known:
            run.close()


def claim(outputs: Iterable[Path]) -> None:
    """Raise InvalidInput or FileError, before the work, if one of these outputs must not or cannot be written.

    They are listed in their folders from now on.
    """
    run = files.LEDGER.get()
    if isinstance(run, Run):
        run.claim(outputs)


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
    planned: outputs, and the file that was in their place (None: none).
    """

    def __init__(self) -> None:
        self.overwrite = False
        self.read: set[FileId] = set()
        self.written: set[FileId] = set()
        self.replaced: set[FileId] = set()
        self.planned: dict[Path, os.stat_result | None] = {}
        self.named: set[Path] = set()
        self.unlisted: set[Path] = set()
        self.owned: list[Path] = []
        self.new_folders: list[Path] = []
        self._lists: dict[Path, set[str]] = {}
        self._has_options = False

    def add(self, values: Mapping[Declared, Any]) -> None:
        """Check what options read, and the outputs that they name against it; those of the first are the user's own.

        Raises InvalidInput or FileError.
        """
        self.overwrite |= any(value is True for each, value in values.items() if each.name == "--overwrite")
        for each, value in values.items():
            for path in inputs_of(each, value):
                files.note_read(path)
        outputs = [(each, path) for each, value in values.items() for path in outputs_of(each, value)]
        _refuse_one_place(outputs)
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
            _require_writable(path / OUTPUT_INDEX)
            return
        if named:
            self.plan_named(path)
        else:
            self.plan(path)

    def plan_named(self, path: Path) -> None:
        """Check an output whose name the user chose; see `plan`."""
        self.named.add(path.absolute())
        self.plan(path)

    def claim(self, outputs: Iterable[Path]) -> None:
        """Check outputs and list them in their folders; see the function of this name."""
        paths = [path for path in outputs if str(path) != STANDARD]
        for path in paths:
            self.plan(path)
        self._list(path for path in paths if path.absolute() not in self.unlisted)

    def plan(self, path: Path) -> None:
        """Check an output; raises InvalidInput or FileError if it must not or cannot be written."""
        if str(path) == STANDARD:
            return
        place = path.absolute()
        with files.unwatched():
            if place in self.planned:
                return
            if any(folder in place.parents for folder in self.owned):
                self.unlisted.add(place)
            found = _status(path)
            if found is not None:
                self._require_replaceable(path, found)
            if found is None or stat.S_ISREG(found.st_mode):
                _require_writable(path)
            self.planned[place] = found
            if found is not None:
                self.replaced.add(_id(found))

    def _require_replaceable(self, path: Path, found: os.stat_result) -> None:
        if stat.S_ISDIR(found.st_mode):
            raise FileError("is a folder, not a file", where=str(path))
        self._refuse_input(path)
        if _id(found) in self.written or self.overwrite or not stat.S_ISREG(found.st_mode):
            return
        if path.absolute() not in self.unlisted and not self._is_own(path):
            raise InvalidInput(
                "exists and was not written by camcal; use --overwrite or another output", where=str(path)
            )

    def _refuse_input(self, path: Path) -> None:
        found = _status(path)
        if found is not None and _id(found) in self.read - self.written:
            raise _is_input(path)

    def _is_own(self, path: Path) -> bool:
        return self._is_listed(path) or (path.absolute() in self.named and says_camcal(path))

    def reads(self, path: Path, file: os.stat_result) -> None:
        """Note a file that is read; raises InvalidInput if it is to be replaced."""
        if not stat.S_ISREG(file.st_mode):
            return
        if _id(file) in self.written:
            return
        self.read.add(_id(file))
        if _id(file) in self.replaced:
            raise _is_input(path)

    def writes(self, path: Path) -> None:
        """Raise InvalidInput or FileError if a file must not or cannot be written now."""
        self.plan(path)

    def wrote(self, file: os.stat_result) -> None:
        """Note a file that was written."""
        self.written.add(_id(file))

    def _list(self, paths: Iterable[Path]) -> None:
        """List outputs in their folders before they are written, so that a killed run leaves none unlisted."""
        folders: dict[Path, set[str]] = {}
        for path in paths:
            found = self.planned[path.absolute()]
            if found is None or self._is_listed(path):  # what others wrote is not listed before it is replaced
                folders.setdefault(path.parent, set()).add(path.name)
        for folder, names in folders.items():
            self.new_folders += [each for each in (folder, *folder.parents) if not each.exists()]
            change_list(folder, names, set())
            self._lists.pop(folder.absolute(), None)

    def _is_listed(self, path: Path) -> bool:
        folder = path.absolute().parent
        if folder not in self._lists:
            self._lists[folder] = listed(folder)
        return in_one_line(path.name) in self._lists[folder]

    def close(self) -> None:
        """Bring the lists of all folders up to date, and remove folders that were made for nothing."""
        folders: dict[Path, tuple[set[str], set[str]]] = {}
        for path in self.planned.keys() - self.unlisted:
            added, removed = folders.setdefault(path.parent, (set(), set()))
            (added if self._has_to_be_listed(path) else removed).add(path.name)
        for folder, (added, removed) in folders.items():
            known = listed(folder)
            if folder.is_dir() and (not added <= known or removed & known):
                with suppress(FileError):  # a folder that became read-only; what was written is there
                    change_list(folder, added, removed)
        for folder in sorted(self.new_folders, key=lambda each: len(each.parts), reverse=True):
            with suppress(OSError):  # something is in it
                folder.rmdir()

    def _has_to_be_listed(self, path: Path) -> bool:
        """Return whether an output is there, new or camcal's before, and carries no mark of its own that would do."""
        found, before = _status(path), self.planned[path]
        if found is None or not stat.S_ISREG(found.st_mode):
            return False
        kept = before is not None and (_id(found), found.st_mtime_ns) == (_id(before), before.st_mtime_ns)
        return self._is_listed(path) if kept else path not in self.named or not says_camcal(path)


def inputs_of(each: Declared, value: Any) -> list[Path]:
    """Return the paths that the value of an option may name as what is read: any text that is no output may.

    That of FILE#NAME and of NAME=FILE is among them.
    """
    if each.option.choices or each.option.group in (OUTPUT, GENERAL):
        return []
    items = value if isinstance(value, tuple) else (value,)
    given = [str(item) for item in items if isinstance(item, str | Path)]
    texts = [text for one in given for text in (one, one.partition("=")[2])]
    return [Path(path) for text in texts for path in (text, text.rpartition("#")[0]) if path]


def outputs_of(each: Declared, value: Any) -> list[Path]:
    """Return the paths that the value of an option names as what is written."""
    written = each.option.written
    if written is None or value is None:
        return []
    return [Path(text) for text in each.texts(value) if text not in written.words]


def is_folder(each: Declared, path: Path) -> bool:
    """Return whether an output is a folder; raises InvalidInput for a file that the option does not write."""
    written = each.option.written
    assert written is not None
    suffix, known = path.suffix.lower(), written.known
    if str(path) == STANDARD:
        if not written.stdout:
            raise InvalidInput(f"{each.name} does not write to standard output; name a file")
        return False
    if files.is_stream(path):
        return False
    if written.folder and (path.is_dir() or not suffix or not known):
        if path.name.lower() in known and not path.is_dir():
            raise InvalidInput(f"is a suffix without a name; write NAME{path.name}, or a folder", where=str(path))
        return True
    if suffix in known or not known:
        return False
    listed_suffixes = ", ".join(name for name in known if name)
    raise InvalidInput(f"{suffix or 'a name without a suffix'} is not written; use {listed_suffixes}", where=str(path))


def require_folder(path: Path, option: str) -> None:
    """Raise InvalidInput, naming the option, if files cannot go to this folder because it is a file."""
    if path.exists() and not path.is_dir():
        raise InvalidInput(f"{option} takes a folder, this is a file", where=str(path))


def says_camcal(path: Path) -> bool:
    """Return whether the beginning of a file has the mark of camcal."""
    try:
        with files.unwatched(), files.opened(path) as stream:
            return _MARK.search(stream.read(_HEAD)) is not None
    except FileError:
        return False


def listed(folder: Path) -> set[str]:
    """Return the names of the files in a folder that are listed as written by camcal."""
    index = folder / OUTPUT_INDEX
    with files.unwatched():
        return set(os.fsdecode(files.read_bytes(index)).split("\n")) - {""} if index.is_file() else set()


def change_list(folder: Path, added: AbstractSet[str], removed: AbstractSet[str]) -> None:
    """Add file names to the list of what camcal wrote into a folder and remove others; runs at once lose none."""
    index = folder / OUTPUT_INDEX
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with system.locked(folder), files.unwatched():
            known = (listed(folder) | set(map(in_one_line, added))) - set(map(in_one_line, removed))
            if known:
                lines = "".join(f"{name}\n" for name in sorted(known, key=files.natural_key))
                files.write_bytes(index, os.fsencode(lines))  # a file name need not be UTF-8
            else:
                index.unlink(missing_ok=True)
    except OSError as error:
        raise FileError(f"cannot be written: {reason(error)}", where=str(index)) from error


def _refuse_one_place(outputs: Iterable[tuple[Declared, Path]]) -> None:
    for (one, path), (other, same) in combinations(outputs, 2):
        if system.place_of(path) == system.place_of(same) and str(path) != os.devnull:
            raise InvalidInput(f"{one.name} and {other.name} would both be written to it", where=str(path))


def _require_writable(path: Path) -> None:
    """Raise FileError if a file cannot be made in its folder, or the folder cannot."""
    folder = path.parent
    while not os.path.lexists(folder) and folder.parent != folder:
        folder = folder.parent
    if not folder.is_dir():
        raise FileError(f"cannot be written: {folder} is not a folder", where=str(path))
    if not os.access(folder, os.W_OK | os.X_OK):
        raise FileError(f"cannot be written: no permission to write into {folder.absolute()}", where=str(path))


def _status(path: Path) -> os.stat_result | None:
    """Return what is known of a file, None if there is none; raises FileError for a path that cannot be one."""
    try:
        return path.stat()
    except (FileNotFoundError, NotADirectoryError):
        return None
    except OSError as error:
        raise FileError(f"cannot be written: {reason(error)}", where=str(path)) from error


def _id(file: os.stat_result) -> FileId:
    return file.st_dev, file.st_ino


def _is_input(path: Path) -> InvalidInput:
    return InvalidInput("is an input and is not overwritten; choose another output", where=str(path))
