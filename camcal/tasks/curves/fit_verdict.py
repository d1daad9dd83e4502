"""Whether the result of `camcal fit` can be trusted, and if not, why."""

from collections.abc import Mapping

from camcal.errors import InsufficientData, NotConverged
from camcal.tasks.curves.fit_report import FitReport

_JACOBIAN_ERROR = {"complex": 1e-10, "central": 1e-6}  # of the largest: exact to rounding, and about the root of it


def require_settled(report: FitReport) -> None:
    """Raise what keeps a fit from being trusted: InsufficientData, NotConverged, or nothing at all."""
    found = report.fit
    check = report.check
    if check is not None and check.error > _JACOBIAN_ERROR[check.method]:
        name = found.curve.parameters[check.column]
        raise NotConverged(
            f"the derivative by {name} of row {report.lines[check.row[0]]} is {check.analytic:.9g}, numerically "
            f"{check.numeric:.9g}: {check.error:.1e} of the largest one"
        )
    if found.combinations:
        raise InsufficientData(
            f"the data do not tell apart: {'; '.join(map(combination_text, found.combinations))}; "
            "hold one of each with --fix, or measure where they differ"
        )
    if not found.converged:
        raise NotConverged(
            f"the search ended without a minimum after {found.iterations} iterations: {found.reason}; "
            "try another --start or --restarts 5"
        )
    if found.at_bounds:
        held = ", ".join(f"{name}={found.parameters[name].value:g}" for name in found.at_bounds)
        raise NotConverged(
            f"held at a bound: {held}; the data ask for more; widen --bounds, or --fix it if the bound is certain"
        )


def combination_text(parts: Mapping[str, float]) -> str:
    """Return a change that changes no residual in words, such as 'a + 2 b'; a single parameter by its name."""
    terms = [f"{'-' if part < 0 else '+'} {_times(abs(part))}{name}" for name, part in parts.items()]
    return " ".join(terms).removeprefix("+ ").replace("- ", "-", terms[0].startswith("-"))


def _times(factor: float) -> str:
    text = f"{factor:.3g}"
    return "" if text == "1" else f"{text} "
