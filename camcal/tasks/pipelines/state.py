"""The state of a pipeline: what its steps were made from when they last succeeded, and why one has to run again.

Contents count, never times: a step is up to date if its options, the versions of camcal and its libraries, the
contents of all files that it read and of all that it wrote are those of the last time.
"""

import glob
import json
import time
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import camcal
from camcal import files, urls
from camcal.dataclass import dataclass, field
from camcal.errors import CamcalError, FileError
from camcal.formats import documents
from camcal.messages import Message, as_data, counted
from camcal.options import declared
from camcal.parsing import in_one_line
from camcal.progress import SILENT, Progress
from camcal.run import fingerprint
from camcal.run.fanout import fan_out
from camcal.run.outputs import listed, says_camcal
from camcal.tasks.pipelines.step import Figure, Step, StepResult, below_here, name_of

FORMAT = "camcal/run-state/1"
MISSING = ""  # in the place of the hash of a file that is not there

_VERSIONS = {"created": "SOURCE_DATE_EPOCH"}  # what a user calls them, where that is another name
_PACKAGE = Path(camcal.__file__).parent
_WRITE_S = 1.0  # at least between two writings of a state: with many steps it is large
_FEW = 64  # files that are hashed without threads


@dataclass(frozen=True)
class StepRecord:
    """What a step was made from when it last succeeded, and what came of it.

    settings: words by option. inputs, outputs: hashes by path, relative to the folder of the pipeline.
    """

    command: str
    settings: Mapping[str, list[str]]
    versions: Mapping[str, str]
    inputs: Mapping[str, str]
    outputs: Mapping[str, str]
    figures: Mapping[str, Figure] = field(default_factory=dict)
    warnings: list[dict[str, Any]] = field(default_factory=list)
    failures: list[dict[str, Any]] = field(default_factory=list)

    @property
    def result(self) -> StepResult:
        """What came of the step."""
        warnings, failures = (
            tuple(Message(each["code"], each["text"], each["values"], each["where"]) for each in found)
            for found in (self.warnings, self.failures)
        )
        return StepResult(self.figures, warnings, failures, outputs=tuple(map(_path_of, self.outputs)))


class Hashes:
    """The hashes of files, each made once while size and time of the file stay the same."""

    def __init__(self) -> None:
        self.known: dict[Path, tuple[tuple[int, int, int], str]] = {}

    def of(self, paths: Iterable[Path], progress: Progress = SILENT) -> dict[str, str]:
        """Return the hash of every file by its name; MISSING for one that cannot be read."""
        stamps = {path: _stamp(path) for path in paths}
        new = [path for path, stamp in stamps.items() if stamp and not self._is_known(path, stamp)]
        work = fan_out(
            fingerprint.of_file, new, jobs=1 if len(new) < _FEW else None, what="comparing", progress=progress
        )
        with urls.item():
            for outcome in work:
                if (stamp := stamps[outcome.item]) is not None and outcome.value is not None:
                    self.known[outcome.item] = stamp, outcome.value
        return {
            name_of(path): self.known[path][1] if stamp and path in self.known else MISSING
            for path, stamp in stamps.items()
        }

    def _is_known(self, path: Path, stamp: tuple[int, int, int]) -> bool:
        return urls.holder(path) is None and path in self.known and self.known[path][0] == stamp


def _stamp(path: Path) -> tuple[int, int, int] | None:
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_size, found.st_mtime_ns, found.st_ino


class State:
    """The records of all steps, and the file that keeps them."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.hashes = Hashes()
        self.versions = fingerprint.versions()
        self._text = files.read_text(path) if path.exists() else ""
        self._written = float("-inf")
        self.records = _records(self._text, path) if self._text else {}

    def keep(self, step: Step, result: StepResult, inputs: Iterable[Path]) -> None:
        """Record a step that succeeded; inputs: files that its options stand for."""
        outputs = {below_here(path) for path in result.outputs}
        read = {below_here(path) for path in (*result.inputs, *inputs) if not path.is_relative_to(_PACKAGE)} - outputs
        self.records[step.name] = StepRecord(
            step.command,
            step.settings,
            self.versions,
            self.hashes.of(sorted(path for path in read if path.is_file())),
            self.hashes.of(sorted(outputs)),
            result.figures,
            as_data(result.warnings),
            as_data(result.failures),
        )

    def left_by(self, step: Step, result: StepResult) -> list[str]:
        """Return the files of the last run of a step that are still there, and of which this one knows nothing."""
        record = self.records.get(step.name)
        written = {name_of(path) for path in result.outputs}
        return [name for name in record.outputs if name not in written and _path_of(name).exists()] if record else []

    def forget(self, name: str) -> None:
        """Drop the record of a step."""
        self.records.pop(name, None)

    def write_soon(self) -> None:
        """Write the records, unless that was done just before."""
        if time.monotonic() - self._written > _WRITE_S:
            self.write()

    def write(self) -> None:
        """Write the records if they changed, in the order of their names, on one line each."""
        texts = {name: json.dumps(asdict(record), sort_keys=True) for name, record in sorted(self.records.items())}
        lines = [f"{json.dumps(name)}: {text}" for name, text in texts.items()]
        steps = ",\n".join(lines)
        if (text := f'{{"format": "{FORMAT}", "steps": {{\n{steps}\n}}}}\n') != self._text:
            files.write_text(self.path, text)
        self._text, self._written = text, time.monotonic()

    def reason_to_run(self, step: Step, inputs: Iterable[Path], progress: Progress = SILENT) -> str | None:
        """Return why a step has to run, None if it is up to date; inputs: files that its options stand for."""
        record = self.records.get(step.name)
        if record is None:
            return "has not succeeded before"
        if record.command != step.command:
            return f"command changed from {record.command} to {step.command}"
        if keys := _different(record.settings, step.settings):
            arguments = {each.key for each in declared(step.record) if each.positional}
            return f"{_and_more(['arguments' if key in arguments else key for key in keys])} changed"
        if names := _different(record.versions, self.versions):
            before, now = (found.get(names[0], "none") for found in (record.versions, self.versions))
            return f"{_VERSIONS.get(names[0], names[0])} is {now}, was {before}"
        return self._changed_file(record, inputs, progress)

    def _changed_file(self, record: StepRecord, inputs: Iterable[Path], progress: Progress) -> str | None:
        now = {name_of(path): path for path in inputs}
        now |= {name: _path_of(name) for name in record.inputs if name not in now}
        found = self.hashes.of(sorted(now.values()), progress)
        paths = [path for path, content in found.items() if record.inputs.get(path, MISSING) != content]
        if paths:
            kind = "new" if paths[0] not in record.inputs else "gone" if found[paths[0]] == MISSING else "changed"
            return f"{_and_more(paths, 'file')} {kind}"
        found = self.hashes.of(map(_path_of, record.outputs), progress)
        paths = [path for path, content in record.outputs.items() if found[path] != content]
        if paths:
            return f"{_and_more(paths, 'file')} {'missing' if found[paths[0]] == MISSING else 'changed'}"
        return None


def _records(text: str, path: Path) -> dict[str, StepRecord]:
    """Return the records in a state file, none if it was damaged; raises FileError if it is of something else."""
    try:
        data = documents.parse_json(text, str(path))
        return {name: StepRecord(**record) for name, record in data["steps"].items()}
    except (CamcalError, AttributeError, KeyError, TypeError) as error:
        if says_camcal(path):
            return {}
        raise FileError(
            "is not the state of a pipeline; move it, or choose another --state", where=str(path)
        ) from error


def _path_of(name: str) -> Path:
    """Return the path of a file by its name in the state."""
    if "://" not in name:
        return Path(name)
    from camcal.run import remote

    return Path(remote.given(name))


def _different(before: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    return [key for key in (*now, *before) if before.get(key) != now.get(key)]


def _and_more(names: list[str], noun: str = "") -> str:
    first = in_one_line(names[0])
    if len(set(names)) == 1:
        return first
    more = counted(len(set(names)) - 1, f"other {noun}") if noun else str(len(set(names)) - 1)
    return f"{first} and {more}"


def files_of(step: Step) -> list[Path]:
    """Return the files that the options of a step stand for: those that they name, and those in folders and patterns.

    Hidden files are left out.
    """
    return list(dict.fromkeys(path for given in step.inputs for path in _standing_for(given)))


def _standing_for(given: Path) -> Iterator[Path]:
    try:
        if given.is_file():
            yield given
        elif given.is_dir():
            yield from _inside(given)
        elif glob.has_magic(str(given)):
            matches = glob.glob(str(given), recursive=True)  # noqa: PTH207 - of absolute patterns too
            yield from (path for path in map(Path, sorted(matches)) if path.is_file())
    except OSError:  # a text that is too long for a path
        return


def _inside(folder: Path) -> Iterator[Path]:
    """Yield the files below a folder, without those that camcal wrote beside others."""
    shown = sorted(path for path in folder.iterdir() if not path.name.startswith("."))
    written = listed(folder)
    found = [path for path in shown if path.is_file()]
    yield from [path for path in found if in_one_line(path.name) not in written] or found
    for path in shown:
        if path.is_dir() and not path.is_symlink():
            yield from _inside(path)
