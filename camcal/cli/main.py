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
from camcal.cli import show
from camcal.cli.catalogue import CommandGroup
from camcal.errors import EXIT_BUG, EXIT_INTERRUPTED, EXIT_SIGNAL, InvalidInput, in_one_line, translated
from camcal.images import limits
from camcal.run.process import BLAS_THREADS, Stopped, stop_on_signals


class Boundary(CommandGroup):
    """The root of all commands; whatever happens below it leaves here as an exit code, a line, and JSON if asked for.

    A bug alone leaves as the exception it is: Python shows the traceback and exits with 1.
    """

    def main(self, args: Sequence[str] | None = None, *_: Any, **__: Any) -> NoReturn:
        arguments = list(sys.argv[1:] if args is None else args)
        self._main_shell_completion({}, "camcal")  # only where the shell asks, by a variable of the environment
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
    from camcal.cli.command import settings_line

    line = settings_line(getattr(error, "ctx", None), getattr(getattr(error, "param", None), "name", None))
    return InvalidInput(words, where=line) if line else InvalidInput(f"{words}; see '{command} --help'")


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
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["--help", "-h"], "max_content_width": 100},
)


@app.callback()
def camcal(
    version: Annotated[
        bool, typer.Option("--version", is_eager=True, callback=_show_version, help="Print the version and exit.")
    ] = False,
) -> None:
    """Calibrate, rectify and measure with cameras from the shell, and know when not to trust the result."""


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
