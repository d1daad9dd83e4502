"""docs/commands.md and docs/commands/ beside the help of the commands: what the pages say, and what they should say.

Generated are the list of commands, and on the page of each its synopsis and options, from `--help`; a command without a
page gets one. generated_pages.py writes them.
"""

from pathlib import Path
from typing import Any

from typer.core import TyperGroup
from typer.main import get_command

from camcal.cli.command import OptionsCommand, help_text, value_name
from camcal.cli.main import COMMANDS, app
from camcal.options import Declared, by_group

INDEX = Path(__file__).parents[1] / "docs" / "commands.md"
FOLDER = INDEX.with_suffix("")
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


def page_of(name: str) -> Path:
    """Return the page of a command."""
    return FOLDER / f"{name.replace(' ', '-')}.md"


def pages() -> dict[str, str]:
    """Return the text of every page of a command, by the command's name in its title."""
    texts = (page.read_text(encoding="utf-8") for page in sorted(FOLDER.glob("*.md")))
    return {text.partition("\n")[0].removeprefix("# camcal "): text for text in texts}


def listed() -> str:
    """Return the table of all commands, each with a link to its page."""
    entries = [entry for entry in COMMANDS if entry.function]
    rows = [f"| [`camcal {each.name}`](commands/{page_of(each.name).name}) | {each.summary} |" for each in entries]
    return "\n".join(["| command | |", "|---|---|", *rows, ""])


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
    said = ", ".join(f"`{option}`" for option in (*shared, "--config", "--write-config", "--examples"))
    also = f"{'Also' if own else 'Only'} {said}: [as everywhere](../commands.md#options-of-every-command)."
    synopsis = " ".join(["camcal", name, *needed, "[OPTIONS]"])
    return "\n".join(["```", synopsis, "```", "", *table, also, ""])


def _row(each: Declared) -> str:
    first, *others = each.spellings
    value = "" if each.positional or each.flag else f" {value_name(each)}"
    spelled = ", ".join(f"`{form}`" for form in (first + value, *others, *([each.opposite] if each.opposite else [])))
    return "| " + " | ".join(cell.replace("|", r"\|") for cell in (spelled, help_text(each))) + " |"


def with_block(page: str, title: str, block: str) -> str:
    """Return a page with the block under a title, between two comments, in place of what stands there."""
    start, end = f"<!-- {title} -->\n", "<!-- end -->"
    before, found, rest = page.partition(start)
    return f"{before}{start}{block}{end}{rest.partition(end)[2]}" if found else page


def with_options(name: str, page: str) -> str:
    """Return the page of a command with its options as its help has them."""
    return with_block(page, f"options of camcal {name}", option_block(REGISTERED[name], name))


def stale(found: dict[str, str]) -> list[str]:
    """Return the commands without a page of their own, or with options that differ from their help."""
    return [name for name in REGISTERED if option_block(REGISTERED[name], name) not in found.get(name, "")]


def first_page(name: str) -> str:
    """Return the page of a command that has none yet: its help, and the place of its options."""
    return f"# camcal {name}\n\n{REGISTERED[name].help}\n\n<!-- options of camcal {name} -->\n<!-- end -->\n"


def generated() -> dict[Path, str | None]:
    """Return the texts of the list of commands and of the pages of all."""
    index = INDEX.read_text(encoding="utf-8")
    found = {name: page_of(name).read_text(encoding="utf-8") for name in REGISTERED if page_of(name).exists()}
    texts = {page_of(name): with_options(name, found.get(name, first_page(name))) for name in REGISTERED}
    return {INDEX: with_block(index, "commands", listed()), **dict.fromkeys(FOLDER.glob("*.md")), **texts}
