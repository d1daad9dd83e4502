"""The nonlinear regression problems of NIST's Statistical Reference Datasets (NIST StRD), as they are published.

A file names its data columns, its model, two starts, and values and standard deviations certified to 11 digits.
"""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from camcal.estimate.curves.curve import Curve, Data
from camcal.estimate.curves.expressions import parse

NAMES = (
    *("Bennett5", "BoxBOD", "Chwirut1", "Chwirut2", "DanWood", "ENSO", "Eckerle4", "Gauss1", "Gauss2", "Gauss3"),
    *("Hahn1", "Kirby2", "Lanczos1", "Lanczos2", "Lanczos3", "MGH09", "MGH10", "MGH17", "Misra1a", "Misra1b"),
    *("Misra1c", "Misra1d", "Nelson", "Rat42", "Rat43", "Roszman1", "Thurber"),
)
MOST_DIGITS = 11.0  # that are certified


@dataclass(frozen=True)
class Problem:
    """A model and its data, two starts (2, K), certified values and standard deviations (K,), that of residuals."""

    curve: Curve
    data: Data
    starts: np.ndarray
    values: np.ndarray
    deviations: np.ndarray
    residual_deviation: float

    def start(self, number):
        """Return start 1 or 2 by parameter name."""
        return dict(zip(self.curve.parameters, self.starts[number - 1], strict=True))


def read(path: Path) -> Problem:
    """Return the problem of a file."""
    lines = path.read_text().splitlines()
    rows = [line.replace("=", " ").split() for line in lines if re.match(r"\s*b\d+\s*=\s*[-.\d]", line)]
    numbers = np.array([row[1:] for row in rows], dtype=float)
    header = max(index for index, line in enumerate(lines) if line.startswith("Data:"))
    table = np.array([line.split() for line in lines[header + 1 :] if line.strip()], dtype=float)
    columns = dict(zip(lines[header].removeprefix("Data:").split(), table.T, strict=True))
    model = " ".join(lines).partition("Model:")[2]
    target, formula = _model(re.split(r"Starting [vV]alues", model)[0])
    measured = parse(target).value({"y": columns.pop("y")})
    curve = Curve(path.stem, (parse(formula),), tuple(row[0] for row in rows))
    residual = next(float(line.split(":")[1]) for line in lines if line.startswith("Residual Standard Deviation:"))
    return Problem(curve, Data(columns, measured), numbers[:, :2].T, numbers[:, 2], numbers[:, 3], residual)


def _model(text: str) -> tuple[str, str]:
    """Return both sides of the model in the syntax of formulas."""
    found = re.search(r"\s(y|log\[y\])\s*=\s*(.*?)\s*\+\s*e\s*$", text)
    if found is None:
        raise ValueError(f"no model in {text[-200:]!r}")
    left, right = (re.sub(r"\s+", " ", side).replace("[", "(").replace("]", ")") for side in found.groups())
    return left, right.replace("arctan", "atan")


def digits(found, certified):
    """Return the number of correct digits of the worst value: the least -log10 of the relative errors."""
    errors = np.abs(np.asarray(found) - certified) / np.abs(certified)
    return float(np.min(np.clip(-np.log10(np.maximum(errors, 1e-300)), 0, MOST_DIGITS)))
