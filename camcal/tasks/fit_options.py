"""The options of `camcal fit`."""

from pathlib import Path
from typing import Annotated

from camcal.dataclass import dataclass
from camcal.errors import InvalidInput
from camcal.options import INPUT, OUTPUT, Argument, Option, OptionsRecord, Written
from camcal.tasks.options import FIGURES, NO_FIGURES, FigureOptions, Overwrite, output_option

LOSSES = ("none", "huber", "soft_l1", "cauchy", "tukey")
METHODS = ("levenberg-marquardt", "gauss-newton")
OUTPUTS = (".yaml", ".yml", ".json")
TRACES = (".csv",)
TABLE = "table"


@dataclass(frozen=True)
class FitOptions(OptionsRecord):
    """A table, a model (a formula or a family) and how to fit it; texts are as on the command line.

    x: columns for the roles of a family, or the one that x stands for in a formula. trace: 'table', or a CSV file.
    """

    data: Annotated[Path, Argument("CSV whose first row names the columns.", metavar="DATA")]
    model: Annotated[
        str,
        Option(
            "A formula over columns and parameters, such as 'exp(a*x**2 + b*x + c)'; or one of poly:N, expquad, "
            "gauss, thin_lens, gamma, noise, edge, circle, line2d, plane, line3d.",
            metavar="EXPR|FAMILY",
            names="--model -m",
        ),
    ]
    start: Annotated[str | None, Option("Start values; curve families need none.", metavar="A=V,…")] = None
    y: Annotated[
        str | None,
        Option("Dependent variable: a column (by default y, or the last), or log(y).", metavar="COLUMN", group=INPUT),
    ] = None
    x: Annotated[
        str | None, Option("Independent variable: a column; for shapes x,y or x,y,z.", metavar="COLUMNS", group=INPUT)
    ] = None
    sigma: Annotated[
        str | None,
        Option("Standard deviation of the data; by default from the residuals.", metavar="VALUE|COLUMN", group=INPUT),
    ] = None
    bounds: Annotated[str | None, Option("Bounds; a side left out is unbounded.", metavar="A=LOW:HIGH,…")] = None
    fix: Annotated[
        str | None, Option("Parameters fixed at their start value, or at a given value.", metavar="A,B=V,…")
    ] = None
    loss: Annotated[
        str, Option("Robust loss against outliers.", metavar="none|huber|soft_l1|cauchy|tukey", choices=LOSSES)
    ] = "none"
    restarts: Annotated[int, Option("Number of additional random starts.", metavar="N", least=0, most=1000)] = 0
    method: Annotated[
        str,
        Option(
            "Optimiser; plain Gauss-Newton is for comparison.",
            metavar="levenberg-marquardt|gauss-newton",
            choices=METHODS,
        ),
    ] = METHODS[0]
    compare: Annotated[
        str | None, Option("Second model to compare by AIC, AICc, BIC and F test.", metavar="EXPR|FAMILY")
    ] = None
    profile: Annotated[bool, Option("Also compute profile-likelihood intervals, which may be asymmetric.")] = False
    trace: Annotated[
        str | None,
        Option(
            "Show every iteration (cost, damping, gain ratio, step), or write it to a .csv.",
            metavar="FILE|table",
            group=OUTPUT,
            recorded=False,
            written=Written(TRACES, words=(TABLE,)),
        ),
    ] = None
    check_jacobian: Annotated[bool, Option("Check the derivatives against numerical ones.")] = False
    plot: Annotated[
        Path | None,
        Option(
            "Plot of data, curve and residuals: .png, .svg or .pdf.",
            metavar="PATH",
            group=OUTPUT,
            recorded=False,
            written=FIGURES,
        ),
    ] = None
    output: Annotated[
        Path | None,
        output_option("Output file: .yaml or .json.", Written(OUTPUTS, stdout=True)),
    ] = None
    figures: FigureOptions = NO_FIGURES
    overwrite: Overwrite = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.loss != "none" and (self.profile or self.compare):
            option = "--profile" if self.profile else "--compare"
            raise InvalidInput(f"{option} needs a likelihood, not a robust loss; leave --loss {self.loss} out")

    def outputs(self) -> list[Path]:
        """Return the files that are written."""
        trace = [] if self.trace in (None, TABLE) else [Path(str(self.trace))]
        return [*trace, *(path for path in (self.plot, self.output) if path is not None)]
