"""Every text that is generated from the code: `python tests/generated_pages.py` writes those that are stale,
and says which.

With --record NAME -- COMMAND it runs a benchmark first and keeps its output as the result of that name.
"""

import argparse
import sys
from contextlib import redirect_stdout, suppress
from io import StringIO
from pathlib import Path
from tempfile import TemporaryDirectory

import benchmarks_page
import command_page
import formats_page
import man_pages
import messages_page

from camcal.cli.main import app

PROJECT = Path(__file__).parents[1]
SAMPLES = PROJECT / "sample_configs"
PARTS = (command_page, man_pages, formats_page, messages_page, benchmarks_page)
WRITE = "run: python tests/generated_pages.py"


def generated() -> dict[Path, str | None]:
    """Return the text that every generated file should have; None for one that should not be there."""
    pages = {path: text for part in PARTS for path, text in part.generated().items()}
    return pages | {path: sample_of(path) for path in sorted(SAMPLES.glob("*.yaml"))}


def command_of(path: Path) -> str:
    """Return the command that a file of settings is named after, in its first words at least."""
    words = path.stem.split("_")
    joined = (" ".join(words[:count]) for count in range(len(words), 0, -1))
    return next(command for command in joined if command in command_page.REGISTERED)


def sample_of(path: Path) -> str:
    """Return a file of settings as its command writes it."""
    with TemporaryDirectory() as folder:
        again = Path(folder) / path.name
        with redirect_stdout(StringIO()), suppress(SystemExit):
            app([*command_of(path).split(), "--config", str(path), "--write-config", str(again)])
        return again.read_text(encoding="utf-8")


def stale() -> list[Path]:
    """Return the generated files that are not as they should be."""
    return [path for path, text in generated().items() if text != text_of(path)]


def text_of(path: Path) -> str | None:
    """Return the text of a file, None if there is none."""
    return path.read_text(encoding="utf-8") if path.exists() else None


def write(path: Path, text: str | None) -> None:
    """Write a file, or remove it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.unlink(missing_ok=True) if text is None else path.write_text(text, encoding="utf-8", newline="\n")


if __name__ == "__main__":
    asked = argparse.ArgumentParser(description=__doc__)
    asked.add_argument("--record", metavar="NAME", help="run COMMAND and write its output to results/NAME.txt first")
    asked.add_argument("--versions", default="", help="versions of other programs, such as 'mrcal 2.2'")
    asked.add_argument("command", nargs="*", metavar="COMMAND", help="after --")
    given = asked.parse_args()
    if given.record:
        benchmarks_page.record(given.record, given.command, given.versions)
    wanted = generated()
    for changed in stale():
        write(changed, wanted[changed])
        sys.stdout.write(f"{changed.relative_to(PROJECT)}\n")
