"""What a pipeline is reported as: the table with the worst step first, and the document for --json."""

from collections.abc import Iterator, Sequence
from typing import Any

from camcal import messages
from camcal.dataclass import dataclass, replace
from camcal.errors import EXIT_BUG, EXIT_PRECEDENCE, CamcalError
from camcal.messages import Message, counted
from camcal.report.table import Column
from camcal.tasks.pipelines.run_pipeline import DONE, FAILED, NOT_RUN, UP_TO_DATE, WOULD_RUN, PipelineReport, StepReport
from camcal.tasks.pipelines.step import families, name_of

COLUMNS = (Column("step"), Column("state"), Column("result", wraps=True))
PLANNED_COLUMNS = (Column("step"), Column("state"), Column("reason", wraps=True))

_STATES = (FAILED, NOT_RUN, DONE, UP_TO_DATE, WOULD_RUN)
_LEAST_DRAWN = 3  # values of a histogram


@dataclass(frozen=True)
class KeyFigure:
    """The figure that says most about the result of a command: its key path, its name and unit."""

    path: str
    name: str
    unit: str = ""


KEY_FIGURES = {
    "calibrate": KeyFigure("rms_px", "RMS", "px"),
    "rig": KeyFigure("epipolar_rms_px", "epipolar RMS", "px"),
    "stereo calibrate": KeyFigure("epipolar_rms_px", "epipolar RMS", "px"),
}


def key_figure(report: StepReport) -> float | None:
    """Return the figure of a step that says most about its result, None if its command has none."""
    key = KEY_FIGURES.get(report.step.command)
    value = None if key is None else report.result.figures.get(key.path)
    return value if isinstance(value, float) else None


def worst_first(steps: Sequence[StepReport]) -> list[StepReport]:
    """Return steps in the order of what went wrong; among equals those of one family by their key figure."""
    place = {name: number for number, name in enumerate(families([each.step for each in steps]))}

    def rank(each: StepReport) -> tuple[Any, ...]:
        result = each.result
        doubts = 0 if result.failures else 1 if result.warnings else 2
        value = key_figure(each)
        code = EXIT_PRECEDENCE.index(result.code)
        return each.state not in (FAILED, NOT_RUN), code, doubts, place[each.step.family], -(value or 0.0)

    return sorted(steps, key=rank)


def rows(report: PipelineReport) -> list[list[object]]:
    """Return the rows of the table of steps that were run, the worst first."""
    return [[each.name, each.state, result_words(each)] for each in worst_first(report.steps)]


def planned_rows(report: PipelineReport) -> list[list[object]]:
    """Return the rows of the table of steps that would be run, in their order."""
    return [[each.name, each.state, each.reason] for each in report.steps]


def result_words(each: StepReport) -> str:
    """Return what came of a step, in a line."""
    result = each.result
    if result.error is not None:
        first, *more = str(result.error).split("\n")
        return f"{first} (and {len(more)} more)" if more else first
    if each.state == NOT_RUN:
        return each.reason
    return ", ".join(_parts(each))


def _parts(each: StepReport) -> Iterator[str]:
    result, value = each.result, key_figure(each)
    if result.failures:
        more = f" (and {len(result.failures) - 1} more)" if len(result.failures) > 1 else ""
        yield f"DO NOT TRUST: {result.failures[0].text}{more}"
    elif result.figures.get("trustworthy") is True:
        yield "trustworthy"
    if value is not None:
        key = KEY_FIGURES[each.step.command]
        yield f"{key.name} {value:.3g} {key.unit}".rstrip()
    if result.outputs:
        yield counted(len(result.outputs), "file")
    if result.warnings:
        yield counted(len(result.warnings), "warning")


def verdict(report: PipelineReport) -> str:
    """Return how many steps are in which state, in a line."""
    counts = {state: report.count(state) for state in _STATES}
    found = ", ".join(f"{count} {state}" for state, count in counts.items() if count)
    doubtful = sum(bool(each.result.failures) for each in report.steps)
    said = f"; {counted(doubtful, 'result')} not to be trusted" if doubtful else ""
    return f"{counted(len(report.steps), 'step')}: {found}{said}"


def is_good(report: PipelineReport) -> bool:
    """Return whether no step failed, and every result may be trusted."""
    return report.code == 0 and not any(each.result.failures for each in report.steps)


def of_step(each: StepReport, message: Message) -> Message:
    """Return a message with the name of its step before its place."""
    return replace(message, where=": ".join(filter(None, (each.name, message.where))))


def doubts(report: PipelineReport) -> list[Message]:
    """Return why results of steps that did not fail are not to be trusted."""
    return [of_step(each, found) for each in report.steps if not each.result.error for found in each.result.failures]


def distributions(report: PipelineReport) -> Iterator[tuple[str, list[float]]]:
    """Yield the key figures of the steps of every list that has enough of them, each with its title."""
    by_family: dict[str, list[StepReport]] = {}
    for each in report.steps:
        by_family.setdefault(each.step.family, []).append(each)
    for name, members in by_family.items():
        values = [value for each in members if (value := key_figure(each)) is not None]
        if len(values) >= _LEAST_DRAWN:
            key = KEY_FIGURES[members[0].step.command]
            yield f"{name}: {key.name}{f', {key.unit}' if key.unit else ''}", values


def document(report: PipelineReport) -> dict[str, Any]:
    """Return the report as plain data for --json; the exit code is that of the run."""
    return {
        "pipeline": report.where,
        "exit": report.code,
        "counts": {state.replace(" ", "_"): report.count(state) for state in _STATES},
        "steps": [_plain(each) for each in worst_first(report.steps)],
    }


def _plain(each: StepReport) -> dict[str, Any]:
    result, error = each.result, each.result.error
    found = None if error is None else {"kind": error.kind, "message": error.message, "where": error.where}
    return {
        "step": each.name,
        "command": each.step.command,
        "state": each.state.replace(" ", "_"),
        "reason": each.reason,
        "exit": result.code,
        "error": found,
        "failed": list(result.failed),
        "failures": messages.as_data(result.failures),
        "warnings": messages.as_data(result.warnings),
        "outputs": [name_of(path) for path in result.outputs],
        "figures": dict(result.figures),
    }


def require_success(report: PipelineReport) -> None:
    """Raise the error of the worst step, if one failed; RuntimeError with its traceback for a bug."""
    failed = [each for each in worst_first(report.steps) if each.result.error is not None]
    if not failed:
        return
    worst, error = failed[0].name, failed[0].result.error
    assert error is not None
    if error.code == EXIT_BUG:
        raise RuntimeError(f"step {worst}: {error.trace}")
    more = f"; {len(failed) - 1} more failed" if len(failed) > 1 else ""
    kinds = {kind.exit_code: kind for kind in CamcalError.__subclasses__()}
    raise kinds[error.code](f"step {worst} failed{more}: {error}", failures=failed[0].result.failures)
