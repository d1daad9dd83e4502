"""`camcal transform chain`, `eval`, `compose` and `invert`."""

from typing import TYPE_CHECKING

from camcal.cli import show
from camcal.cli.command import Call
from camcal.tasks.frames.options import ChainOptions, ExpressionOptions, Output, PosesOptions

if TYPE_CHECKING:
    from camcal.tasks.frames.transform import Made


def chain(options: ChainOptions, call: Call) -> None:
    """Join two named frames by way of the transforms between them, with the covariance of what comes out.

    Frames are joined by their names alone. Where transforms form a loop, how far it is from closing is said, and one
    that does not close is refused.
    """
    from camcal.tasks.frames.transform import chain as run

    _give(run(options, call.progress), options.output, call)


def evaluate(options: ExpressionOptions, call: Call) -> None:
    """Work out a product of named transforms; inner frames must cancel.

    A transform that occurs twice is one quantity: what cancels has no uncertainty left.
    """
    from camcal.tasks.frames.transform import evaluate as run

    _give(run(options, call.progress), options.output, call)


def compose(options: PosesOptions, call: Call) -> None:
    """Multiply poses in their order: a_T_b, then b_T_c, gives a_T_c.

    Frames that are named must meet; poses without names are taken to fit.
    """
    from camcal.tasks.frames.transform import compose as run

    _give(run(options, call.progress), options.output, call)


def invert(options: PosesOptions, call: Call) -> None:
    """Invert poses, all of a file if it holds several: b_T_a from a_T_b, the covariance with it."""
    from camcal.tasks.frames.transform import invert as run

    _give(run(options, call.progress), options.output, call)


def _give(made: "Made", output: Output, call: Call) -> None:
    from camcal.tasks.frames.transform import document

    call.give(lambda: document(made, output), lambda: _show(made, output, verbose=call.verbose))


def _show(made: "Made", output: Output, *, verbose: bool) -> None:
    """Print transforms and what they were made of; beside bare numbers only where ways differ, as remarks."""
    from camcal.report.transform import lines, loop_lines

    if output.numbers is not None and made.loops:
        for line in (f"made of {made.products[0]}", *loop_lines(made.loops)):
            show.text(f"# {line}")
    for transform, factors in zip(made.transforms, made.products, strict=True):
        for line in lines(transform, output.numbers, verbose=verbose):
            show.text(line)
        if output.numbers is None:
            show.text(f"  {'made of':<20}  {factors}")
    if output.numbers is None:
        for line in loop_lines(made.loops):
            show.text(line)
        if output.path is not None:
            show.text(f"wrote {output.path}")
