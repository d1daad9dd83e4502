"""How many parts the package may have: a change may lower the counts, and one that needs more raises them here."""

import ast
import json
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from report_scenes import SCENES, detections_of
from test_layers import PACKAGE, modules, room

from camcal.formats import detections

LINES = {
    "__init__": 45,
    "__main__": 6,
    "arrays": 42,
    "calibrate": 11208,
    "cameras": 4219,
    "cli": 3671,
    "dataclass": 139,
    "errors": 137,
    "estimate": 8564,
    "files": 398,
    "formats": 13772,
    "geometry": 1007,
    "images": 2191,
    "messages": 246,
    "opencv": 171,
    "optics": 298,
    "options": 397,
    "parsing": 86,
    "progress": 149,
    "quality": 3219,
    "raw": 5025,
    "records": 157,
    "report": 7369,
    "run": 3676,
    "simulate": 1710,
    "solve": 1863,
    "stereo": 5093,
    "system": 281,
    "targets": 7150,
    "tasks": 25273,
    "urls": 99,
}
PARTS = {"modules": 462, "records": 732, "records named in one module": 211, "short functions with one reference": 488}
PASSED = {"modules": 102, "functions": 1044, "records": 120}  # from a table of detections to a camera file
SHORT = 5  # lines of a function's body, which could as well stand where it is called


def lines_of(package: Path) -> dict[str, int]:
    """Return the number of lines of every package and module at the top."""
    found: Counter[str] = Counter()
    for path in sorted(package.rglob("*.py")):
        found[room(path.relative_to(package).as_posix())] += len(path.read_text(encoding="utf-8").splitlines())
    return dict(found)


def parts_of(package: Path) -> dict[str, int]:
    """Return the counts of PARTS. References are counted by name, in the whole package."""
    trees = dict(modules(package))
    used = {module: list(names_in(tree)) for module, tree in trees.items()}
    references = Counter(name for names in used.values() for name in names)
    named_in = Counter(name for names in used.values() for name in set(names))
    functions = [node for tree in trees.values() for node in tree.body if isinstance(node, ast.FunctionDef)]
    defined = Counter(node.name for node in functions)
    records = [
        node for tree in trees.values() for node in tree.body if isinstance(node, ast.ClassDef) and is_record(node)
    ]
    return {
        "modules": len(trees),
        "records": len(records),
        "records named in one module": sum(named_in[node.name] <= 1 for node in records),
        "short functions with one reference": sum(
            defined[node.name] == references[node.name] == 1 and body_lines(node) <= SHORT for node in functions
        ),
    }


def names_in(tree: ast.Module) -> Iterator[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Load):
            yield node.id
        elif isinstance(node, ast.Attribute):
            yield node.attr


def is_record(node: ast.ClassDef) -> bool:
    return any("dataclass" in ast.unparse(each) for each in node.decorator_list)


def body_lines(node: ast.FunctionDef) -> int:
    body = node.body[1:] if ast.get_docstring(node) else node.body
    return (body[-1].end_lineno or 0) - body[0].lineno + 1 if body else 0


def above(found: dict[str, int], most: dict[str, int]) -> dict[str, int]:
    """Return the counts that are larger than they may be."""
    return {name: count for name, count in found.items() if count > most.get(name, 0)}


def test_no_package_has_more_lines_than_stated(tmp_path):
    (tmp_path / "solve").mkdir()
    (tmp_path / "solve" / "steps.py").write_text("x = 1\n" * 3)
    assert above(lines_of(tmp_path), {"solve": 2}) == {"solve": 3}
    assert above(lines_of(PACKAGE), LINES) == {}
    assert set(LINES) == set(lines_of(PACKAGE))


def test_there_are_no_more_parts_than_stated(tmp_path):
    (tmp_path / "a.py").write_text(
        "@dataclass\nclass Own: ...\n@dataclass\nclass Shared: ...\n"
        "def short():\n    return Own()\ndef used():\n    return Shared()\ndef caller():\n    return short()\n"
    )
    (tmp_path / "b.py").write_text("from a import Shared, caller, used\nx = Shared(caller(), used(), used())\n")
    counts = {"modules": 2, "records": 2, "records named in one module": 1, "short functions with one reference": 2}
    assert parts_of(tmp_path) == counts
    assert above(parts_of(PACKAGE), PARTS) == {}


def test_a_calibration_passes_through_no_more_parts_than_stated(tmp_path):
    detections.write(tmp_path / "detections.csv", detections_of(SCENES["good"]))
    script = Path(__file__).with_name("traced_run.py")
    command = [sys.executable, script, "calibrate", "detections.csv", "-o", "camera.yaml", "--quiet"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)
    assert above(json.loads(done.stderr.splitlines()[-1]), PASSED) == {}
