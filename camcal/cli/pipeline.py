"""`camcal run`."""

import sys
from functools import partial
from typing import TYPE_CHECKING

from camcal.cli import show
from camcal.cli.call import ImageCall
from camcal.tasks.pipelines.options import PipelineOptions

if TYPE_CHECKING:
    from camcal.tasks.pipelines.run_pipeline import PipelineReport, StepReport


def run(options: PipelineOptions, call: ImageCall) -> None:
    """Run a pipeline: commands with their options from one file, in the order that follows from their files.

    The whole file is checked first. Steps whose inputs, options, versions and outputs are those of the last time are
    not run again; steps that do not need each other are run at once. If a step fails, those that need it are not run,
    the others are. The exit code is that of the worst step. Paths are relative to the file.
    """
    from camcal.cli.steps import StepCommands, perform
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
    from camcal.report.letters import value_histogram
    from camcal.tasks.pipelines import summary

    if options.dry_run:
        show.table(report.where, summary.PLANNED_COLUMNS, summary.planned_rows(report), verbose=verbose)
    else:
        rows = summary.rows(report)
        show.table(report.where, summary.COLUMNS, rows, verbose=verbose, most=show.LISTED)
        for title, values in summary.distributions(report):
            show.figure(partial(value_histogram, values, title))
    show.verdict(summary.verdict(report), good=None if options.dry_run else summary.is_good(report))
