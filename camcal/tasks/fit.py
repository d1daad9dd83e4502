"""`camcal fit`: the curve, data and start from a table and the options, and the fit."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from camcal import files
from camcal.arrays import Array
from camcal.dataclass import dataclass, replace
from camcal.errors import InvalidInput
from camcal.estimate.curves.curve import Curve, CurveFit, Data, predictions, predictions_with_jacobian
from camcal.estimate.curves.expressions import CONSTANTS, Expression, parse
from camcal.estimate.curves.families import FAMILIES, Family, family_named
from camcal.estimate.curves.fit import compare, fit_curve, likelihood_intervals
from camcal.estimate.curves.search import LARGEST, SearchOptions
from camcal.formats import emit
from camcal.formats.tables import Table, read_measurements
from camcal.messages import Message
from camcal.parsing import did_you_mean, parse_number
from camcal.progress import SILENT, Progress
from camcal.run.outputs import writes
from camcal.solve.descent import Iteration
from camcal.solve.differentiate import JacobianCheck, check_jacobian
from camcal.tasks.figure_files import write_figures
from camcal.tasks.fit_options import TABLE, FitOptions
from camcal.tasks.fit_report import FIT, FitReport, document, trace_csv, written


@dataclass(frozen=True, eq=False)
class Measured:
    """A table read for fitting.

    x: the columns named by --x. y: the column or formula that is predicted, None where the last column that is not
    sigma is meant. sigma: a number, a column, or None.
    """

    table: Table
    x: tuple[str, ...]
    y: str | None
    sigma: str | None

    def column(self, name: str, option: str) -> Array:
        """Return a column (N,) as numbers; raises InvalidInput for one that is not there or holds other things."""
        if name not in self.table.columns:
            hint = did_you_mean(name, list(self.table.columns))
            raise InvalidInput(f"{option}: no column {name!r}{hint}", where=self.table.path)
        return self._numbers(name)

    def _numbers(self, name: str) -> Array:
        values = self.table.numbers(name)
        self.table.refuse(np.abs(values) > LARGEST, lambda row: f"{name}: {values[row]:g} exceeds the numerical range")
        return values

    def deviations(self) -> Array | None:
        """Return sigma (N,), None if it is not known."""
        if self.sigma is None:
            return None
        try:
            return np.full(len(self.table), float(self.sigma))
        except ValueError:
            return self.column(self.sigma, "--sigma")

    def target_name(self) -> str:
        """Return which column or formula is predicted: --y, else a column y, else the last one left."""
        if self.y is not None:
            return self.y
        left = [name for name in self.table.columns if name != self.sigma and name not in self.x]
        if not left:
            raise InvalidInput(f"{self.table.path} has no column left to predict; choose one with --y")
        return "y" if "y" in left else left[-1]

    def target(self) -> Array:
        """Return what is predicted (N,): a column, or a formula over columns."""
        name = self.target_name()
        if name in self.table.columns or name.isidentifier():
            return self.column(name, "--y")
        formula = parse(name)
        self.refuse_shadowed(formula)
        formula.require_known(list(self.table.columns), f"columns are {', '.join(self.table.columns)}")
        values = np.broadcast_to(formula.value(self.named(formula.names)), len(self.table))
        self.table.refuse(~np.isfinite(values), lambda row: f"--y {name} is {values[row]}")
        return values

    def refuse_shadowed(self, formula: Expression) -> None:
        """Raise InvalidInput if a formula has a constant by whose name there is a column too."""
        for name in formula.constants & self.table.columns.keys():
            raise InvalidInput(
                f"{name!r} is both a column and the constant {CONSTANTS[name]:.6g}; give the column another name",
                where=self.table.path,
            )

    def named(self, names: Sequence[str] | frozenset[str]) -> dict[str, Array]:
        """Return the columns among some names; x stands for the single column of --x."""
        found = {name: self._numbers(name) for name in names if name in self.table.columns}
        if "x" in names and len(self.x) == 1:
            found["x"] = self.column(self.x[0], "--x")
        return found


@dataclass(frozen=True, eq=False)
class Model:
    """A curve, what it is fitted to, and a start for every parameter."""

    curve: Curve
    data: Data
    start: Mapping[str, float]


@writes
def fit(options: FitOptions, progress: Progress = SILENT) -> FitReport:
    """Return the fit of a model to a table, after writing what the options ask for.

    Raises InvalidInput, FileError, InsufficientData; a search that did not converge is written too, see
    `require_settled`.
    """
    table = read_measurements(options.data)
    measured = Measured(table, tuple(_parts(options.x)), options.y, options.sigma)
    fixed, values = fixed_of(options.fix)
    start = starts_of(options.start) | values
    model = model_of(options.model, measured, start)
    other = None if options.compare is None else model_of(options.compare, measured, start)
    _refuse_strangers(options, fixed, start, [model] if other is None else [model, other])
    turns: list[tuple[int, Iteration]] = []
    found = _fit(model, options, fixed, turns)
    second = None if other is None else _fit(other, options, fixed, [])
    report = FitReport(
        found,
        table.lines,
        turns=tuple(turns),
        other=second,
        comparison=None if second is None else compare(found, second),
        intervals=likelihood_intervals(found) if options.profile else None,
        check=_check_derivatives(model) if options.check_jacobian else None,
    )
    _warn(report, progress)
    _write(report, options, table)
    return replace(report, figures=_write_figures(report, options))


def _fit(model: Model, options: FitOptions, fixed: frozenset[str], turns: list[tuple[int, Iteration]]) -> CurveFit:
    search = SearchOptions(bounds_of(options.bounds), fixed, options.loss, options.restarts, options.method)
    return fit_curve(model.curve, model.data, model.start, search, lambda run, turn: turns.append((run, turn)))


def _check_derivatives(model: Model) -> JacobianCheck:
    """Return how far the curve's derivatives at its start are from numerical ones."""
    curve, data = model.curve, model.data
    at = np.array([model.start[name] for name in curve.parameters])
    _, slopes = predictions_with_jacobian(curve, data.columns, at, len(data), curve.parameters)
    analytic = all(formula.analytic for formula in curve.formulas)
    return check_jacobian(lambda p: predictions(curve, data.columns, p, len(data)), slopes, at, analytic=analytic)


def _refuse_strangers(
    options: FitOptions, fixed: frozenset[str], start: dict[str, float], models: Sequence[Model]
) -> None:
    """Raise InvalidInput for a name in an option that is no parameter of any model."""
    known = list(dict.fromkeys(name for model in models for name in model.curve.parameters))
    given = {"--start": start, "--fix": fixed, "--bounds": bounds_of(options.bounds)}
    for option, names in given.items():
        for name in names:
            if name not in known:
                raise InvalidInput(f"{option} {name}: no such parameter{did_you_mean(name, known)}")


def _warn(report: FitReport, progress: Progress) -> None:
    for first, second, value in report.fit.strong_correlations():
        text = f"{first} and {second} are strongly correlated (r = {value:+.4f})"
        progress.warn(Message("strong_correlation", text, {"r": value, "parameters": (first, second)}))


def _write(report: FitReport, options: FitOptions, table: Table) -> None:
    if options.trace not in (None, TABLE):
        files.write_text(Path(str(options.trace)), trace_csv(report.turns))
    if options.plot is not None:
        from camcal.report.figures.curves import fitted_curve
        from camcal.report.figures.figure import encoded

        files.write_bytes(options.plot, encoded(fitted_curve(report.fit), options.plot.suffix))
    if options.output is None:
        return
    content = {"format": FIT, "version": 1, "data": Path(table.path).name, **document(report)}
    if options.output.suffix.lower() != ".json":
        content = written(content)
    files.write_text(options.output, emit.text_for(options.output, content))


def _write_figures(report: FitReport, options: FitOptions) -> tuple[Path, ...]:
    if options.figures.folder is None:
        return ()
    from camcal.report.figures.curves import fitted_curve

    return write_figures(options.figures, (fitted_curve(report.fit),))


def model_of(text: str, measured: Measured, start: Mapping[str, float]) -> Model:
    """Return the model that a text names: a family, or a formula whose parameters all have a start.

    Raises InvalidInput for a word that is neither, an unknown name, a column that is missing.
    """
    family = family_named(text)
    if family is not None:
        columns = _roles(family, measured)
        target = measured.target() if family.explicit else None
        data = Data({role: columns[role] for role in family.roles}, target, measured.deviations())
        curve, own = family.build(columns if target is None else columns | {"y": target})
        return Model(curve, data, {name: start.get(name, own[name]) for name in curve.parameters})
    formula = parse(text)
    if formula.text.isidentifier() and formula.text not in {*measured.table.columns, *start}:
        known = ", ".join(["poly:N", *FAMILIES])
        raise InvalidInput(f"unknown curve {text!r}{did_you_mean(text, list(FAMILIES))}; use one of {known}")
    return _of_formula(formula, measured, start)


def _of_formula(formula: Expression, measured: Measured, start: Mapping[str, float]) -> Model:
    for name in measured.x:
        measured.column(name, "--x")
    if measured.x and "x" not in formula.names:
        raise InvalidInput("--x given, but the model has no x; columns are used by their names")
    measured.refuse_shadowed(formula)
    columns = measured.named(formula.names)
    both = next((name for name in start if name in columns or name in CONSTANTS), None)
    if both is not None:
        raise InvalidInput(f"--start {both}: it is a column or a constant; give the parameter another name")
    if measured.target_name() in columns:
        raise InvalidInput(f"the model contains its target {measured.target_name()!r}; see --y")
    listed = f"columns are {', '.join(measured.table.columns)}, parameters those with a --start"
    formula.require_known([*columns, *start], f"{listed} ({', '.join(start) or 'none'})")
    parameters = [name for name in start if name in formula.names]
    if not parameters:
        raise InvalidInput(f"{formula.text!r} has no parameter to fit; give it one with --start NAME=VALUE")
    curve = Curve(formula.text, (formula,), tuple(parameters))
    data = Data(columns, measured.target(), measured.deviations())
    return Model(curve, data, {name: start[name] for name in parameters})


def _roles(family: Family, measured: Measured) -> dict[str, Array]:
    """Return the columns a family reads: those of --x in order, else those of the same names, else the first ones."""
    spent = {measured.sigma, measured.target_name() if family.explicit else None}
    left = [name for name in measured.table.columns if name not in spent]
    names = measured.x or (family.roles if set(family.roles) <= set(left) else tuple(left[: len(family.roles)]))
    if len(names) != len(family.roles):
        raise InvalidInput(f"{len(family.roles)} columns are needed for {', '.join(family.roles)}, found {len(names)}")
    return {role: measured.column(name, "--x") for role, name in zip(family.roles, names, strict=True)}


def starts_of(text: str | None, option: str = "--start") -> dict[str, float]:
    """Return the values of a text such as a=2,b=-1 by name; raises InvalidInput, naming the option, for others."""
    found: dict[str, float] = {}
    for part in _parts(text):
        name, equals, value = part.partition("=")
        if not equals or not name.strip():
            raise InvalidInput(f"{option} {part!r}: write NAME=VALUE, several with commas, such as a=2,b=-1")
        _once(found, name.strip(), option)
        found[name.strip()] = _number(value, option, part)
    return found


def fixed_of(text: str | None) -> tuple[frozenset[str], dict[str, float]]:
    """Return the names of a text such as a,b=3, and the values of those that have one."""
    names: dict[str, float] = {}
    values = {}
    for part in _parts(text):
        name, equals, value = part.partition("=")
        _once(names, name.strip(), "--fix")
        names[name.strip()] = 0.0
        if equals:
            values[name.strip()] = _number(value, "--fix", part)
    return frozenset(names), values


def bounds_of(text: str | None) -> dict[str, tuple[float, float]]:
    """Return the bounds of a text such as a=0:10,b=:5, where an end left out is open."""
    found: dict[str, tuple[float, float]] = {}
    for part in _parts(text):
        name, equals, ends = part.partition("=")
        low, colon, high = ends.partition(":")
        if not equals or not colon:
            raise InvalidInput(f"--bounds {part!r}: write NAME=LOW:HIGH, such as a=0:10, or a=0: for one end")
        _once(found, name.strip(), "--bounds")
        least = _number(low, "--bounds", part) if low.strip() else -math.inf
        greatest = _number(high, "--bounds", part) if high.strip() else math.inf
        if not least < greatest:
            raise InvalidInput(f"--bounds {part!r}: {least:g} is not below {greatest:g}; --fix holds a parameter")
        found[name.strip()] = least, greatest
    return found


def _parts(text: str | None) -> list[str]:
    return [] if text is None else [part.strip() for part in text.split(",") if part.strip()]


def _once(found: Mapping[str, object], name: str, option: str) -> None:
    if name in found:
        raise InvalidInput(f"{option}: {name!r} occurs twice")


def _number(text: str, option: str, part: str) -> float:
    try:
        value = parse_number(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InvalidInput(f"{option} {part!r}: {text.strip()!r} is not a number")
    return value
