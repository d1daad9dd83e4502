"""Messages and names that were replaced by standard terms do not come back in code, pages or help."""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md")), *sorted((ROOT / "sample_configs").rglob("*.yaml"))]
PACKAGE = sorted((ROOT / "camcal").rglob("*.py"))
OTHERS = [path for folder in ("tests", "benchmarks") for path in sorted((ROOT / folder).rglob("*.py"))]

VALUE = ".{1,60}?"
MESSAGES = (  # whole messages; VALUE stands for what they are filled with
    f"their images account for {VALUE}, board and lens model leave",
    "a second look with the calibrated lens",
    f"noise {VALUE} times what the pixels say",
    "every corner free; the largest is off by",
    f"no corner lies beyond {VALUE} of the way to the image corner",
    "the cameras squint at something nearer",
    "trembling: single frames",
    rf"translation {VALUE} \(×÷ {VALUE}\) m²/s³",
    "the filter runs after the noise",
    f"pieces: {VALUE} … {VALUE} s",
    "tells no times of its frames",
    "smallest signal",
    "largest signal-to-noise ratio",
    "dynamic range from there",
    f"levels of light, {VALUE} of darkness",
    "the cost is at its rounding error; the step promises no decrease",
    "contrast left at the finest detail",
    "take the board as drawn",
    "does not fit the other views",
    "rows and half columns",
    "two eyes",
)

DEFINED = {  # names of classes and functions
    *("Sighting", "Sightings", "Seen", "SeenAgain", "Looking", "Look", "Photograph", "Samples"),
    *("Verdict", "Noise", "Fit", "Seat", "Belief", "Coat", "Eye", "Made", "Judgement", "Agreement", "Way", "Film"),
    *("settle", "approached", "through"),
}
ANYWHERE = {"freedom", "floor_px", "film", "films", "rooms"}  # names of fields, arguments and variables as well
FIELDS = {"remarks", "findings", "faults", "advice"}  # of records: messages are warnings or failures
MEMBERS = {"View": {"turned"}, "Board": {"crossed", "coded", "pitch", "inward"}}  # of these classes alone

_SUSPECT = re.compile(
    rf"(class|def) _*({'|'.join(sorted(DEFINED | set(MEMBERS)))})\b|\b({'|'.join(sorted(ANYWHERE | FIELDS))})\b"
)


def old_messages(text):
    """Return the replaced messages in the text of a page or a module; a string may go on in the next line."""
    joined = " ".join(re.sub(r'"\s+[rf]*"', "", text).split())
    return [pattern for pattern in MESSAGES if re.search(pattern, joined, re.IGNORECASE)]


def old_names(text):
    """Return the replaced names that a module defines."""
    found = []
    for node in ast.walk(ast.parse(text)) if _SUSPECT.search(text) else ():
        if isinstance(node, ast.ClassDef | ast.FunctionDef):
            found += [node.name] if node.name.strip("_") in DEFINED | ANYWHERE else []
        elif isinstance(node, ast.arg):
            found += [node.arg] if node.arg in ANYWHERE else []
        elif isinstance(node, ast.Name | ast.Attribute):
            name = node.id if isinstance(node, ast.Name) else node.attr
            found += [name] if name in ANYWHERE else []
        if isinstance(node, ast.ClassDef):
            own = {part.name for part in node.body if isinstance(part, ast.FunctionDef)}
            own |= {part.target.id for part in node.body if isinstance(part, ast.AnnAssign)}
            found += [f"{node.name}.{name}" for name in sorted(own & (FIELDS | MEMBERS.get(node.name, set())))]
    return found


def left(paths, found_in):
    """Return what is found in the files, by their names."""
    texts = {path.relative_to(ROOT).as_posix(): path.read_text() for path in paths if path != Path(__file__)}
    return {name: found for name, text in texts.items() if (found := found_in(text))}


PLANTED = {
    "their images account for": 'f"corners: their images account for {a:.3f} px, board and lens model leave {b} px"',
    "does not fit": '"does not fit the other "\n"views"',
    "pieces:": 'f"pieces: {shortest:.2g} … {longest:.2g} s"',
    "trembling": '"""Trembling: single\n    frames."""',
}


@pytest.mark.parametrize(("words", "line"), PLANTED.items(), ids=PLANTED)
def test_a_planted_message_is_found(words, line):
    (found,) = old_messages(f"def show():\n    return ({line})")
    assert found.startswith(words)


@pytest.mark.parametrize(
    ("line", "name"),
    [
        ("class Sightings: ...", "Sightings"),
        ("class _Look: ...", "_Look"),
        ("def settle(): ...", "settle"),
        ("def gate(freedom): ...", "freedom"),
        ("print(found.floor_px)", "floor_px"),
        ("class View:\n    turned: int = 0", "View.turned"),
        ("class Report:\n    remarks: tuple = ()", "Report.remarks"),
        ("class Board:\n    def pitch(self): ...", "Board.pitch"),
    ],
)
def test_a_planted_name_is_found(line, name):
    assert old_names(line) == [name]


def test_ordinary_words_are_no_names():
    text = '"""The pitch of the pixels; two degrees of freedom."""\npitch = 3.45e-6\nreasons = fit = noise = ()'
    assert old_names(text) == []


def test_no_replaced_message_is_left():
    assert left([*PAGES, *PACKAGE], old_messages) == {}


def test_no_replaced_name_is_left():
    assert left([*PACKAGE, *OTHERS], old_names) == {}
