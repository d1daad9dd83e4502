"""Commands as steps of a pipeline: called as from the command line, in this process or a worker, their output kept."""

import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import chdir
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any, get_type_hints

from camcal import files, urls
from camcal.cli.call import ImageCall
from camcal.cli.show import kept, plain
from camcal.errors import EXIT_BUG, ItemsFailed, translated
from camcal.messages import Message
from camcal.options import declared
from camcal.progress import SILENT, Progress
from camcal.tasks.pipelines.reading import NOT_STEPS
from camcal.tasks.pipelines.step import StepError, StepJob, StepResult, below_here, figures_of


class StepCommands(Mapping[str, type]):
    """The options records of the commands that may be steps, by their full names; each is imported when asked for."""

    def __init__(self) -> None:
        from camcal.cli.main import COMMANDS

        self.places = {each.name: each.function for each in COMMANDS if each.function and each.name not in NOT_STEPS}

    def __getitem__(self, name: str) -> type:
        record: type = get_type_hints(self.function(name))["options"]
        return record

    def __iter__(self) -> Iterator[str]:
        return iter(self.places)

    def __len__(self) -> int:
        return len(self.places)

    def function(self, name: str) -> Callable[..., None]:
        """Return the function of a command."""
        module, _, function = self.places[name].partition(":")
        found: Callable[..., None] = getattr(import_module(f"camcal.cli.{module}"), function)
        return found


@dataclass
class _Given:
    """What a command gave: its document and why it is not to be trusted."""

    document: Mapping[str, Any] = field(default_factory=dict)
    failures: tuple[Message, ...] = ()


@dataclass(frozen=True)
class StepCall(ImageCall):
    """How a step calls its command: the document and the words are kept. reporter: what the task reports to."""

    reporter: Progress = SILENT
    given: _Given = field(default_factory=_Given)

    @property
    def progress(self) -> Progress:
        """What a task reports to."""
        return self.reporter

    def give(
        self,
        document: Callable[[], Mapping[str, Any]],
        words: Callable[[], None],
        failures: Sequence[Message] = (),
    ) -> None:
        """Keep a result."""
        self.given.document = plain(document())
        self.given.failures = tuple(failures)
        words()


class _StepProgress:
    """The progress of a step, under its name; its warnings are kept."""

    def __init__(self, name: str, progress: Progress) -> None:
        self.name = name
        self.progress = progress
        self.warnings: dict[Message, None] = {}

    def start(self, what: str, total: int | None) -> None:
        self.progress.start(f"{self.name}: {what}", total)

    def advance(self, count: int = 1) -> None:
        self.progress.advance(count)

    def finish(self) -> None:
        self.progress.finish()

    def warn(self, message: Message) -> None:
        self.warnings[message] = None


def perform(job: StepJob, progress: Progress = SILENT) -> StepResult:
    """Return what comes of a step; its errors are part of that."""
    from camcal.run.outputs import watching

    reporter = _StepProgress(job.name, progress)
    call = StepCall(job.command, reporter=reporter)
    error = None
    with chdir(job.folder), kept() as printed, files.unwatched(), watching(read=[job.pipeline]) as run:
        try:
            run.add({each: each.of(job.options) for each in declared(type(job.options))})
            StepCommands().function(job.command)(job.options, call)
        except Exception as failure:  # noqa: BLE001 - also a bug of one step must not end the others
            error = _error(failure)
            call.given.failures += tuple(getattr(failure, "failures", ()))
        outputs = [path for path in run.planned if path.is_file() or urls.holder(path)]
        inputs = [path for path in run.sources if path != job.pipeline]
    return StepResult(
        figures_of(call.given.document),
        tuple(reporter.warnings),
        tuple(dict.fromkeys(call.given.failures)),
        tuple(message for kind, message in printed.messages if kind == "failed"),
        printed.text.getvalue(),
        tuple(sorted(map(below_here, inputs))),
        tuple(sorted(map(below_here, outputs))),
        error,
    )


def _error(failure: Exception) -> StepError:
    known = translated(failure)
    if known is None:
        trace = "".join(traceback.format_exception(failure))
        return StepError(EXIT_BUG, "bug", f"{type(failure).__name__}: {failure}", trace=trace)
    return StepError(known.exit_code, known.kind, known.message, known.where, isinstance(known, ItemsFailed))
