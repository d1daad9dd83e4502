"""The `camcal` command: the list of its subcommands, and the one place where errors become an exit code.

Nothing here imports the core: `camcal --help` is to be there at once.
"""

import faulthandler
import io
import os
import sys
import warnings
from collections.abc import Sequence
from itertools import takewhile
from typing import Annotated, Any, NoReturn

import typer
from typer.core import TyperGroup

from camcal import __version__
from camcal.cli import (
    board,
    calibrate,
    demo,
    demosaic,
    doctor,
    fit,
    inspect,
    optics,
    pnp,
    sensor,
    show,
    simulate,
    smooth,
    stereo_check,
    stereo_cloud,
    stereo_disparity,
    stereo_eval,
    targets,
    track,
    transform,
    transform_poses,
    undistort,
    view,
)
from camcal.cli.options import SETTINGS, LensModelCommand
from camcal.cli.transform_options import NumbersCommand
from camcal.errors import EXIT_BUG, EXIT_INTERRUPTED, EXIT_SIGNAL, InvalidInput, in_one_line, translated
from camcal.images import limits
from camcal.run.startup import BLAS_THREADS, Stopped, stop_on_signals


class Boundary(TyperGroup):
    """The root of all commands; whatever happens below it leaves here as an exit code, a line, and JSON if asked for.

    A bug alone leaves as the exception it is: Python shows the traceback and exits with 1.
    """

    def main(self, args: Sequence[str] | None = None, *_: Any, **__: Any) -> NoReturn:
        arguments = list(sys.argv[1:] if args is None else args)
        with show.documents() as shown:
            try:
                with self.make_context("camcal", list(arguments)) as context:
                    self.invoke(context)
                show.flush()
                code = 0
            except typer.Exit as request:
                code = request.exit_code
            except (Exception, KeyboardInterrupt, Stopped) as error:
                code = self.report(error, arguments, silent=bool(shown))
                if code == EXIT_BUG:
                    raise
        sys.exit(code)

    def report(self, error: BaseException, arguments: list[str], *, silent: bool) -> int:
        """Show what went wrong and return the exit code; `silent` keeps a second document from stdout."""
        if isinstance(error, BrokenPipeError):
            show.give_up_stdout(error)
            return 0
        if isinstance(error, typer.TyperException):
            error = _usage_error(error, self.named_in(arguments))
        code, kind, message, where = _described(error)
        if code != EXIT_BUG:
            show.error(f"{in_one_line(where)}: {message}" if where else message)
        if "--json" in takewhile(lambda argument: argument != "--", arguments) and not silent:
            failure = {"error": {"kind": kind, "message": message, "where": where}, "exit": code}
            show.document(self.named_in(arguments).removeprefix("camcal "), failure)
            show.flush()
        return code

    def named_in(self, arguments: list[str]) -> str:
        """Return the command that a command line names, such as 'camcal stereo cloud'."""
        command: Any = self
        names = ["camcal"]
        for argument in arguments:
            if not isinstance(command, TyperGroup) or argument not in command.commands:
                break
            names.append(argument)
            command = command.commands[argument]
        return " ".join(names)


def _usage_error(error: typer.TyperException, command: str) -> InvalidInput:
    """Return the one-line form of what typer says in several, naming the settings file if the value came from there."""
    words = " ".join(error.format_message().split()).rstrip(".")
    line = _settings_line(getattr(error, "ctx", None), getattr(error, "param", None))
    return InvalidInput(words, where=line) if line else InvalidInput(f"{words}; see '{command} --help'")


def _settings_line(context: Any, parameter: Any) -> str | None:
    """Return the file and line that a refused value came from, None if it does not come from a settings file."""
    if context is None or parameter is None:
        return None
    source = context.get_parameter_source(parameter.name)
    if source is None or source.name != "DEFAULT_MAP":
        return None
    line: str = context.meta[SETTINGS][parameter.name]
    return line


def _described(error: BaseException) -> tuple[int, str, str, str | None]:
    """Return exit code, kind, message and place of an error."""
    if (known := translated(error)) is not None:
        return known.exit_code, known.kind, known.message, known.where
    if isinstance(error, Stopped):
        return EXIT_SIGNAL + error.signal, "stopped", f"stopped ({error.signal.name})", None
    if isinstance(error, KeyboardInterrupt):
        return EXIT_INTERRUPTED, "interrupted", "interrupted", None
    return EXIT_BUG, "bug", f"{type(error).__name__}: {error}", None


def _show_version(wanted: bool) -> None:
    if wanted:
        show.text(f"camcal {__version__}")
        raise typer.Exit


app = typer.Typer(
    cls=Boundary,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["--help", "-h"], "max_content_width": 100},
)


@app.callback(invoke_without_command=True)
def camcal(
    context: typer.Context,
    version: Annotated[
        bool, typer.Option("--version", is_eager=True, callback=_show_version, help="Print the version and leave.")
    ] = False,
) -> None:
    """Calibrate, rectify and measure with cameras from the shell, and know when not to trust the result."""
    if context.invoked_subcommand is None:
        typer.echo(context.get_help(), err=True)
        raise typer.Exit(InvalidInput.exit_code)


stereo_app = typer.Typer(help="What two cameras measure.")
stereo_app.command("check")(stereo_check.check)
stereo_app.command("disparity")(stereo_disparity.disparity)
stereo_app.command("cloud")(stereo_cloud.cloud)
stereo_app.command("eval")(stereo_eval.evaluate)

transform_app = typer.Typer(help="Poses and frames: compose, invert, chain, convert, apply.")
transform_app.command("chain", cls=NumbersCommand)(transform.chain)
transform_app.command("eval", cls=NumbersCommand)(transform.evaluate)
transform_app.command("compose", cls=NumbersCommand)(transform.compose)
transform_app.command("invert", cls=NumbersCommand)(transform.invert)
transform_app.command("convert", cls=NumbersCommand)(transform_poses.convert)
transform_app.command("average", cls=NumbersCommand)(transform_poses.average)
transform_app.command("check", cls=NumbersCommand)(transform_poses.check)
transform_app.command("points", cls=NumbersCommand)(transform_poses.points)

app.command("demo")(demo.demo)
app.command("simulate", cls=LensModelCommand)(simulate.simulate)
app.command("board")(board.board)
app.command("detect")(targets.detect)
app.command("calibrate", cls=LensModelCommand)(calibrate.calibrate)
app.command("undistort")(undistort.undistort)
app.command("inspect")(inspect.inspect)
app.command("demosaic")(demosaic.demosaic)
app.command("sensor")(sensor.sensor)
app.add_typer(stereo_app, name="stereo")
app.command("view")(view.view)
app.command("pnp")(pnp.pnp)
app.command("track")(track.track)
app.command("smooth")(smooth.smooth)
app.command("fit")(fit.fit)
app.add_typer(transform_app, name="transform")
app.command("optics")(optics.optics)
app.command("doctor")(doctor.doctor)


def main() -> None:
    """Run `camcal` as a program of its own: the console script."""
    prepare()
    app()


def prepare() -> None:
    """Make this process one of the command line: its threads, its limits, how it is stopped, and that it alone speaks.

    Worker processes inherit what stands in the environment.
    """
    # One BLAS thread: sums in another order would give other digits on a machine with other cores.
    for name in BLAS_THREADS:
        os.environ.setdefault(name, "1")
    limits.set_default()
    if not sys.warnoptions:  # whoever asks for Python's warnings has them
        warnings.simplefilter("ignore")
        os.environ.setdefault("PYTHONWARNINGS", "ignore")
    stop_on_signals()
    _keep_c_libraries_quiet()


def _keep_c_libraries_quiet() -> None:
    """Send what libpng, libjpeg and OpenCV print by themselves to nowhere; what we print still reaches stderr.

    They write about damaged files to file descriptor 2, past Python; the user hears of those files in our words.
    """
    os.environ.setdefault("OPENCV_LOG_LEVEL", "SILENT")
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # a file name need not be valid text
            stream.reconfigure(errors="backslashreplace")
    if sys.stderr is None:
        return
    ours = os.dup(sys.stderr.fileno())
    sys.stderr = os.fdopen(ours, "w", buffering=1, encoding=sys.stderr.encoding, errors="backslashreplace")
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 2)
    os.close(nowhere)
    faulthandler.enable(sys.stderr)  # a crash in a C library still says where
