"""`camcal run`: the steps of a pipeline, those that are not up to date, in their order."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, chdir, contextmanager
from fnmatch import fnmatchcase
from functools import cached_property
from pathlib import Path
from typing import Protocol

from camcal import files, system, urls
from camcal.dataclass import dataclass, field, replace
from camcal.errors import EXIT_PRECEDENCE, CamcalError, FileError, InvalidInput
from camcal.messages import Message, counted
from camcal.parsing import did_you_mean
from camcal.progress import SILENT, Outcome, Progress
from camcal.run.fanout import fan_out
from camcal.run.options import is_folder
from camcal.run.outputs import Run, watch_files
from camcal.run.process import available_cores
from camcal.tasks.pipelines.order import Order, missing_inputs, ordered
from camcal.tasks.pipelines.reading import Commands, read_pipeline
from camcal.tasks.pipelines.state import State, files_of
from camcal.tasks.pipelines.step import PipelineOptions, Step, StepError, StepJob, StepResult, place_of

DONE, UP_TO_DATE, FAILED, NOT_RUN = "done", "up to date", "failed", "not run"
WOULD_RUN, STARTED = "would run", "started"


class Perform(Protocol):
    """Runs a step, in this process or in a worker."""

    def __call__(self, job: StepJob, progress: Progress = SILENT, /) -> StepResult: ...


@dataclass(frozen=True, eq=False)
class StepReport:
    """A step, its state, why it is in that state, and what came of it; a step that was not run has no result."""

    step: Step
    state: str
    reason: str = ""
    result: StepResult = field(default_factory=StepResult)

    @property
    def name(self) -> str:
        return self.step.name


Told = Callable[[StepReport], None]


@dataclass(frozen=True, eq=False)
class PipelineReport:
    """What came of the chosen steps of a pipeline, in their order. where: the pipeline file."""

    where: str
    steps: tuple[StepReport, ...]

    @property
    def code(self) -> int:
        """The exit code of the worst step."""
        return min((each.result.code for each in self.steps), key=EXIT_PRECEDENCE.index, default=0)

    def count(self, state: str) -> int:
        """Return how many steps are in a state."""
        return sum(each.state == state for each in self.steps)


def run_pipeline(
    options: PipelineOptions,
    commands: Commands,
    perform: Perform,
    progress: Progress = SILENT,
    told: Told | None = None,
) -> PipelineReport:
    """Return what came of the steps of a pipeline, after running those that are not up to date.

    commands: the options records of commands that may be steps. perform: runs a step, in this process or in a worker.
    told: is called with every step that starts alone, and with every step that has ended. Meanwhile the working
    directory is the folder of the pipeline.
    Raises InvalidInput or FileError for a pipeline that is wrong, before any step runs; what a step raises is in its
    result.
    """
    text = files.read_text(options.pipeline)
    where, file, state_file = str(options.pipeline), options.pipeline.absolute(), options.state_file.absolute()
    with _alone(options), watch_files() as ledger, chdir(file.parent):
        with files.unwatched():
            pipeline = read_pipeline(text, where, dict(each.split("=", 1) for each in options.variables), commands)
            order = ordered(pipeline)
            chosen = _choose_steps(order, options)
            if found := dict.fromkeys(missing_inputs(pipeline, order, chosen.keys())):
                raise pipeline.document.error(found)
            state = State(state_file)
        run = _PipelineRun(order, chosen, state, options, file, ledger, perform, progress, told or (lambda _: None))
        if options.dry_run:
            return PipelineReport(where, tuple(run.foreseen()))
        try:
            ledger.plan_named(state_file)
        except FileError as error:
            text = f"{error.message}; choose another place with --state"
            raise FileError(text, where=str(options.state_file)) from error
        return PipelineReport(where, tuple(run.all_steps()))


@contextmanager
def _alone(options: PipelineOptions) -> Iterator[None]:
    """Keep other runs that would write the same state from a pipeline during the block."""
    if options.state is not None or options.dry_run:
        yield
        return
    with ExitStack() as held:
        try:
            held.enter_context(system.held(options.pipeline))
        except BlockingIOError:
            text = "another run of this pipeline is in progress; wait until it has ended"
            raise FileError(text, where=str(options.pipeline)) from None
        yield


def _choose_steps(order: Order, options: PipelineOptions) -> dict[str, Step]:
    """Return the steps that --only and --from choose, in their order; raises InvalidInput."""
    if options.only:
        found = {name for text in options.only for name in _steps_named(order, text, "--only")}
    elif options.first is not None:
        found = order.below(_steps_named(order, options.first, "--from"))
    else:
        return dict(order.steps)
    return {name: step for name, step in order.steps.items() if name in found}


def _steps_named(order: Order, text: str, option: str) -> list[str]:
    """Return the steps of a name: of a step of the file, of one with its item, or of a pattern of such names."""
    found = [name for name, step in order.steps.items() if text in (name, step.family)]
    found = found or [name for name in order.steps if fnmatchcase(name.replace("[", "("), text.replace("[", "("))]
    if not found:
        known = dict.fromkeys([*(step.family for step in order.steps.values()), *order.steps])
        raise InvalidInput(f"{option} {text}: the pipeline has no such step{did_you_mean(text, known)}")
    return found


@dataclass
class _PipelineRun:
    """A run of the chosen steps, and what came of those that have ended."""

    order: Order
    chosen: Mapping[str, Step]
    state: State
    options: PipelineOptions
    file: Path
    ledger: Run
    perform: Perform
    progress: Progress
    told: Told
    reports: dict[str, StepReport] = field(default_factory=dict)

    def foreseen(self) -> list[StepReport]:
        """Return for every chosen step whether it would run, and why."""
        found: dict[str, StepReport] = {}
        for name, step in self.chosen.items():
            needed = [other for other in self.order.needs[name] if other in found and found[other].state == WOULD_RUN]
            reason = f"needs {needed[0]}, which would run" if needed else self.reason_to_run(step)
            found[name] = StepReport(step, WOULD_RUN, reason) if reason else self.up_to_date(step)
        return list(found.values())

    def all_steps(self) -> list[StepReport]:
        """Run the chosen steps, each after those that it needs; return them in their order."""
        try:
            while ready := [name for name in self.chosen if name not in self.reports and not self.waits(name)]:
                due = {name: reason for name in ready if (reason := self.begin(name)) is not None}
                for name, result in self.results(due):
                    self.end(name, due[name], result)
                    if self.stopped:
                        break
        finally:
            self.state.write()
        return [self.reports[name] for name in self.chosen]

    def waits(self, name: str) -> bool:
        """Return whether a step needs one that has not ended."""
        return any(other in self.chosen and other not in self.reports for other in self.order.needs[name])

    @property
    def stopped(self) -> str | None:
        """The name of the step that ends the run with --fail-fast, None if it goes on."""
        failed = (name for name, report in self.reports.items() if report.state == FAILED)
        return next(failed, None) if self.options.batch.fail_fast else None

    def begin(self, name: str) -> str | None:
        """Return why a step has to run; None if it need not or cannot, which is noted."""
        step = self.chosen[name]
        blocking = [self.reports[other] for other in self.order.needs[name] if other in self.reports]
        blocking = [each for each in blocking if each.state == NOT_RUN or not each.result.continued]
        if blocking:
            word = "failed" if blocking[0].state == FAILED else "was not run"
            self.note(StepReport(step, NOT_RUN, f"needs {blocking[0].name}, which {word}"))
        elif self.stopped is not None:
            self.note(StepReport(step, NOT_RUN, f"{self.stopped} failed (--fail-fast)"))
        elif (reason := self.reason_to_run(step)) is not None:
            return reason
        else:
            self.note(self.up_to_date(step))
        return None

    def up_to_date(self, step: Step) -> StepReport:
        """Return the report of a step that need not run: what came of it the last time."""
        return StepReport(step, UP_TO_DATE, "", self.state.records[step.name].result)

    def note(self, report: StepReport) -> None:
        """Keep what came of a step, and tell it."""
        self.reports[report.name] = report
        self.told(report)

    def reason_to_run(self, step: Step) -> str | None:
        """Return why a step has to run, None if it is up to date."""
        return self.state.reason_to_run(step, self.files(step), self.progress) or (
            "--force" if self.options.force else None
        )

    def files(self, step: Step) -> list[Path]:
        """Return the files that the options of a step stand for, without its outputs and those of later steps."""
        above = self.order.above(step.name)
        return [path for path in files_of(step) if self._made_by(path) <= above]

    def _made_by(self, path: Path) -> set[str]:
        """Return the steps of which a file is an output, or lies in one; of the run's own files that is no step."""
        place = place_of(path)
        return {self._makers[each] for each in (place, *place.parents) if each in self._makers}

    @cached_property
    def _makers(self) -> dict[Path, str]:
        made = {place_of(path): name for name, step in self.order.steps.items() for path in step.outputs}
        return made | dict.fromkeys(map(place_of, (self.file, self.state.path)), "")

    def results(self, due: Mapping[str, str]) -> Iterator[tuple[str, StepResult]]:
        """Yield what comes of steps that do not need one another; due: their names, and why they run.

        If they keep more than half of the jobs busy, each has a process of its own; otherwise one comes after the
        other and has all jobs. On a cluster each is a job, unless it names URLs.
        """
        refused = {name: result for name in due if (result := self.refused(name)) is not None}
        yield from refused.items()
        due = {name: reason for name, reason in due.items() if name not in refused}
        batch, count = self.options.batch, self.options.jobs or available_cores()
        shared = [name for name in due if not self.chosen[name].starts_processes]
        if batch.scheduler is not None:
            shared = [name for name in shared if not self.chosen[name].has_urls]
        if len(shared) < 2 or (batch.scheduler is None and 2 * len(shared) <= count):
            shared = []
        for name, reason in due.items():
            if name not in shared:
                self.told(StepReport(self.chosen[name], STARTED, reason))
                yield name, self.perform(self.job(name, self.options.jobs, batch.scheduler), self.progress)
        if not shared:
            return
        items = [self.job(name, 1) for name in shared]
        work = fan_out(
            self.perform, items, jobs=count, batch=batch, processes=True, what="steps", progress=self.progress
        )
        for outcome in work:
            yield outcome.item.name, _result(outcome)

    def refused(self, name: str) -> StepResult | None:
        """Keep other runs from the output folders of a step until the pipeline ends; return the error of one in use."""
        try:
            for path, each in self.chosen[name].outputs.items():
                if is_folder(each, path):
                    self.ledger.folders.hold(path, each.name)
        except FileError as error:
            return StepResult(error=_step_error(error))
        return None

    def job(self, name: str, jobs: int | None, scheduler: str | None = None) -> StepJob:
        """Return what it takes to run a step; items of it that are done need not be done again."""
        step = self.chosen[name]
        how = {
            "jobs": jobs,
            "scheduler": scheduler,
            "resume": not self.options.force or None,
            "overwrite": self.options.overwrite or None,
        }
        options = step.options(**{key: value for key, value in how.items() if value is not None})
        return StepJob(name, step.command, options, Path.cwd(), self.file)

    def end(self, name: str, reason: str, result: StepResult) -> None:
        """Note the result of a step, and record it if it succeeded."""
        step = self.chosen[name]
        if result.error is None:
            if left := self.state.left_by(step, result):
                result = replace(result, warnings=(*result.warnings, _left(left)))
            self.state.keep(step, result, self.files(step))
        else:
            self.state.forget(name)
        self.state.write_soon()
        self.note(StepReport(step, DONE if result.error is None else FAILED, reason, result))


def _left(names: Sequence[str]) -> Message:
    """Return the warning that steps which read a folder find files in it that are no longer made."""
    more = f" and {counted(len(names) - 1, 'other file')}" if len(names) > 1 else ""
    text = f"left from an earlier run{more}; remove what later steps are not to read"
    return Message("outputs_left", text, {"files": len(names)}, names[0])


def _result(outcome: Outcome[StepJob, StepResult]) -> StepResult:
    """Return the result of a step, which is an error if its process ended or its files are not on this machine."""
    error, result = outcome.error, outcome.value or StepResult()
    unseen = [path for path in result.outputs if not path.exists() and urls.holder(path) is None]
    if error is None and unseen:
        error = FileError("was written by a worker, but not into a shared folder", where=str(unseen[0]))
    if error is None:
        return result
    return replace(result, error=_step_error(error))


def _step_error(error: CamcalError) -> StepError:
    return StepError(error.exit_code, error.kind, error.message, error.where)
