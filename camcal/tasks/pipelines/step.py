"""A step of a pipeline: a command with its options, what it reads and writes, and what came of it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from camcal import urls
from camcal.messages import Message
from camcal.options import Declared, assembled, declared
from camcal.run.fingerprint import counts
from camcal.run.option_paths import inputs_of, outputs_of

Figure = str | float | bool


@dataclass(frozen=True, eq=False)
class Step:
    """A step, or what one is for one item of its list.

    name: that of `family`, the step in the file, with its item. given: the values of the options that the file sets.
    before: names of the steps that `after` names.
    """

    name: str
    family: str
    command: str
    record: type
    given: Mapping[Declared, Any]
    before: tuple[str, ...] = ()

    def options(self, **more: Any) -> Any:
        """Return the options record; more: options by their keys, set where the command has them and the file has not.

        Raises InvalidInput for options that contradict each other.
        """
        known = {each.key.replace("-", "_"): each for each in declared(self.record)}
        added = {known[key]: value for key, value in more.items() if key in known and known[key] not in self.given}
        return assembled(self.record, {each.path: value for each, value in {**self.given, **added}.items()})

    @cached_property
    def settings(self) -> dict[str, list[str]]:
        """The words that give every option that the file sets and files or exit code may depend on."""
        given = {each.key: each.words(value) for each, value in self.given.items() if counts(each)}
        return {key: [urls.named(word) for word in words] for key, words in given.items()}

    @cached_property
    def inputs(self) -> tuple[Path, ...]:
        """What options may name as an input: any text may be the name of one."""
        return tuple(path for each, value in self.given.items() for path in inputs_of(each, value))

    @cached_property
    def outputs(self) -> Mapping[Path, Declared]:
        """The files and folders that options name as outputs."""
        return {path: each for each, value in self.given.items() for path in outputs_of(each, value)}

    @property
    def has_urls(self) -> bool:
        """Whether its options name URLs, of which another machine knows nothing but the files of an item."""
        return any(urls.holder(path) is not None for path in (*self.inputs, *self.outputs))

    @property
    def recursive(self) -> bool:
        """Whether folders are read recursively."""
        return any(each.key == "recursive" and value for each, value in self.given.items())

    @property
    def starts_processes(self) -> bool:
        """Whether its options ask for processes of its own, which those of a pool cannot start."""
        own = {each.key: value for each, value in self.given.items()}
        return "timeout" in own or "scheduler" in own or own.get("jobs", 1) != 1


@dataclass(frozen=True)
class StepJob:
    """What it takes to run a step, in any process: the folder that its paths are relative to, and its options.

    pipeline: the file that describes it, which it must not overwrite.
    """

    name: str
    command: str
    options: Any
    folder: Path
    pipeline: Path


@dataclass(frozen=True)
class StepError:
    """Why a step failed, as the command would have said it.

    partial: whether only some of its items failed, and the rest is written. trace: of a bug, its traceback.
    """

    code: int
    kind: str
    message: str
    where: str | None = None
    partial: bool = False
    trace: str = ""

    def __str__(self) -> str:
        return f"{self.where}: {self.message}" if self.where else self.message


@dataclass(frozen=True)
class StepResult:
    """What came of a step.

    figures: single values of the command's document, by their key paths. failures: why its result is not to be
    trusted. failed: why items failed, a line each. text: what the command prints. inputs, outputs: the files that it
    read and wrote.
    """

    figures: Mapping[str, Figure] = field(default_factory=dict)
    warnings: tuple[Message, ...] = ()
    failures: tuple[Message, ...] = ()
    failed: tuple[str, ...] = ()
    text: str = ""
    inputs: tuple[Path, ...] = ()
    outputs: tuple[Path, ...] = ()
    error: StepError | None = None

    @property
    def code(self) -> int:
        """The exit code that the command would have had."""
        return 0 if self.error is None else self.error.code

    @property
    def continued(self) -> bool:
        """Whether steps that need this one are run."""
        return self.error is None or self.error.partial


def figures_of(document: Mapping[str, Any]) -> dict[str, Figure]:
    """Return the single values in a command's document by their key paths, such as 'uncertainty.projection.rms_px'."""
    found: dict[str, Figure] = {}
    for key, value in document.items():
        if isinstance(value, Mapping):
            found |= {f"{key}.{below}": figure for below, figure in figures_of(value).items()}
        elif isinstance(value, str | int | float):
            found[key] = value
    return found


def place_of(path: Path) -> Path:
    """Return the one path of a file or folder, however it is spelled: by '..', or through a link to a folder."""
    return path.resolve() if path.name in ("", "..") or path.is_dir() else path.parent.resolve() / path.name


def below_here(path: Path) -> Path:
    """Return a path relative to the working directory, if it is below that, else as an absolute one."""
    place, here = path.absolute(), Path.cwd()
    return place.relative_to(here) if place.is_relative_to(here) else place


def name_of(path: Path) -> str:
    """Return the name of a file in the state and in documents: relative to the working directory, or its URL."""
    return urls.named(below_here(path).as_posix())


def families(steps: Sequence[Step]) -> dict[str, list[Step]]:
    """Return steps by the names that the file has for them, in its order."""
    found: dict[str, list[Step]] = {}
    for step in steps:
        found.setdefault(step.family, []).append(step)
    return found
