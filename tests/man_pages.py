"""docs/man/: a manual page of camcal and of every command and group, made from the declarations that --help shows.

generated_pages.py writes them. They are installed with the package, below share/man.
"""

import re
from collections.abc import Iterator, Mapping
from collections.abc import Set as AbstractSet
from pathlib import Path
from textwrap import dedent, wrap
from typing import Any

import typer
from command_page import INDEX, REGISTERED, ROOT
from typer.core import TyperGroup

from camcal import __version__
from camcal.cli import examples
from camcal.cli.command import OptionsCommand, help_text, parameter_name, usage
from camcal.cli.main import COMMANDS
from camcal.options import GENERAL, by_group

FOLDER = Path(__file__).parents[1] / "docs" / "man" / "man1"

_DATE = "2026-11-23"  # of the version
_WIDTH = 78
_HELP = {"-h, --help": "Show this message and exit."}
_EXIT_CODE = re.compile(r"^\| ([\d, ]+) \|[^|]*\| ([^|]+) \|$", flags=re.MULTILINE)
_VARIABLES = {
    "COLUMNS": "Width of tables; by default that of the terminal, 80 where the output is none.",
    "NO_COLOR": "If it is set, verdicts are neither bold nor coloured.",
    "SOURCE_DATE_EPOCH": "The time that files record as theirs, in seconds since 1970; without it they record none.",
}
_FILES = {".camcal-output": "The files of a folder that camcal wrote: it may replace them, and does not read them."}


def escaped(text: str) -> str:
    """Return a text for roff: with hyphens that can be copied, and characters beyond ASCII by their numbers."""
    for letter, written in (
        ("\\", r"\e"),
        ("-", r"\-"),
        ("'", r"\(aq"),
        ("`", r"\(ga"),
        ("^", r"\(ha"),
        ("~", r"\(ti"),
    ):
        text = text.replace(letter, written)
    return "".join(letter if letter.isascii() else rf"\[u{ord(letter):04X}]" for letter in text)


def paragraph(text: str) -> list[str]:
    """Return a text as lines, none of which is a request."""
    lines = wrap(escaped(text), _WIDTH, break_long_words=False, break_on_hyphens=False)
    return [rf"\&{line}" if line.startswith(".") else line for line in lines]


def listed(rows: Mapping[str, str]) -> Iterator[str]:
    """Yield a list of terms, each with its text indented below it."""
    for term, text in rows.items():
        yield from (".TP", rf"\fB{escaped(term)}\fR", *paragraph(text))


def title(name: str) -> str:
    """Return the name of the page of a command by its full name; that of camcal itself for no name."""
    return "-".join(["camcal", *name.split()])


def page(name: str, command: Any, summary: str) -> str:
    """Return the manual page of a command or a group."""
    head = f'.TH {escaped(title(name).upper())} 1 {_DATE} "camcal {__version__}" "camcal manual"'
    parts = {"NAME": [rf"{escaped(title(name))} \- {escaped(summary.rstrip('.'))}"]}
    parts |= _group(name, command) if isinstance(command, TyperGroup) else _command(name, command)
    parts["SEE ALSO"] = [_reference("") if name else f"{', '.join(map(_reference, REGISTERED))}"]
    lines = [line for title_, body in parts.items() for line in (f".SH {title_}", *body)]
    return "\n".join([head, *lines, ""])


def _reference(name: str) -> str:
    return rf"\fB{escaped(title(name))}\fR(1)"


def _synopsis(name: str, *rest: str) -> list[str]:
    return [rf"\fB{escaped(f'camcal {name}'.strip())}\fR", *(rf"\fI{escaped(text)}\fR" for text in rest)]


def _description(text: str) -> list[str]:
    first, *others = (" ".join(part.split()) for part in dedent(text).split("\n\n"))
    return [*paragraph(first), *(line for other in others for line in (".PP", *paragraph(other)))]


def _command(name: str, command: OptionsCommand) -> dict[str, list[str]]:
    shared = _parameters(command, {parameter_name(each) for each in command.declared})
    options: list[str] = []
    for group, members in by_group(command.declared).items():
        rows = {usage(each): help_text(each) for each in members}
        options += [f".SS {escaped(group)}", *listed(rows | (shared if group == GENERAL else {}))]
    calls: list[str] = []
    for each in examples.EXAMPLES[name]:
        line = f"    {escaped(f'camcal {each.call}')}"
        calls += [*([".PP"] if calls else []), *paragraph(f"{each.purpose}:"), ".PP", ".nf", line, ".fi"]
    return {
        "SYNOPSIS": _synopsis(name, *command.collect_usage_pieces(typer.Context(command))),
        "DESCRIPTION": _description(command.help or ""),
        "OPTIONS": options,
        "EXAMPLES": calls,
        "EXIT STATUS": paragraph("0 if all is done; what the others mean is listed in camcal(1)."),
    }


def _parameters(command: Any, left_out: AbstractSet[str] = frozenset()) -> dict[str, str]:
    """Return the help of options that are typer's own parameters, by their usage."""
    found = [each for each in command.params if each.name not in left_out]
    rows = {f"{', '.join(sorted(each.opts, key=len))} {each.metavar or ''}".strip(): each.help for each in found}
    return rows | _HELP


def _group(name: str, command: TyperGroup) -> dict[str, list[str]]:
    below = {entry.name: entry.summary for entry in COMMANDS if entry.function and entry.name.startswith(name)}
    parts = {
        "SYNOPSIS": _synopsis(name, "COMMAND", "[OPTIONS]"),
        "DESCRIPTION": _description(command.help or ""),
        "COMMANDS": list(listed(below)),
        "OPTIONS": list(listed(_parameters(command))),
    }
    if name:
        return parts
    codes = INDEX.read_text(encoding="utf-8").partition("## Exit codes")[2].partition("\n## ")[0]
    tables = {"EXIT STATUS": dict(_EXIT_CODE.findall(codes)), "ENVIRONMENT": _VARIABLES, "FILES": _FILES}
    return parts | {title_: list(listed(rows)) for title_, rows in tables.items()}


def pages() -> dict[str, str]:
    """Return the text of every page by the name of its file."""
    summaries = {entry.name: entry.summary for entry in COMMANDS}
    groups = {entry.name: ROOT.commands[entry.name] for entry in COMMANDS if not entry.function}
    made = {"": page("", ROOT, "calibrate, rectify and measure with cameras")}
    made |= {name: page(name, each, summaries[name]) for name, each in (groups | REGISTERED).items()}
    return {f"{title(name)}.1": text for name, text in made.items()}


def generated(folder: Path = FOLDER) -> dict[Path, str | None]:
    """Return the texts of the files of all pages."""
    return {**dict.fromkeys(folder.iterdir()), **{folder / file: text for file, text in pages().items()}}
