"""Runs with one result of many inputs that need not be repeated: inputs, settings and outputs are as they were.

What a run with --resume was made from is kept in the list of the folder of its result (see `manifest`), with its other
files and what it printed as JSON.
"""

import glob
import json
import os
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from camcal import files, urls
from camcal.errors import FileError, in_one_line
from camcal.options import declared
from camcal.progress import values_of
from camcal.run import fingerprint, manifest
from camcal.run.fanout import fan_out
from camcal.run.manifest import Entry
from camcal.run.option_paths import inputs_of, outputs_of
from camcal.run.outputs import Run, listed


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
            asked = _asked_for(options, output)
            self.made_from = fingerprint.of_data([command, fingerprint.of_settings(options), asked, named])

    def document(self) -> dict[str, Any] | None:
        """Return what the run printed as JSON, None if it has to be done."""
        known = manifest.entries(self.output.parent).get(in_one_line(self.output.name))
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


def _asked_for(options: Any, output: Path) -> dict[str, list[str]]:
    """Return the options that count beside the settings: the other files that are written, and checks of the result."""
    known = [each for each in declared(type(options)) if fingerprint.counts(each) and not each.option.recorded]
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
