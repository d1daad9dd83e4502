"""Batches that can be resumed: what items made is recorded as they are completed, and skipped if it still matches.

An item is made from the contents of its inputs and from the settings of the command; its outputs are complete if all
of them are as camcal left them. Both are compared by hashes. Input is hashed before it is read: if it changes while it
is read, the next run makes the item again.
"""

import json
import os
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from collections.abc import Set as AbstractSet
from contextlib import suppress
from pathlib import Path
from typing import Any, Generic

from camcal import files
from camcal.dataclass import dataclass, field, replace
from camcal.errors import FileError
from camcal.files import Ledger
from camcal.progress import SILENT, Item, Outcome, Progress, Value
from camcal.run import fingerprint
from camcal.run.fanout import fan_out, only_outcome
from camcal.run.fingerprint import Entry
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
    that `named` gives. What is only found in an image, and kept in a journal, has no outputs.
    """

    settings: str
    inputs: Callable[[Item], Sequence[Path | str]]
    outputs: Callable[[Item], Sequence[Path]] = _no_paths
    result: Any = None
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
        known = [each if isinstance(each, str) else fingerprint.of_source(each) for each in inputs]
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
class Recording(Generic[Item, Value]):
    """A function of items that also says what they were made from and which files were written.

    shortened: outputs that are shorter than they were written, None for items without outputs.
    """

    function: Callable[[Item], Value]
    items: Items[Item, Value]
    shortened: AbstractSet[Path] | None = None
    resume: bool = False

    def __call__(self, item: Item) -> MadeItem[Value]:
        fingerprint_before = self.items.made_from(item)
        if self.shortened is None:
            return MadeItem(self.function(item), fingerprint_before, ())
        ledger = ItemLedger(files.LEDGER.get(), self.shortened, self.resume)
        token = files.LEDGER.set(ledger)
        try:
            value = self.function(item)
        finally:
            files.LEDGER.reset(token)
        return MadeItem(value, fingerprint_before, tuple(ledger.made.items()))


class Store(ABC, Generic[Item, Value]):
    """What earlier runs left of the items of a batch, and where this run leaves the same."""

    def __init__(self, items: Items[Item, Value]) -> None:
        self.items = items

    @abstractmethod
    def holds(self, item: Item) -> bool:
        """Return whether something is known of an item, so that it is worth while to ask what it is made from."""

    @abstractmethod
    def reuse(self, item: Item, fingerprint_now: str) -> Outcome[Item, Value] | None:
        """Return what came of an item in an earlier run, None if that is not complete or does not match."""

    def release(self, left: Sequence[Item], *, claimed: bool) -> None:
        """Note that items are about to be made; claimed: their outputs are listed already."""

    @abstractmethod
    def record(self, item: Item, made: MadeItem[Value]) -> None:
        """Keep what came of an item."""


Fan = Callable[[Iterable[Item]], Iterator[Outcome[Item, MadeItem[Value]]]]


def remembering(
    store: Store[Item, Value],
    every: Iterable[Item],
    fan: "Fan[Item, Value]",
    *,
    jobs: int | None,
    batch: BatchOptions,
    progress: Progress,
) -> Iterator[Outcome[Item, Value]]:
    """Yield what became of every item in their order: with batch.resume what is remembered, else what `fan` makes."""
    if not isinstance(every, Sequence):
        yield from _stream(store, every, fan, reuse=batch.resume)
        return
    reused: dict[int, Outcome[Item, Value]] = {}
    if batch.resume:
        known = [index for index, item in enumerate(every) if store.holds(item)]
        now = _fingerprints(store, [every[index] for index in known], jobs, batch, progress)
        found = {index: store.reuse(every[index], made_from) for index, made_from in zip(known, now, strict=True)}
        reused = {index: outcome for index, outcome in found.items() if outcome is not None}
    left = [item for index, item in enumerate(every) if index not in reused]
    store.release(left, claimed=True)
    made = fan(left) if left else iter(())
    upcoming = next(made, None)
    for index, item in enumerate(every):
        if index in reused:
            yield reused[index]
        elif upcoming is not None and upcoming.item is item:  # others were not begun, after one that failed
            yield _keep(store, upcoming)
            upcoming = next(made, None)


def _fingerprints(
    store: Store[Item, Value], items: Sequence[Item], jobs: int | None, batch: BatchOptions, progress: Progress
) -> list[str]:
    """Return what items are made from now; empty where an input cannot be read."""
    if not items:
        return []
    here = replace(batch, scheduler=None, timeout=None, fail_fast=False)
    compared = fan_out(store.items.made_from, items, jobs=jobs, batch=here, what=CHECKING, progress=progress)
    return [outcome.value or "" for outcome in compared]


def _stream(
    store: Store[Item, Value], every: Iterable[Item], fan: "Fan[Item, Value]", *, reuse: bool
) -> Iterator[Outcome[Item, Value]]:
    """Yield what became of items that come one after another, such as frames, in their order."""
    before: deque[Outcome[Item, Value] | None] = deque()  # None: the next one that is made

    def left() -> Iterator[Item]:
        for item in every:
            before.append(store.reuse(item, store.items.made_from(item)) if reuse and store.holds(item) else None)
            if before[-1] is None:
                store.release([item], claimed=False)
                yield item

    for outcome in fan(left()):
        while (reused := before.popleft()) is not None:
            yield reused
        yield _keep(store, outcome)
    yield from (reused for reused in before if reused is not None)


def _keep(store: Store[Item, Value], outcome: Outcome[Item, MadeItem[Value]]) -> Outcome[Item, Value]:
    made = outcome.value
    if made is None:
        return Outcome(outcome.item, error=outcome.error)
    store.record(outcome.item, made)
    return Outcome(outcome.item, made.value)


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
    recorded = Recording(function, items, run.shortened, batch.resume)

    def fan(left: Iterable[Item]) -> Iterator[Outcome[Item, MadeItem[Value]]]:
        if alone:
            return (only_outcome(recorded, item, batch) for item in left)
        return fan_out(recorded, left, jobs=jobs, batch=batch, processes=processes, what=what, progress=progress)

    return remembering(FolderStore(run, items), every, fan, jobs=jobs, batch=batch, progress=progress)


class FolderStore(Store[Item, Value]):
    """The outputs of items as the lists of their folders know them."""

    def __init__(self, run: Run, items: Items[Item, Value]) -> None:
        super().__init__(items)
        self.run = run

    def holds(self, item: Item) -> bool:
        return self.run.known(self.items.outputs(item)[0]) is not None

    def reuse(self, item: Item, fingerprint_now: str) -> Outcome[Item, Value] | None:
        outputs = self.items.outputs(item)
        entry = self.run.known(outputs[0])
        if entry is None or not entry.made_from or entry.made_from != fingerprint_now:
            return None
        with suppress(KeyError, IndexError, TypeError, ValueError):  # a list that was changed by hand
            kept = json.loads(entry.result)
            known = [self.run.known(outputs[number]) for number in kept["files"]]
            if all(each is not None and each.made_from == entry.made_from for each in known):
                value = fingerprint.value_of_plain(self.items.result, kept["value"], self.items.paths(item))
                return Outcome(item, value, reused=True)
        return None

    def release(self, left: Sequence[Item], *, claimed: bool) -> None:
        """From now on nothing is known of the files, whenever the run ends."""
        folders: dict[Path, dict[str, Entry | None]] = {}
        for path in (path for item in left for path in self.items.outputs(item)):
            was_known = self.run.intact.pop(path.absolute(), None) is not None
            missing = (self.run.resume or not claimed) and not path.exists()
            if was_known or missing:
                folders.setdefault(path.parent, {})[path.name] = None
            if missing:  # what does not come to be is taken off the list when the run ends
                self.run.planned.setdefault(path.absolute(), None)
        for folder, names in folders.items():
            fingerprint.append(folder, names)

    def record(self, item: Item, made: MadeItem[Value]) -> None:
        outputs = list(self.items.outputs(item))
        kept = {
            "files": [outputs.index(path) for path, _ in made.files],
            "value": fingerprint.as_plain(made.value, self.items.paths(item)),
        }
        folders: dict[Path, dict[str, Entry | None]] = {}
        for path, entry in made.files:
            result = json.dumps(kept, separators=(",", ":"), sort_keys=True) if path == outputs[0] else ""
            folders.setdefault(path.parent, {})[path.name] = entry._replace(made_from=made.made_from, result=result)
        for folder, added in folders.items():
            with suppress(FileError):  # what was written is there, and would only be made again
                fingerprint.append(folder, added)
