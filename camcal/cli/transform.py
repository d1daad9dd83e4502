"""`camcal transform chain`, `eval`, `compose` and `invert`."""

from typing import TYPE_CHECKING, Annotated

import typer

from camcal.cli import options as shared
from camcal.cli import show
from camcal.cli import transform_options as poses

if TYPE_CHECKING:
    from camcal.tasks.frames.transform import Made
    from camcal.tasks.frames.transform_output import Output


def chain(
    sources: poses.Poses,
    target: Annotated[str, typer.Option("--to", metavar="FRAME", help="The frame to come to: base of base_T_tag.")],
    source: Annotated[str, typer.Option("--from", metavar="FRAME", help="The frame to come from: tag of base_T_tag.")],
    loop_mm: Annotated[
        float,
        typer.Option(metavar="MM", help="How far a loop of transforms without covariances may be from closing."),
    ] = 1.0,
    loop_deg: Annotated[float, typer.Option(metavar="DEGREES", help="How far such a loop may be turned.")] = 0.1,
    form: poses.Given = None,
    written: poses.As = None,
    output: poses.OutputFile = None,
    json: shared.Json = False,
    quiet: shared.Quiet = False,
    verbose: shared.Verbose = False,
    config: shared.Config = None,
) -> None:
    """Join two named frames by way of the transforms between them, with the covariance of what comes out.

    Frames are joined by their names alone. Where transforms form a loop, how far it is from closing is said, and one
    that does not close is refused.
    """
    from camcal.tasks.frames.transform import ChainOptions
    from camcal.tasks.frames.transform import chain as run
    from camcal.tasks.frames.transform_output import Output

    where = Output(output, written)
    made = run(ChainOptions(sources, target, source, form, where, loop_mm, loop_deg), show.progress(quiet))
    _give("transform chain", made, where, json=json, quiet=quiet, verbose=verbose)


def evaluate(
    expression: Annotated[
        str, typer.Argument(metavar="EXPRESSION", help="Such as 'a_T_b * inv(c_T_b)': names, *, inv() and brackets.")
    ],
    sources: Annotated[
        list[str],
        typer.Option("--frames", "-f", metavar="POSE", help="Where the transforms are; may be given several times."),
    ],
    form: poses.Given = None,
    written: poses.As = None,
    output: poses.OutputFile = None,
    json: shared.Json = False,
    quiet: shared.Quiet = False,
    verbose: shared.Verbose = False,
    config: shared.Config = None,
) -> None:
    """Work out a product of named transforms; inner frames must cancel.

    A transform that occurs twice is one quantity: what cancels has no uncertainty left.
    """
    from camcal.tasks.frames.transform import ExpressionOptions
    from camcal.tasks.frames.transform import evaluate as run
    from camcal.tasks.frames.transform_output import Output

    where = Output(output, written)
    made = run(ExpressionOptions(expression, sources, form, where), show.progress(quiet))
    _give("transform eval", made, where, json=json, quiet=quiet, verbose=verbose)


def compose(
    sources: poses.Poses,
    form: poses.Given = None,
    written: poses.As = None,
    output: poses.OutputFile = None,
    json: shared.Json = False,
    quiet: shared.Quiet = False,
    verbose: shared.Verbose = False,
    config: shared.Config = None,
) -> None:
    """Multiply poses in their order: a_T_b, then b_T_c, gives a_T_c.

    Frames that are named must meet; poses without names are taken to fit.
    """
    from camcal.tasks.frames.transform import PosesOptions
    from camcal.tasks.frames.transform import compose as run
    from camcal.tasks.frames.transform_output import Output

    where = Output(output, written)
    made = run(PosesOptions(sources, form, where), show.progress(quiet))
    _give("transform compose", made, where, json=json, quiet=quiet, verbose=verbose)


def invert(
    sources: poses.Poses,
    form: poses.Given = None,
    written: poses.As = None,
    output: poses.OutputFile = None,
    json: shared.Json = False,
    quiet: shared.Quiet = False,
    verbose: shared.Verbose = False,
    config: shared.Config = None,
) -> None:
    """Invert poses, all of a file if it holds several: b_T_a from a_T_b, the covariance with it."""
    from camcal.tasks.frames.transform import PosesOptions
    from camcal.tasks.frames.transform import invert as run
    from camcal.tasks.frames.transform_output import Output

    where = Output(output, written)
    made = run(PosesOptions(sources, form, where), show.progress(quiet))
    _give("transform invert", made, where, json=json, quiet=quiet, verbose=verbose)


def _give(command: str, made: "Made", output: "Output", *, json: bool, quiet: bool, verbose: bool) -> None:
    from camcal.tasks.frames.transform import document

    if json:
        show.document(command, document(made, output))
    elif not quiet:
        _show(made, output, verbose=verbose)


def _show(made: "Made", output: "Output", *, verbose: bool) -> None:
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
