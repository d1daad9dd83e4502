"""The `camcal` command: the list of its subcommands, and the one place where errors become an exit code.

Nothing here imports the core, and a subcommand is imported when it is called: `camcal --help` is to be there at once.
"""

import faulthandler
import io
import os
import re
import sys
import warnings
from collections.abc import Iterator, MutableMapping, Sequence
from contextlib import suppress
from importlib import import_module
from itertools import takewhile
from typing import Annotated, Any, NamedTuple, NoReturn

import typer
from typer.core import CompletionItem, TyperGroup  # type: ignore[attr-defined] # what its own groups return

from camcal import __version__
from camcal.cli import examples, show
from camcal.cli.call import TextParameters
from camcal.errors import EXIT_BUG, EXIT_INTERRUPTED, EXIT_SIGNAL, FileError, InvalidInput, translated
from camcal.images.options import set_default_max_pixels
from camcal.parsing import in_one_line, nearest
from camcal.run.process import BLAS_THREADS, Stopped, require_address_space, stop_on_signals


class Entry(NamedTuple):
    """A command or a group: its full name, where its function is ('module:function', none for a group), its line in
    the list of commands.
    """

    name: str
    function: str
    summary: str


COMMANDS = (
    Entry("demo", "simulate:demo", "Calibrate rendered images and compare with ground truth."),
    Entry("simulate", "simulate:simulate", "Render images of a board, or stereo pairs, with ground truth."),
    Entry("board", "simulate:board", "Draw a calibration board for printing at true scale."),
    Entry("detect", "calibrate:detect", "Find the corners of a board in images."),
    Entry("calibrate", "calibrate:calibrate", "Calibrate one camera from images of a board."),
    Entry("rig", "calibrate:rig", "Calibrate several cameras together."),
    Entry("report", "inspect:report", "Write a report as one HTML file."),
    Entry("rerun", "inspect:rerun", "Calibrate again from a report and compare."),
    Entry("undistort", "images:undistort", "Undistort images, videos or points."),
    Entry("plot", "inspect:plot", "Draw figures of result files."),
    Entry("convert", "inspect:convert", "Convert camera files from and to those of other programs."),
    Entry("inspect", "inspect:inspect", "Show a camera file or a raw frame."),
    Entry("handeye", "poses:handeye", "Calibrate where a camera stands on a robot."),
    Entry("check", "inspect:check", "Check by new images whether a calibration still holds."),
    Entry("diff", "inspect:diff", "Compare cameras: the same, moved, or another."),
    Entry("advise", "calibrate:advise", "Suggest the views to take next."),
    Entry("demosaic", "images:demosaic", "Demosaic raw frames."),
    Entry("sensor", "images:sensor", "Measure a sensor by photon transfer (EMVA 1288)."),
    Entry("stereo", "", "Calibrate, rectify, check and match pairs; point clouds."),
    Entry("stereo calibrate", "calibrate:stereo_calibrate", "Calibrate a pair of cameras."),
    Entry("stereo rectify", "stereo:rectify", "Rectify the images of two cameras."),
    Entry("stereo run", "stereo:run", "From two folders to point clouds in one command."),
    Entry("stereo check", "stereo:check", "Check the rectification of a stereo pair."),
    Entry("stereo disparity", "stereo:disparity", "Compute the disparity map of a pair."),
    Entry("stereo cloud", "stereo:cloud", "Compute a point cloud from a disparity map or a pair."),
    Entry("stereo eval", "stereo:evaluate", "Evaluate a disparity map against ground truth."),
    Entry("view", "stereo:view", "View a point cloud or a disparity map."),
    Entry("pnp", "poses:pnp", "Estimate poses from points, a board or tags."),
    Entry("track", "poses:track", "Track a board or tags over a video."),
    Entry("smooth", "poses:smooth", "Smooth trajectories or time series."),
    Entry("fit", "poses:fit", "Fit a formula, a curve or a shape to data."),
    Entry("transform", "", "Compose, invert, chain, convert and apply poses."),
    Entry("transform chain", "transform:chain", "Chain the transforms between two frames."),
    Entry("transform eval", "transform:evaluate", "Evaluate a product of named transforms."),
    Entry("transform compose", "transform:compose", "Multiply poses in their order."),
    Entry("transform invert", "transform:invert", "Invert poses."),
    Entry("transform convert", "transform:convert", "Convert poses to another representation."),
    Entry("transform average", "transform:average", "Average several estimates of one pose."),
    Entry("transform check", "transform:check", "Check whether poses are valid."),
    Entry("transform points", "transform:points", "Transform the points of a file to another frame."),
    Entry("optics", "images:optics", "Compute field of view, depth of field, resolution."),
    Entry("run", "pipeline:run", "Run a pipeline of commands from one file."),
    Entry("doctor", "inspect:doctor", "Check the installation."),
)


_UNKNOWN_COMMAND, _LIKENESS = re.compile(r"No such command '([^']+)'"), 0.85  # of a command of a group


class Commands(MutableMapping[str, Any]):
    """The commands directly below a group, by their own names; each is imported when it is asked for."""

    def __init__(self, above: str = "") -> None:
        below = [entry for entry in COMMANDS if entry.name.rpartition(" ")[0] == above]
        self.entries = {entry.name.rpartition(" ")[2]: entry for entry in below}
        self.made: dict[str, Any] = {}

    def __getitem__(self, name: str) -> Any:
        if name not in self.made:
            self.made[name] = _make_command(self.entries[name])
        return self.made[name]

    def __setitem__(self, name: str, command: Any) -> None:
        self.made[name] = command
        self.entries[name] = Entry(name, "", command.get_short_help_str())

    def __delitem__(self, name: str) -> None:
        del self.entries[name], self.made[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.entries)

    def __len__(self) -> int:
        return len(self.entries)

    def summaries(self) -> list[tuple[str, str]]:
        """Return names and lines of help, importing nothing."""
        return [(name, entry.summary) for name, entry in self.entries.items()]


class CommandGroup(TextParameters, TyperGroup):
    """A group of commands that prints its help, as a usage error, where it is called without one."""

    def __init__(self, *, commands: Any = None, above: str = "", **attributes: Any) -> None:
        super().__init__(**attributes)
        self.commands: Any = Commands(above)
        self.commands.update(commands or {})

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse what stands before the command's name."""
        if not args and not ctx.resilient_parsing:
            typer.echo(ctx.get_help(), err=True)
            raise typer.Exit(InvalidInput.exit_code)
        return super().parse_args(ctx, args)

    def format_commands(self, ctx: Any, formatter: Any) -> None:  # noqa: ARG002 - typer calls it so
        """Write the list of commands without importing them."""
        with formatter.section("Commands"):
            formatter.write_dl(self.commands.summaries())

    def shell_complete(self, ctx: Any, incomplete: str) -> list[CompletionItem]:
        """Return what may be meant: commands, then options."""
        found = [
            CompletionItem(name, help=said) for name, said in self.commands.summaries() if name.startswith(incomplete)
        ]
        return found + super(TyperGroup, self).shell_complete(ctx, incomplete)


def _make_command(entry: Entry) -> Any:
    """Return a command with what it imports, or a group."""
    if not entry.function:
        return CommandGroup(name=entry.name, above=entry.name, help=entry.summary, rich_markup_mode=None)
    from camcal.cli.command import command

    module, _, function = entry.function.partition(":")
    return command(entry.name, getattr(import_module(f"camcal.cli.{module}"), function))


class Boundary(CommandGroup):
    """The root of all commands; whatever happens below it leaves here as an exit code, a line, and JSON if asked for.

    A bug alone leaves as the exception it is: Python shows the traceback and exits with 1.
    """

    def main(self, args: Sequence[str] | None = None, *_: Any, **__: Any) -> NoReturn:
        arguments = list(sys.argv[1:] if args is None else args)
        self._main_shell_completion({}, "camcal")  # only where the shell asks, by a variable of the environment
        with show.session() as session:
            try:
                with self.make_context("camcal", list(arguments)) as context:
                    self.invoke(context)
                if session.command is not None:
                    session.document(session.command, {})
                show.flush()
                code = 0
            except typer.Exit as request:
                code = request.exit_code
            except (Exception, KeyboardInterrupt, Stopped) as error:
                code = self.report(error, arguments, session)
                if code == EXIT_BUG:
                    raise
        sys.exit(code)

    def report(self, error: BaseException, arguments: list[str], session: show.Session) -> int:
        """Show what went wrong, with what the command had to say until then, and return the exit code."""
        if isinstance(error, BrokenPipeError):
            show.discard_stdout(error)
            return 0
        if isinstance(error, typer.TyperException):
            error = _usage_error(error, self.named_in(arguments))
        code, kind, message, where = _describe(error)
        if isinstance(error, (KeyboardInterrupt, Stopped)):
            message += self.what_is_left(arguments)
        if code != EXIT_BUG:
            show.error(f"{in_one_line(where)}: {message}" if where else message)
            _annotate([str(each) for each in getattr(error, "failures", ())] or [message])
        if code == InvalidInput.exit_code and ["camcal", *arguments] == (named := self.named_in(arguments)).split():
            calls = examples.calls(named.removeprefix("camcal "))
            show.examples([] if named in calls else calls)
        if "--json" in takewhile(lambda argument: argument != "--", arguments):
            failure = {"error": {"kind": kind, "message": message, "where": where}, "exit": code}
            try:
                name = self.named_in(arguments).removeprefix("camcal ")
                session.document(name, failure, getattr(error, "failures", ()))
                show.flush()
            except FileError as full:
                show.error(str(full))
                return full.exit_code if code != EXIT_BUG else code
        return code

    def named_in(self, arguments: list[str]) -> str:
        """Return the command that a command line names, such as 'camcal stereo cloud'."""
        return self.found_in(arguments)[0]

    def found_in(self, arguments: list[str]) -> tuple[str, Any]:
        """Return the name of the command that a command line means, and the command."""
        command: Any = self
        names = ["camcal"]
        for argument in arguments:
            if not isinstance(command, TyperGroup) or argument not in command.commands:
                break
            names.append(argument)
            command = command.commands[argument]
        return " ".join(names), command

    def what_is_left(self, arguments: list[str]) -> str:
        """Return how a command that was ended from outside does the rest only; empty if it begins again."""
        name, command = self.found_in(arguments)
        if name == "camcal run":
            return "; repeat it to run the steps that are left"
        options = {each.name for each in getattr(command, "declared", ())}
        return "; repeat it with --resume to do only what is left" if "--resume" in options else ""


def _annotate(errors: Sequence[str]) -> None:
    """Print errors once more as annotations of GitHub, in its runners only: a page shows them beside the run."""
    if os.environ.get("GITHUB_ACTIONS") != "true" or sys.stderr is None:
        return
    with suppress(OSError):
        for each in errors:
            text = each.replace("%", "%25").replace("\r", "%0D").replace("\n", "%0A")
            print(f"::error title=camcal::{text}", file=sys.stderr)  # noqa: T201


def _usage_error(error: typer.TyperException, command: str) -> InvalidInput:
    """Return the one-line form of what typer says in several, naming the settings file if the value came from there."""
    words = " ".join(error.format_message().split()).rstrip(".")
    if unknown := _UNKNOWN_COMMAND.match(words):
        below = {each.name.rpartition(" ")[2]: each.name for each in COMMANDS if " " in each.name}
        found = nearest(unknown[1].rpartition("-")[2], below, _LIKENESS)
        words = f"{unknown[0]}. Did you mean {below[found]!r}?" if found else words
    from camcal.cli.command import settings_line

    line = settings_line(getattr(error, "ctx", None), getattr(getattr(error, "param", None), "name", None))
    return InvalidInput(words, where=line) if line else InvalidInput(f"{words}; see '{command} --help'")


def _describe(error: BaseException) -> tuple[int, str, str, str | None]:
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
    version: Annotated[  # noqa: ARG001 its callback has done all
        bool, typer.Option("--version", is_eager=True, callback=_show_version, help="Print the version and exit.")
    ] = False,
) -> None:
    """Calibrate, rectify and measure with cameras from the shell, and know when not to trust the result."""
    require_address_space()


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
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")  # typer's; it would read about every package there is
    set_default_max_pixels()
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
