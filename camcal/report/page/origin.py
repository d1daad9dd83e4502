"""The sections on where a result comes from and how to repeat it."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from camcal.report.page.record import Section, Table


def origin_section(provenance: Mapping[str, Any], environment: Mapping[str, str], lines: Sequence[str]) -> Section:
    """Return the section on versions, inputs with their hashes, and the command; lines: what else was reported."""
    rows = [["command", str(provenance.get("command", "unknown"))]]
    rows += [["created", str(provenance["created"])]] if "created" in provenance else []
    rows += [[name, version] for name, version in environment.items()]
    rows += [[f"board {name}", _words(value)] for name, value in dict(provenance.get("board", {})).items()]
    if totals := provenance.get("image_totals"):
        rows.append(["images", f"{totals['used']} of {totals['listed']} used; SHA-256 of the list {totals['sha256']}"])
    tables = [Table.of("Program, machine and board", ("what", "value"), rows)]
    images = [_image_row(image) for image in provenance.get("images", []) if isinstance(image, Mapping)]
    if images:
        tables.append(Table.of("Inputs", ("file", "SHA-256"), images))
    return Section("provenance", "Provenance", list(lines), tables=tables)


def _image_row(image: Mapping[str, Any]) -> list[str]:
    return [str(image.get("file", "")), str(image.get("sha256", "not recorded"))]


def _words(value: object) -> str:
    return " x ".join(map(str, value)) if isinstance(value, list) else str(value)


def repeat_section(command: str, *, again: bool = True) -> Section:
    """Return the section on how to repeat a result; again: whether the page carries what that needs."""
    lines = list(_repeat_lines(again=again))
    commands = (["camcal rerun REPORT.html -o repeated"] if again else []) + [command]
    return Section("repeat", "How to repeat it", lines, commands=commands)


def _repeat_lines(*, again: bool) -> Iterator[str]:
    if again:
        yield (
            "This file carries the detections and the options. The first command calibrates again from these and "
            "writes the camera or rig file and this report: the same bytes on the same machine with the same "
            "libraries. Elsewhere it says what differs; differences below 1e-6 standard deviations count as none."
        )
        yield "The second command is the one that made this report."
    else:
        yield "The command that made the file:"
