"""docs/commands.md beside the help of the commands: what the page says of each, and what it should say.

Run as a script, this writes the blocks of synopsis and options anew from `--help`.
"""

import re
from pathlib import Path
from typing import Any

from typer.core import TyperGroup
from typer.main import get_command

from camcal.cli.command import OptionsCommand, help_text, value_name
from camcal.cli.main import app
from camcal.options import Declared, by_group

PAGE = Path(__file__).parents[1] / "docs" / "commands.md"
EVERYWHERE = ("jobs", "recursive", "json", "quiet", "verbose")  # described once, for all commands


def commands(group: Any) -> dict[str, Any]:
    """Return every command below a group by its full name, such as 'stereo cloud'."""
    found: dict[str, Any] = {}
    for name, command in group.commands.items():
        below = commands(command) if isinstance(command, TyperGroup) else {"": command}
        found |= {f"{name} {rest}".strip(): leaf for rest, leaf in below.items()}
    return found


ROOT = get_command(app)
REGISTERED = commands(ROOT)


def sections(page: str) -> dict[str, str]:
    """Return the text under every heading `## camcal …`, by the command's name."""
    parts = re.split(r"^## ", page, flags=re.MULTILINE)[1:]
    titled = (part.split("\n", maxsplit=1) for part in parts)
    return {title.removeprefix("camcal "): body for title, body in titled if title.startswith("camcal ")}


def option_block(command: OptionsCommand, name: str) -> str:
    """Return the synopsis and the table of options of a command, from its help."""
    own = [each for each in command.declared if each.key not in EVERYWHERE]
    needed = [f"[{each.name}]" if not each.required else each.name for each in own if each.positional]
    needed += [f"{each.name} {value_name(each)}" for each in own if each.required and not each.positional]
    rows = []
    for group, members in by_group(own).items():
        rows += [f"| **{group}** | |", *map(_row, members)]
    table = ["| argument or option | |", "|---|---|", *rows, ""] if own else []
    shared = [each.name for each in command.declared if each.key in EVERYWHERE]
    said = ", ".join(f"`{option}`" for option in (*shared, "--config", "--write-config"))
    also = f"{'Also' if own else 'Only'} {said}: [as everywhere](#options-of-every-command)."
    synopsis = " ".join(["camcal", name, *needed, "[OPTIONS]"])
    return "\n".join(["```", synopsis, "```", "", *table, also, ""])


def _row(each: Declared) -> str:
    first, *others = each.spellings
    value = "" if each.positional or each.flag else f" {value_name(each)}"
    spelled = ", ".join(f"`{form}`" for form in (first + value, *others, *([each.opposite] if each.opposite else [])))
    return "| " + " | ".join(cell.replace("|", r"\|") for cell in (spelled, help_text(each))) + " |"


def with_blocks(page: str) -> str:
    """Return docs/commands.md with the block of every command as its help has it."""
    for name, command in REGISTERED.items():
        start, end = f"<!-- options of camcal {name} -->\n", "<!-- end -->"
        before, found, rest = page.partition(start)
        if found:
            page = f"{before}{start}{option_block(command, name)}{end}{rest.partition(end)[2]}"
    return page


def stale(page: str) -> list[str]:
    """Return the commands without a section of their own, or with a block that differs from their help."""
    known = sections(page)
    return [name for name, command in REGISTERED.items() if option_block(command, name) not in known.get(name, "")]


if __name__ == "__main__":
    PAGE.write_text(with_blocks(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
