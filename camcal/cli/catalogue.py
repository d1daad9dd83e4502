"""All commands, and groups of them that import a command when it is called: `camcal --help` is to be there at once."""

from collections.abc import Iterator, MutableMapping
from importlib import import_module
from typing import Any, NamedTuple

import typer
from typer.core import CompletionItem, TyperGroup  # type: ignore[attr-defined] # what its own groups return

from camcal.errors import InvalidInput


class Entry(NamedTuple):
    """A command or a group: its full name, where its function is ('module:function', none for a group), its line in
    the list of commands.
    """

    name: str
    function: str
    summary: str


COMMANDS = (
    Entry("demo", "simulate:demo", "Simulate, calibrate and undistort, without any input."),
    Entry("simulate", "simulate:simulate", "Render images of a board, or rectified pairs, with the truth."),
    Entry("board", "calibrate:board", "Draw a board to print at true scale."),
    Entry("detect", "calibrate:detect", "Find the corners of a board in images."),
    Entry("calibrate", "calibrate:calibrate", "Calibrate one camera from images of a board."),
    Entry("undistort", "undistort:undistort", "Undistort images, videos or points."),
    Entry("inspect", "inspect:inspect", "Show a camera file or a raw frame."),
    Entry("demosaic", "raw:demosaic", "Make colour images from raw frames."),
    Entry("sensor", "raw:sensor", "Measure a sensor by photon transfer (EMVA 1288)."),
    Entry("stereo", "", "Check, match and measure rectified pairs; point clouds."),
    Entry("stereo check", "stereo:check", "Say how good a rectified pair is."),
    Entry("stereo disparity", "stereo:disparity", "Match rectified pairs."),
    Entry("stereo cloud", "stereo:cloud", "Make a point cloud from a disparity map."),
    Entry("stereo eval", "stereo:evaluate", "Compare a disparity map with the truth."),
    Entry("view", "stereo:view", "Look at a point cloud or a disparity map."),
    Entry("pnp", "poses:pnp", "Find poses from points, a board or tags."),
    Entry("track", "poses:track", "Follow a board or tags over a video."),
    Entry("smooth", "poses:smooth", "Smooth poses or numbers over time."),
    Entry("fit", "fit:fit", "Fit a formula, a curve or a shape to data."),
    Entry("transform", "", "Compose, invert, chain, convert and apply poses."),
    Entry("transform chain", "transform:chain", "Join two named frames."),
    Entry("transform eval", "transform:evaluate", "Work out a product of named transforms."),
    Entry("transform compose", "transform:compose", "Multiply poses in their order."),
    Entry("transform invert", "transform:invert", "Invert poses."),
    Entry("transform convert", "transform:convert", "Write poses in another form."),
    Entry("transform average", "transform:average", "Average several estimates of one pose."),
    Entry("transform check", "transform:check", "Say whether poses are valid."),
    Entry("transform points", "transform:points", "Take the points of a file to another frame."),
    Entry("optics", "optics:optics", "Work out field of view, depth of field, resolution."),
    Entry("doctor", "doctor:doctor", "Say what is installed and what is in the way."),
)


class Commands(MutableMapping[str, Any]):
    """The commands directly below a group, by their own names; each is imported when it is asked for."""

    def __init__(self, above: str = "") -> None:
        below = [entry for entry in COMMANDS if entry.name.rpartition(" ")[0] == above]
        self.entries = {entry.name.rpartition(" ")[2]: entry for entry in below}
        self.made: dict[str, Any] = {}

    def __getitem__(self, name: str) -> Any:
        if name not in self.made:
            self.made[name] = _made(self.entries[name])
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


class CommandGroup(TyperGroup):
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


def _made(entry: Entry) -> Any:
    """Return a command with what it imports, or a group."""
    if not entry.function:
        return CommandGroup(name=entry.name, above=entry.name, help=entry.summary, rich_markup_mode=None)
    from camcal.cli.command import command

    module, _, function = entry.function.partition(":")
    return command(entry.name, getattr(import_module(f"camcal.cli.{module}"), function))
