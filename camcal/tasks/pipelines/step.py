"""The options of `camcal run`; a step: a command with its options, what it reads and writes, and what came of it."""

from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any

from camcal import urls
from camcal.dataclass import dataclass, field
from camcal.errors import InvalidInput
from camcal.files import STANDARD
from camcal.messages import Message
from camcal.options import (
    INPUT,
    OUTPUT,
    Argument,
    Declared,
    Option,
    OptionsRecord,
    Without,
    Written,
    assembled,
    declared,
)
from camcal.run.options import BatchOptions, counts, inputs_of, outputs_of
from camcal.tasks.options import Jobs, Overwrite

STEPS = "Steps"

Figure = str | float | bool
NOT_STEPS = ("run", "demo", "doctor")  # pipelines do not call each other, and nothing depends on the others


@dataclass(frozen=True)
class PipelineOptions(OptionsRecord):
    """A pipeline file, values for its variables, which of its steps are run, and where its state is kept.

    only: names of steps, none for all; first: the step to begin with. state: None for a file beside the pipeline.
    """

    pipeline: Annotated[
        Path, Argument("Pipeline: a YAML file of steps, each a command with its options.", metavar="PIPELINE")
    ]
    variables: Annotated[
        tuple[str, ...],
        Option("Value of a variable of the pipeline; repeatable.", metavar="NAME=VALUE", group=INPUT, names="--set"),
    ] = ()
    only: Annotated[
        tuple[str, ...],
        Option(
            "Run this step only, NAME or NAME[ITEM]; repeatable. Its inputs must be there.",
            metavar="STEP",
            group=STEPS,
        ),
    ] = ()
    first: Annotated[
        str | None,
        Option("Run this step and the steps that need its results.", metavar="STEP", group=STEPS, names="--from"),
    ] = None
    force: Annotated[bool, Option("Run steps that are up to date too.", group=STEPS)] = False
    dry_run: Annotated[
        bool, Option("List the steps that would run and why, and do nothing else.", group=STEPS, names="--dry-run -n")
    ] = False
    state: Annotated[
        Path | None,
        Option(
            "File with what the steps were made from; by default .NAME.state.json beside the pipeline.",
            metavar="FILE",
            group=OUTPUT,
            recorded=False,
            written=Written((".json",)),
        ),
    ] = None
    overwrite: Overwrite = False
    jobs: Jobs = None
    batch: Annotated[BatchOptions, Without(("timeout", "resume"))] = field(default_factory=BatchOptions)

    def __post_init__(self) -> None:
        super().__post_init__()
        if str(self.pipeline) == STANDARD:
            raise InvalidInput(
                "a pipeline is read from a file: its paths are relative to the folder of that", where=STANDARD
            )
        if self.only and self.first is not None:
            raise InvalidInput("--only and --from both choose steps; give one of them")
        for text in self.variables:
            if not text.partition("=")[0] or "=" not in text:
                raise InvalidInput(f"--set {text}: write it as NAME=VALUE")

    @property
    def state_file(self) -> Path:
        """Where the state is kept."""
        return self.state or self.pipeline.with_name(f".{self.pipeline.stem}.state.json")


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
