"""Commands with one result of many inputs: what --resume need not do again of them.

While it works such a command leaves a journal beside its output: a line for each image, with the fingerprint of what
was looked at and what was found as JSON. A run that is killed, or for which images failed, leaves it behind, and the
next one with --resume does not look at the same images again.
When it has ended, what its result was made from is kept in the list of the folder (see `fingerprint`), with its other
files and what it printed as JSON: a run whose inputs, settings and outputs are as they were need not be repeated.
"""

import glob
import json
import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from pathlib import Path
from typing import Any

from camcal import files, system, urls
from camcal.errors import CamcalError, FileError, reason
from camcal.options import declared
from camcal.parsing import in_one_line
from camcal.progress import SILENT, Item, Outcome, Progress, Value, values_of
from camcal.run import fingerprint
from camcal.run.fanout import fan_out
from camcal.run.fingerprint import Entry
from camcal.run.options import DEFAULT_BATCH, BatchOptions, counts, inputs_of, outputs_of
from camcal.run.outputs import Run, listed
from camcal.run.resume import Items, MadeItem, Recording, Store, remembering

_JOURNAL: ContextVar["Journal | None"] = ContextVar("journal", default=None)


def path_beside(output: Path) -> Path:
    """Return where the journal of an output stands."""
    return output.with_name(f".{output.name}.camcal-journal")


def resume_hint(output: Path | None) -> str:
    """Return what to add to the error of a run that has left its journal, nothing if it has not."""
    left = output is not None and path_beside(output).is_file()
    return "; with --resume the others are not searched again" if left else ""


class Journal:
    """The lines of a journal, those of earlier runs among them. has_failures: images failed, which may be repaired."""

    def __init__(self, path: Path, *, resume: bool) -> None:
        self.path = path
        self.has_failures = False
        self.known = dict(_lines(path)) if resume else {}
        if not resume:
            self.remove()

    def add(self, fingerprint: str, data: Any) -> None:
        """Add a line; raises FileError if it cannot be written."""
        line = f"{fingerprint}\t{urls.named(json.dumps(data, separators=(',', ':')))}\n"
        try:
            system.prepare(self.path.parent)
            urls.append(self.path, f"\n{line}".encode())  # after what a killed run or a full disk left of a line
        except OSError as error:
            raise FileError(f"cannot be written: {reason(error)}", where=str(self.path)) from error

    def leave(self) -> None:
        """Leave the file for another run."""
        with suppress(FileError):  # at a URL that is not reached; the images would only be searched again
            urls.flush(self.path)

    def remove(self) -> None:
        """Remove the file, if there is one."""
        with suppress(OSError, FileError):  # of a folder that cannot be written; the next run is not worse off
            system.require_same(self.path.parent)
            urls.remove(self.path)


def _lines(path: Path) -> Iterator[tuple[str, str]]:
    """Yield fingerprints and what was found; a line that was not finished is none."""
    with suppress(FileError), files.unwatched(), files.opened(path) as stream:
        for line in stream:
            fingerprint, tab, data = line.decode("ascii", "replace").partition("\t")
            if tab and data.endswith("\n"):
                yield fingerprint, data


@contextmanager
def journal_beside(output: Path | None, batch: BatchOptions) -> Iterator[None]:
    """Keep a journal beside an output during the block, which writes it; within another block that one's is kept.

    It stays behind if the block is ended from outside, or where it is of use: a disk that is full, an image that fails.
    """
    if output is None or _JOURNAL.get() is not None or files.is_stream(output):
        yield
        return
    kept = Journal(path_beside(output), resume=batch.resume)
    token = _JOURNAL.set(kept)
    stays = True
    try:
        yield
        stays = kept.has_failures
    except CamcalError as error:
        stays = kept.has_failures or isinstance(error, FileError)
        raise
    finally:
        if stays:
            kept.leave()
        else:
            kept.remove()
        _JOURNAL.reset(token)


def journaled(
    function: Callable[[Item], Value],
    every: Iterable[Item],
    items: Items[Item, Value],
    *,
    jobs: int | None = None,
    batch: BatchOptions = DEFAULT_BATCH,
    what: str = "",
    progress: Progress = SILENT,
    timeout: float | None = None,
) -> Iterator[Outcome[Item, Value]]:
    """Return an iterator with one Outcome per item from worker processes; what is in the journal is not done again."""
    kept = _JOURNAL.get()
    if kept is None:
        return fan_out(
            function, every, jobs=jobs, batch=batch, processes=True, what=what, progress=progress, timeout=timeout
        )
    recording = Recording(function, items)

    def fan(left: Iterable[Item]) -> Iterator[Outcome[Item, MadeItem[Value]]]:
        return fan_out(
            recording, left, jobs=jobs, batch=batch, processes=True, what=what, progress=progress, timeout=timeout
        )

    outcomes = remembering(JournalStore(kept, items), every, fan, jobs=jobs, batch=batch, progress=progress)
    return _note_failures(kept, outcomes)


def _note_failures(kept: Journal, outcomes: Iterable[Outcome[Item, Value]]) -> Iterator[Outcome[Item, Value]]:
    """Yield outcomes, and let the journal know of those that have failed."""
    for outcome in outcomes:
        kept.has_failures |= outcome.error is not None
        yield outcome


class JournalStore(Store[Item, Value]):
    """What was found in images as a journal knows it."""

    def __init__(self, kept: Journal, items: Items[Item, Value]) -> None:
        super().__init__(items)
        self.kept = kept

    def holds(self, item: Item) -> bool:  # noqa: ARG002 - only its fingerprint tells
        return bool(self.kept.known)

    def reuse(self, item: Item, fingerprint_now: str) -> Outcome[Item, Value] | None:
        data = self.kept.known.get(fingerprint_now)
        if data is not None:
            with suppress(KeyError, IndexError, TypeError, ValueError, CamcalError):  # changed by hand
                value = fingerprint.value_of_plain(self.items.result, json.loads(urls.standing(data)))
                run = files.LEDGER.get()
                if isinstance(run, Run):
                    run.found_before += 1
                return Outcome(item, value, reused=True)
        return None

    def record(self, item: Item, made: MadeItem[Value]) -> None:  # noqa: ARG002 - see `holds`
        with suppress(FileError):  # it would only be found again
            self.kept.add(made.made_from, fingerprint.as_plain(made.value))


class Finished:
    """A run of a command with these options, whose result goes to `output`; inputs are read when this is made.

    inputs: how many files that is. made_from: the fingerprint of the run, None if one of them cannot be read: the run
    then says so itself.
    """

    def __init__(self, command: str, options: Any, output: Path) -> None:
        self.output = output
        paths = sorted(set(_inputs(options)))
        self.inputs = len(paths)
        self.made_from: str | None = None
        with files.unwatched(), suppress(FileError):
            hashes = values_of(fan_out(fingerprint.of_file, paths))
            named = [[path.as_posix(), each] for path, each in zip(paths, hashes, strict=True)]
            asked = _other_options(options, output)
            self.made_from = fingerprint.of_data([command, fingerprint.of_settings(options), asked, named])

    def document(self) -> dict[str, Any] | None:
        """Return what the run printed as JSON, None if it has to be done."""
        known = fingerprint.entries(self.output.parent).get(in_one_line(self.output.name))
        if known is None or known.made_from != self.made_from:
            return None
        with suppress(KeyError, TypeError, ValueError, OSError, FileError):  # a list that was changed by hand
            kept = json.loads(known.result)
            entries = {self.output.parent / name: Entry(*entry) for name, entry in kept["files"].items()}
            if all(entry.is_of(path) for path, entry in entries.items()):
                return dict(kept["document"])
        return None

    def keep(self, document: Mapping[str, Any]) -> None:
        """Keep what the run has printed, and its files."""
        run = files.LEDGER.get()
        if not isinstance(run, Run) or not self.output.is_file() or self.made_from is None:
            return
        folder = self.output.absolute().parent
        made = {path: Entry.of(path) for path in sorted(run.planned) if path.is_file()}
        names = {Path(os.path.relpath(path, folder)).as_posix(): entry[:2] for path, entry in made.items()}
        result = urls.named(json.dumps({"files": names, "document": document}, separators=(",", ":")))
        own = made[self.output.absolute()]
        run.results[self.output.absolute()] = own._replace(made_from=self.made_from, result=result)


def _other_options(options: Any, output: Path) -> dict[str, list[str]]:
    """Return the options that count beside the settings: the other files that are written, and checks of the result."""
    known = [each for each in declared(type(options)) if counts(each) and not each.option.recorded]
    values = [(each, each.of(options)) for each in known]
    return {each.key: each.words(value) for each, value in values if value is not None and value != output}


def _inputs(options: Any) -> Iterator[Path]:
    """Yield the files that options stand for: all files of folders, those left out that are hidden or outputs."""
    values = [(each, each.of(options)) for each in declared(type(options))]
    recursive = any(value is True for each, value in values if each.name == "--recursive")
    own = {path.absolute() for each, value in values for path in outputs_of(each, value)}
    for path in (path for each, value in values if value is not None for path in inputs_of(each, value)):
        for found in _files_of(path, recursive):
            if found.absolute() not in own:
                yield found


def _files_of(path: Path, recursive: bool) -> Iterator[Path]:
    with suppress(OSError):  # a text that is too long for a path
        if path.is_file():
            yield path
        elif path.is_dir():
            inside = path.rglob("*") if recursive else path.iterdir()
            yield from (each for each in inside if each.is_file() and _counts(each))
        elif glob.has_magic(str(path)):
            matching = map(Path, glob.glob(str(path), recursive=True))  # noqa: PTH207 - Path.glob refuses some patterns
            yield from (each for each in matching if each.is_file())


def _counts(path: Path) -> bool:
    return not path.name.startswith(".") and in_one_line(path.name) not in listed(path.parent)
