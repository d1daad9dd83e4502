"""Where a result comes from: the program, the command, the libraries, the board, every image with its hash."""

import hashlib
import os
import shlex
from collections.abc import Iterable, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import camcal
from camcal import files, urls
from camcal.errors import InvalidInput
from camcal.formats import boards, emit
from camcal.formats.schema import flag, integer, items, mapping, number, plain, text
from camcal.targets.board import Board

MAX_COMMAND = 1000
MAX_IMAGES = 5000  # listed one by one: of a rig, each is some 16 of the 100 000 values that a file may have
OPENCV = (
    "opencv-contrib-python-headless",
    "opencv-contrib-python",
    "opencv-python-headless",
    "opencv-python",
)
UNRECORDED = {"-o", "--output", "-j", "--jobs", "-q", "--quiet", "-v", "--verbose", "--json"}  # change no number
WITH_VALUE = {"-o", "--output", "-j", "--jobs"}

_IMAGE = mapping(
    {"file": text},
    {"sha256": text, "used": flag, "points": integer(0), "rms_px": number(0), "reason": text},
    others=plain,
)
check = mapping(
    {},
    {
        "tool": text,
        "tool_version": text,
        "command": text,
        "created": text,
        "libraries": mapping({}, others=text),
        "board": mapping({}, others=plain),
        "images": items(_IMAGE),
        "image_totals": mapping({"listed": integer(0), "used": integer(0), "sha256": text}),
    },
    others=plain,
)


def build(arguments: Sequence[str], board: Board | None, images: Iterable[Mapping[str, Any]] = ()) -> dict[str, Any]:
    """Return the provenance block of a result.

    arguments: the command line after the program's name. images: {file, sha256, used, points, rms_px, reason} each; of
    more than MAX_IMAGES there are totals only.
    """
    block: dict[str, Any] = {"tool": "camcal", "tool_version": camcal.__version__, "command": command(arguments)}
    if (stamp := created()) is not None:
        block["created"] = stamp
    block["libraries"] = libraries()
    if board is not None:
        block["board"] = boards.block(board)
    listed = [dict(image) for image in images]
    return block | ({"images": listed} if len(listed) <= MAX_IMAGES else {"image_totals": _totals(listed)})


def _totals(images: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return how many images there are and how many of them were used, and a hash of all that a list would say."""
    digest = hashlib.sha256(files.utf8(emit.json_text({"images": images}))).hexdigest()
    return {"listed": len(images), "used": sum(image.get("used", True) for image in images), "sha256": digest}


def image_counts(block: Mapping[str, Any]) -> tuple[int, int]:
    """Return how many images a provenance block says were used, and how many there were; zeros where it says none."""
    if totals := block.get("image_totals"):
        return totals["used"], totals["listed"]
    images = block.get("images")
    listed = images if isinstance(images, list) else []
    return sum(image.get("used", True) for image in listed), len(listed)


def command(arguments: Sequence[str]) -> str:
    """Return the command line as it is recorded: options that change no number left out, the middle of a long one cut.

    Two runs over the same input then leave the same bytes, whatever their --jobs and wherever they write to.
    """
    kept: list[str] = []
    left = iter(arguments)
    for argument in left:
        name, equals, _ = argument.partition("=")
        if name not in UNRECORDED:
            kept.append(Path(argument).as_posix() if "/" in argument or "\\" in argument else argument)
        elif name in WITH_VALUE and not equals:
            next(left, None)
    line = urls.named(shlex.join(["camcal", *kept]))
    half = MAX_COMMAND // 2
    return line if len(line) <= MAX_COMMAND else f"{line[:half]} … {line[-half:]}"


def created() -> str | None:
    """Return the moment that SOURCE_DATE_EPOCH gives, None without it: no clock is read into a file."""
    epoch = os.environ.get("SOURCE_DATE_EPOCH")
    if epoch is None:
        return None
    try:
        return datetime.fromtimestamp(int(epoch), UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
    except (ValueError, OverflowError, OSError) as error:
        raise InvalidInput(f"{epoch!r} is not a number of seconds since 1970", where="SOURCE_DATE_EPOCH") from error


def libraries() -> dict[str, str]:
    """Return the versions of the libraries that numbers depend on."""
    found = {distribution: _version(distribution) for distribution in (*OPENCV, "numpy", "scipy")}
    opencv = next((version for name in OPENCV if (version := found[name])), None)
    versions = {"opencv": opencv, "numpy": found["numpy"], "scipy": found["scipy"]}
    return {name: version for name, version in versions.items() if version is not None}


def _version(distribution: str) -> str | None:
    from importlib import metadata  # imports the e-mail package: only who writes a file waits for it

    try:
        return metadata.version(distribution)
    except metadata.PackageNotFoundError:
        return None
