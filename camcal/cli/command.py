"""A command made of its options: what typer parses, what the help says, and the records the command is called with.

A command is a function `f(options, call)` of an options record and a Call: it runs one task and shows what comes out.
Its docstring is its help.
"""

import inspect
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cached_property
from itertools import takewhile
from pathlib import Path
from textwrap import wrap
from typing import Annotated, Any, get_type_hints

import typer
from typer.core import TyperCommand

from camcal.cli import examples, show
from camcal.cli.call import Call, TextParameters
from camcal.dataclass import dataclass
from camcal.errors import InvalidInput
from camcal.files import STANDARD
from camcal.options import GENERAL, Argument, Declared, assembled, by_group, declared
from camcal.run.options import located

SETTINGS = "camcal.settings"  # where a context keeps the line of the settings file that each value came from
WRITE_SETTINGS = "--write-config"

_CONTINUED = " \\"
_OPTION = re.compile(r"(?<= )(-\S+) ")
_NEGATIVE = re.compile(r"-[0-9.]")


@dataclass(frozen=True)
class NoOptions:
    """The options of a command that has none of its own."""


class OptionsCommand(TextParameters, TyperCommand):
    """A command whose options are declared by records, which `command` makes."""

    full_name: str = ""
    declared: Sequence[Declared] = ()

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse a command line, in which numbers below zero may be arguments where the command takes such.

        Nothing is required of one that only writes a settings file.
        """
        named = takewhile(lambda text: text != "--", args)
        writes = any(text.partition("=")[0] == WRITE_SETTINGS for text in named)
        if any(isinstance(each.option, Argument) and each.option.numbers for each in self.declared):
            args = [f" {text}" if _NEGATIVE.match(text) else text for text in args]
        required = [parameter for parameter in self.params if parameter.required and writes]
        for parameter in required:
            parameter.required = False
        try:
            return super().parse_args(ctx, args)
        finally:
            for parameter in required:
                parameter.required = True

    def collect_usage_pieces(self, ctx: Any) -> list[str]:  # noqa: ARG002 - typer calls it so
        """Return what a command line is made of: options, then arguments in their order."""
        arguments = [each for each in self.declared if each.positional]
        return ["[OPTIONS]", *(each.name if each.required else f"[{each.name}]" for each in arguments)]

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write the options under the titles of their groups, those of typer's own parameters with the general ones."""
        own = {parameter_name(each) for each in self.declared}
        others: list[Any] = [each for each in self.get_params(ctx) if each.name not in own]
        for group, members in by_group(self.declared).items():
            rows = [(usage(each), help_text(each)) for each in members]
            if group == GENERAL:
                rows += [(f"{', '.join(each.opts)} {each.metavar or ''}".strip(), each.help) for each in others]
            with formatter.section(group):
                formatter.write_dl(rows)
        with formatter.section("Examples"):
            calls = examples.calls(self.full_name)
            formatter.write("".join(f"  {line}\n" for line in _continue(calls, formatter.width - 2)))


def _continue(calls: Iterable[str], most: int) -> Iterator[str]:
    """Yield the lines of shell commands, a longer one continued on the next line."""
    for call in calls:
        if len(call) <= most:
            yield call
            continue
        width = most - len(_CONTINUED)
        bound = _OPTION.sub("\\1\0", call)  # each option stays with its value
        lines = wrap(bound, width, subsequent_indent="    ", break_long_words=False, break_on_hyphens=False)
        *first, last = (line.replace("\0", " ") for line in lines)
        yield from (f"{line}{_CONTINUED}" for line in first)
        yield last


def usage(each: Declared) -> str:
    """Return how an option is written, with all its spellings and its value."""
    if each.positional:
        return each.name
    spelled = ", ".join(sorted(each.spellings, key=len))
    return f"{spelled} {value_name(each)}".strip()


def value_name(each: Declared) -> str:
    """Return what stands for the value of an option in its usage, of a flag the name that switches it off."""
    if each.flag:
        return f"/ {each.opposite}" if each.opposite else ""
    return each.option.metavar or each.name.lstrip("-").upper()


def help_text(each: Declared) -> str:
    """Return the help of an option, with its default where that is not said in words."""
    said = each.help
    if each.required:
        return f"{said} Required."
    if each.default in (None, "", False, (), float("inf")) or "default" in said:
        return said
    return f"{said} By default {'on' if each.default is True else ' '.join(each.texts(each.default))}."


def command(name: str, function: Callable[..., None]) -> OptionsCommand:
    """Return the command of a function `f(options, call)` under its full name, such as 'stereo cloud'."""
    maker = _Maker(name, function)
    alone = typer.Typer(add_completion=False, rich_markup_mode=None, pretty_exceptions_enable=False)
    alone.command(name.rpartition(" ")[2], cls=OptionsCommand)(maker.callback())
    made = typer.main.get_command(alone)
    assert isinstance(made, OptionsCommand)
    made.declared = maker.every
    made.full_name = name
    return made


@dataclass(frozen=True)
class _Maker:
    """What a command is made of: its full name and the function that it calls."""

    name: str
    function: Callable[..., None]

    @cached_property
    def records(self) -> tuple[type, type]:
        """The options record, if it takes one, and the kind of Call that the function takes."""
        hints = get_type_hints(self.function)
        return hints.get("options", NoOptions), hints["call"]

    @cached_property
    def every(self) -> tuple[Declared, ...]:
        """All options, those of the task first."""
        return tuple(each for record in self.records for each in declared(record))

    def callback(self) -> Callable[..., None]:
        """Return the function that typer calls: it takes texts and flags, and its signature lists all options."""

        def run(context: typer.Context, config: Path | None, write_config: Path | None, **given: Any) -> None:
            values = self.values(context, given)
            if write_config is None:
                self.start(values, config)
            else:
                self.write(values, write_config)

        run.__doc__ = self.function.__doc__
        run.__signature__ = inspect.Signature([*_CONTEXT, *map(_parameter, self.every), *_SETTINGS])  # type: ignore[attr-defined]
        run.__annotations__ = {}
        return run

    def values(self, context: typer.Context, given: Mapping[str, Any]) -> dict[Declared, Any]:
        """Return the values of the options that were given; raises InvalidInput, saying where a wrong one stands."""
        values = {}
        for each in self.every:
            text = located(each, given[parameter_name(each)])
            if text is None or (each.several and not text):
                continue
            try:
                values[each] = each.read(text)
            except InvalidInput as error:
                line = settings_line(context, parameter_name(each))
                hint = "" if line else f"; see 'camcal {self.name} --help'"
                raise InvalidInput(f"{error.message}{hint}", where=line) from error
        return values

    def start(self, values: Mapping[Declared, Any], config: Path | None) -> None:
        """Call the function with the records that these values make, after reading `config`."""
        from camcal.run.options import outputs_of
        from camcal.run.outputs import watch_files

        record = self.records[0]
        call = self.call(values)
        call.prepare()
        with watch_files(read=[] if config is None else [config]) as run:
            run.add(values)
            chosen = {each.path: values[each] for each in declared(record) if each in values}
            options = {} if record is NoOptions else {"options": assembled(record, chosen)}
            if not any(str(path) == STANDARD for each, value in values.items() for path in outputs_of(each, value)):
                self.function(**options, call=call)
                return
            if call.json:
                raise InvalidInput("--json and '-' both write to standard output; give the output a file")
            with show.aside():
                self.function(**options, call=call)

    def write(self, values: Mapping[Declared, Any], path: Path) -> None:
        """Write these values as a settings file, over none of the inputs that they name."""
        from camcal.run.options import inputs_of
        from camcal.run.outputs import watch_files
        from camcal.run.settings import write_settings

        inputs = [named for each, value in values.items() for named in inputs_of(each, value)]
        with watch_files(read=inputs) as run:
            run.overwrite = any(value is True for each, value in values.items() if each.name == "--overwrite")
            run.plan_named(path)
            write_settings(path, self.name, settable(self.every), values)
        self.call(values).give(lambda: {"output": path}, lambda: show.wrote(path))

    def call(self, values: Mapping[Declared, Any]) -> Call:
        """Return how the command is called."""
        record = self.records[1]
        called: Call = record(self.name, **{each.path[0]: values[each] for each in declared(record) if each in values})
        return called


def settable(every: Sequence[Declared]) -> list[Declared]:
    """Return the options that a settings file may hold; --json says how a command is called, not what it does."""
    return [each for each in every if each.name != "--json"]


def parameter_name(each: Declared) -> str:
    """Return the name of an option's parameter, which only typer sees; fields may be called as Python's keywords."""
    return "_".join((*each.path, "option"))


def _parameter(each: Declared) -> inspect.Parameter:
    """Return the parameter that typer makes an option or argument of: texts, which the option itself reads."""
    kind: Any = bool if each.flag else str
    if each.several:
        kind = list[str]
    elif each.option.values > 1:
        kind = tuple.__class_getitem__((str,) * each.option.values)
    help_ = each.option.help if isinstance(each.option.help, str) else value_name(each)  # typer shows it in completions

    def complete(incomplete: str) -> list[str]:
        known = each.option.choices or (each.option.suggested() if each.option.suggested else ())
        return [value for value in known if value.startswith(incomplete)]

    if each.positional:
        info: Any = typer.Argument(metavar=each.option.metavar or None, help=help_, autocompletion=complete)
    else:
        names = [f"{each.name}/{each.opposite}" if each.opposite else each.name, *each.spellings[1:]]
        info = typer.Option(
            *names, metavar=None if each.flag else value_name(each), help=help_, autocompletion=complete
        )
    default = inspect.Parameter.empty if each.required else None
    return inspect.Parameter(
        parameter_name(each), inspect.Parameter.KEYWORD_ONLY, default=default, annotation=Annotated[kind | None, info]
    )


def _apply_settings(context: typer.Context, path: Path | None) -> Path | None:
    """Let a settings file give the options that are not on the command line."""
    if path is None:
        return None
    from camcal.run.settings import read_settings

    command: Any = context.command
    options = {each.key.replace("-", "_"): each for each in settable(command.declared) if not each.positional}
    settings = read_settings(path, {name: each.several or each.option.values > 1 for name, each in options.items()})
    names = {name: parameter_name(each) for name, each in options.items()}
    context.default_map = {
        names[name]: str(value).lower() if isinstance(value, bool) and not options[name].flag else value
        for name, value in settings.values.items()
    }
    context.meta[SETTINGS] = {names[name]: f"{settings.where}:{line}" for name, line in settings.lines.items()}
    return path


def _show_examples(context: typer.Context, wanted: bool) -> None:
    """Print the most common calls as a script, and do nothing else."""
    if not wanted:
        return
    command: Any = context.command
    for line in _continue(examples.script(command.full_name), show.width()):
        show.value(line)
    raise typer.Exit


def settings_line(context: Any, parameter: str | None) -> str | None:
    """Return the file and line of a parameter's value, None if it does not come from a settings file."""
    if context is None or parameter is None:
        return None
    source = context.get_parameter_source(parameter)
    if source is None or source.name != "DEFAULT_MAP":
        return None
    line: str = context.meta[SETTINGS][parameter]
    return line


def _keyword(name: str, annotation: Any, **default: Any) -> inspect.Parameter:
    return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, annotation=annotation, **default)


_CONTEXT = (_keyword("context", typer.Context),)
_SETTINGS = (
    _keyword(
        "config",
        Annotated[
            Path | None,
            typer.Option(
                "--config",
                metavar="FILE",
                is_eager=True,
                callback=_apply_settings,
                help="Options from a YAML file (option: value); those on the command line come first.",
            ),
        ],
        default=None,
    ),
    _keyword(
        "write_config",
        Annotated[
            Path | None,
            typer.Option(
                WRITE_SETTINGS,
                metavar="FILE",
                help="Write such a file with all options explained, those given set, and do nothing else.",
            ),
        ],
        default=None,
    ),
    _keyword(
        "examples",
        Annotated[
            bool,
            typer.Option(
                "--examples",
                is_eager=True,
                callback=_show_examples,
                help="Print the most common calls and what each does, and do nothing else.",
            ),
        ],
        default=False,
    ),
)
