"""From a table and the words of `camcal fit` to a curve, its data and its start."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from camcal.arrays import Array
from camcal.errors import InvalidInput
from camcal.estimate.curves.curve import Curve, Data
from camcal.estimate.curves.expressions import CONSTANTS, Expression, parse
from camcal.estimate.curves.families import FAMILIES, Family, family_named
from camcal.estimate.curves.search import LARGEST
from camcal.formats.schema import did_you_mean
from camcal.formats.tables import Table


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
        self.table.refuse(np.abs(values) > LARGEST, lambda row: f"{name}: {values[row]:g} is too large to compute with")
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
            raise InvalidInput(f"{self.table.path} has no column left to be predicted; say which with --y")
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
                f"{name!r} is a column and the constant {CONSTANTS[name]:.6g}; give the column another name",
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


def model_of(text: str, measured: Measured, start: Mapping[str, float]) -> Model:
    """Return the model that a text names: a family, or a formula whose parameters all have a start.

    Raises InvalidInput for a word that is neither, an unknown name, a column that is missing.
    """
    family = family_named(text)
    if family is not None:
        return _of_family(family, measured, start)
    formula = parse(text)
    if formula.text.isidentifier() and formula.text not in {*measured.table.columns, *start}:
        known = ", ".join(["poly:N", *FAMILIES])
        raise InvalidInput(f"no curve is named {text!r}{did_you_mean(text, list(FAMILIES))}; known are {known}")
    return _of_formula(formula, measured, start)


def _of_formula(formula: Expression, measured: Measured, start: Mapping[str, float]) -> Model:
    for name in measured.x:
        measured.column(name, "--x")
    if measured.x and "x" not in formula.names:
        raise InvalidInput("--x names what x stands for, but there is no x in the model; columns go by their names")
    measured.refuse_shadowed(formula)
    columns = measured.named(formula.names)
    both = next((name for name in start if name in columns or name in CONSTANTS), None)
    if both is not None:
        raise InvalidInput(f"--start {both}: it is a column or a constant; give the parameter another name")
    if measured.target_name() in columns:
        raise InvalidInput(f"the model uses {measured.target_name()!r}, which it is to predict; see --y")
    listed = f"columns are {', '.join(measured.table.columns)}, parameters those with a --start"
    formula.require_known([*columns, *start], f"{listed} ({', '.join(start) or 'none'})")
    parameters = [name for name in start if name in formula.names]
    if not parameters:
        raise InvalidInput(f"{formula.text!r} has no parameter to fit; give it one with --start NAME=VALUE")
    curve = Curve(formula.text, (formula,), tuple(parameters))
    data = Data(columns, measured.target(), measured.deviations())
    return Model(curve, data, {name: start[name] for name in parameters})


def _of_family(family: Family, measured: Measured, start: Mapping[str, float]) -> Model:
    columns = _roles(family, measured)
    target = measured.target() if family.explicit else None
    data = Data({role: columns[role] for role in family.roles}, target, measured.deviations())
    curve, own = family.build(columns if target is None else columns | {"y": target})
    return Model(curve, data, {name: start.get(name, own[name]) for name in curve.parameters})


def _roles(family: Family, measured: Measured) -> dict[str, Array]:
    """Return the columns a family reads: those of --x in order, else those of the same names, else the first ones."""
    spent = {measured.sigma, measured.target_name() if family.explicit else None}
    left = [name for name in measured.table.columns if name not in spent]
    names = measured.x or (family.roles if set(family.roles) <= set(left) else tuple(left[: len(family.roles)]))
    if len(names) != len(family.roles):
        raise InvalidInput(f"{len(family.roles)} columns are needed for {', '.join(family.roles)}, found {len(names)}")
    return {role: measured.column(name, "--x") for role, name in zip(family.roles, names, strict=True)}
