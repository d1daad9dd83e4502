"""Batches that can be resumed: what items made is recorded as they are completed, and skipped if it still matches.

An item is made from the contents of its inputs and from the settings of the command; its outputs are complete if all
of them are as camcal left them. Both are compared by hashes. Input is hashed before it is read: if it changes while it
is read, the next run makes the item again.
"""

import json
import os
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from collections.abc import Set as AbstractSet
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, Generic

from camcal import files
from camcal.errors import FileError
from camcal.files import Ledger
from camcal.progress import SILENT, Item, Outcome, Progress, Value
from camcal.run import fingerprint, manifest, records
from camcal.run.fanout import fan_out, only_outcome
from camcal.run.manifest import Entry
from camcal.run.options import DEFAULT_BATCH, BatchOptions
from camcal.run.outputs import Run, completed

CHECKING = "comparing with the last run"


def _no_paths(_item: Any) -> tuple[Path, ...]:
    return ()


@dataclass(frozen=True)
class Items(Generic[Item, Value]):
    """What the items of a batch are made from, and what comes of them.

    settings: see `fingerprint.of_settings`. inputs: of an item, its files, and texts that count as they are, such as
    a hash that is known already. outputs: all files that may be written of it, the one that is always written first;
    they are claimed before. result: the type of what the function returns, whose paths are among these files, or those
    that `named` gives.
    """

    settings: str
    inputs: Callable[[Item], Sequence[Path | str]]
    outputs: Callable[[Item], Sequence[Path]]
    result: Any
    named: Callable[[Item], Sequence[Path]] = _no_paths

    def made_from(self, item: Item) -> str:
        """Return the fingerprint of an item; raises FileError if an input cannot be read."""
        return made_from(self.settings, self.inputs(item))

    def paths(self, item: Item) -> list[Path]:
        """Return the files that the result of an item may name."""
        read = [each for each in self.inputs(item) if isinstance(each, Path)]
        return [*read, *self.outputs(item), *self.named(item)]


def made_from(settings: str, inputs: Iterable[Path | str]) -> str:
    """Return the fingerprint of an item from its settings, its files and other texts."""
    with files.unwatched():
        known = [each if isinstance(each, str) else fingerprint.of_file(each) for each in inputs]
    return fingerprint.of_data([settings, *known])


@dataclass(frozen=True)
class MadeItem(Generic[Value]):
    """What came of an item: its value, what it was made from, and the files that were written."""

    value: Value
    made_from: str
    files: tuple[tuple[Path, Entry], ...]


@dataclass
class ItemLedger:
    """The account of the files of one item, in whatever thread or process that is; the run's own takes part in it."""

    outer: Ledger | None
    shortened: AbstractSet[Path]
    resume: bool
    made: dict[Path, Entry] = field(default_factory=dict)

    def reads(self, path: Path, file: os.stat_result) -> None:
        """See `files.Ledger`."""
        if self.outer is not None:
            self.outer.reads(path, file)

    def writes(self, path: Path) -> None:
        """See `files.Ledger`."""
        if self.outer is not None:
            self.outer.writes(path)

    def completes(self, path: Path, temporary: Path) -> bool:
        """See `files.Ledger`."""
        made = completed(path, temporary, shortened=path.absolute() in self.shortened)
        self.made[path] = made
        return not (self.resume and path.is_file() and made.is_of(path))

    def wrote(self, file: os.stat_result) -> None:
        """See `files.Ledger`."""
        if self.outer is not None:
            self.outer.wrote(file)


@dataclass(frozen=True)
class _Recorded(Generic[Item, Value]):
    """A function of items that also says what they were made from and which files were written."""

    function: Callable[[Item], Value]
    items: Items[Item, Value]
    shortened: AbstractSet[Path]
    resume: bool

    def __call__(self, item: Item) -> MadeItem[Value]:
        fingerprint_before = self.items.made_from(item)
        ledger = ItemLedger(files.LEDGER.get(), self.shortened, self.resume)
        token = files.LEDGER.set(ledger)
        try:
            value = self.function(item)
        finally:
            files.LEDGER.reset(token)
        return MadeItem(value, fingerprint_before, tuple(ledger.made.items()))


def resumable(
    function: Callable[[Item], Value],
    every: Iterable[Item],
    items: Items[Item, Value],
    *,
    jobs: int | None = None,
    batch: BatchOptions = DEFAULT_BATCH,
    processes: bool = False,
    what: str = "",
    progress: Progress = SILENT,
    alone: bool = False,
) -> Iterator[Outcome[Item, Value]]:
    """Return an iterator with one Outcome per item, as `fan_out` does; with batch.resume those that match are reused.

    alone: the function may use all cores for the only item, and what it raises is raised here; see `only_outcome`.
    """
    run = files.LEDGER.get()
    if not isinstance(run, Run):
        raise TypeError("only a task that is watched has outputs")
    recorded = _Recorded(function, items, run.shortened, batch.resume)
    batch_record = _BatchRecord(run, items)

    def work(left: Iterable[Item]) -> Iterator[Outcome[Item, MadeItem[Value]]]:
        if alone:
            return (only_outcome(recorded, item, batch) for item in left)
        return fan_out(recorded, left, jobs=jobs, batch=batch, processes=processes, what=what, progress=progress)

    if not isinstance(every, Sequence):
        return batch_record.streamed(every, work, reuse=batch.resume)
    if batch.resume:
        here = replace(batch, scheduler=None, timeout=None, fail_fast=False)
        batch_record.compare(every, partial(fan_out, jobs=jobs, batch=here, what=CHECKING, progress=progress))
    return batch_record.sorted(every, work)


_Work = Callable[[Iterable[Item]], Iterator[Outcome[Item, MadeItem[Value]]]]


class _BatchRecord(Generic[Item, Value]):
    """The record of a batch in the lists of its folders: what may be reused, and what is made."""

    def __init__(self, run: Run, items: Items[Item, Value]) -> None:
        self.run = run
        self.items = items
        self.fingerprints: dict[Path, str] = {}

    def compare(self, every: Sequence[Item], each: Callable[..., Iterator[Outcome[Item, str]]]) -> None:
        """Find out what the items whose outputs are intact would be made from now; `each` does so for all of them."""
        known = [item for item in every if self._place(item) in self.run.intact]
        for outcome in each(self.items.made_from, known) if known else ():
            self.fingerprints[self._place(outcome.item)] = outcome.value or ""

    def sorted(self, every: Sequence[Item], work: "_Work[Item, Value]") -> Generator[Outcome[Item, Value]]:
        """Yield what became of the items of a list in their order."""
        reused = [self._reused(item, self.fingerprints.get(self._place(item))) for item in every]
        left = [item for item, outcome in zip(every, reused, strict=True) if outcome is None]
        self._release(left)
        made = work(left) if left else iter(())
        found = next(made, None)
        for item, outcome in zip(every, reused, strict=True):
            if outcome is not None:
                yield outcome
            elif found is not None and found.item is item:  # others were not begun, after one that failed
                yield self._recorded(found)
                found = next(made, None)

    def streamed(
        self, every: Iterable[Item], work: "_Work[Item, Value]", *, reuse: bool
    ) -> Generator[Outcome[Item, Value]]:
        """Yield what became of items that come one after another, such as frames, in their order."""
        before: deque[Outcome[Item, Value] | None] = deque()  # None: the next one that is made

        def left() -> Iterator[Item]:
            for item in every:
                before.append(self._reused(item, self.items.made_from(item)) if reuse else None)
                if before[-1] is None:
                    self._release([item], new=True)
                    yield item

        for outcome in work(left()):
            while (reused := before.popleft()) is not None:
                yield reused
            yield self._recorded(outcome)
        yield from (reused for reused in before if reused is not None)

    def _place(self, item: Item) -> Path:
        return self.items.outputs(item)[0].absolute()

    def _reused(self, item: Item, fingerprint_now: str | None) -> Outcome[Item, Value] | None:
        """Return what came of an item in an earlier run, None if that is not complete or does not match."""
        entry = self.run.known(self.items.outputs(item)[0])
        if entry is None or not entry.made_from or entry.made_from != fingerprint_now:
            return None
        outputs = self.items.outputs(item)
        with suppress(KeyError, IndexError, TypeError, ValueError):  # a list that was changed by hand
            kept = json.loads(entry.result)
            for number in kept["files"]:
                known = self.run.known(outputs[number])
                if known is None or known.made_from != entry.made_from:
                    return None
            value = records.of_plain(self.items.result, kept["value"], self.items.paths(item))
            return Outcome(item, value, reused=True)
        return None

    def _release(self, left: Iterable[Item], *, new: bool = False) -> None:
        """Note that items are made again: from now on nothing is known of their files, whenever the run ends.

        new: also list files that were not claimed and are not there yet.
        """
        folders: dict[Path, dict[str, Entry | None]] = {}
        for path in (path for item in left for path in self.items.outputs(item)):
            if self.run.intact.pop(path.absolute(), None) is not None or (new and not path.exists()):
                folders.setdefault(path.parent, {})[path.name] = None
        for folder, names in folders.items():
            manifest.append(folder, names)

    def _recorded(self, outcome: Outcome[Item, MadeItem[Value]]) -> Outcome[Item, Value]:
        """Return what became of an item, after adding its files to the lists of their folders."""
        made = outcome.value
        if made is None:
            return Outcome(outcome.item, error=outcome.error)
        outputs = list(self.items.outputs(outcome.item))
        kept = {
            "files": [outputs.index(path) for path, _ in made.files],
            "value": records.as_plain(made.value, self.items.paths(outcome.item)),
        }
        folders: dict[Path, dict[str, Entry | None]] = {}
        for path, entry in made.files:
            result = json.dumps(kept, separators=(",", ":"), sort_keys=True) if path == outputs[0] else ""
            folders.setdefault(path.parent, {})[path.name] = entry._replace(made_from=made.made_from, result=result)
        for folder, added in folders.items():
            with suppress(FileError):  # what was written is there, and would only be made again
                manifest.append(folder, added)
        return Outcome(outcome.item, made.value)
