"""`camcal run`."""

import sys
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import chdir
from functools import partial
from importlib import import_module
from typing import TYPE_CHECKING, Any, get_type_hints

from camcal import files, urls
from camcal.cli import show
from camcal.cli.call import ImageCall
from camcal.cli.show import kept, plain
from camcal.dataclass import dataclass, field
from camcal.errors import EXIT_BUG, ItemsFailed, translated
from camcal.messages import Message
from camcal.options import declared
from camcal.progress import SILENT, Progress
from camcal.tasks.pipelines.step import (
    NOT_STEPS,
    PipelineOptions,
    StepError,
    StepJob,
    StepResult,
    below_here,
    figures_of,
)

if TYPE_CHECKING:
    from camcal.tasks.pipelines.run_pipeline import PipelineReport, StepReport


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
    from camcal.run.outputs import watch_files

    reporter = _StepProgress(job.name, progress)
    call = StepCall(job.command, reporter=reporter)
    error = None
    with chdir(job.folder), kept() as printed, files.unwatched(), watch_files(read=[job.pipeline]) as run:
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


def run(options: PipelineOptions, call: ImageCall) -> None:
    """Run a pipeline: commands with their options from one file, in the order that follows from their files.

    The whole file is checked first. Steps whose inputs, options, versions and outputs are those of the last time are
    not run again; steps that do not need each other are run at once. If a step fails, those that need it are not run,
    the others are. The exit code is that of the worst step. Paths are relative to the file.
    """
    from camcal.tasks.pipelines.run_pipeline import run_pipeline
    from camcal.tasks.pipelines.summary import document, doubts, require_success

    report = run_pipeline(options, StepCommands(), perform, call.progress, partial(_tell, call=call))
    call.give(lambda: document(report), lambda: _show(report, options, call.verbose), doubts(report))
    require_success(report)


def _tell(each: "StepReport", *, call: ImageCall) -> None:
    """Print to stderr that a step starts, and what came of it; on a terminal the table says that."""
    from camcal.tasks.pipelines.run_pipeline import STARTED, UP_TO_DATE
    from camcal.tasks.pipelines.summary import of_step, result_words

    for warning in each.result.warnings if each.state != UP_TO_DATE else ():
        show.warning(of_step(each, warning))
    show.failed(f"{each.name}: {why}" for why in each.result.failed)
    if call.verbose or not (call.quiet or sys.stderr is None or sys.stderr.isatty()):
        words = each.reason if each.state == STARTED else result_words(each)
        show.note(f"step {each.name}", f"{each.state}: {words}" if words else each.state)
    for line in each.result.text.splitlines() if call.verbose else ():
        show.note(f"step {each.name}", line)


def _show(report: "PipelineReport", options: PipelineOptions, verbose: bool) -> None:
    from camcal.report.text_figures import value_histogram
    from camcal.tasks.pipelines import summary

    if options.dry_run:
        show.table(report.where, summary.PLANNED_COLUMNS, summary.planned_rows(report), verbose=verbose)
    else:
        rows = summary.rows(report)
        show.table(report.where, summary.COLUMNS, rows, verbose=verbose, most=show.LISTED)
        for title, values in summary.distributions(report):
            show.figure(partial(value_histogram, values, title))
    show.verdict(summary.verdict(report), good=None if options.dry_run else summary.is_good(report))
