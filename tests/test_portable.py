"""What only some operating systems have is asked for in two modules, and camcal works where it is missing.

Every rule first meets a planted violation, to show that it can fail. The last test runs camcal on this system with the
names of POSIX hidden, in a process of its own and in the worker processes that it starts. It shows that no module
needs them to be imported, and that files are written and work is spread without them. It cannot show what another
system does differently under the same name: which files may be renamed or deleted while they are open, how paths are
written, how signals and the end of processes arrive, what a console can print, and whether libraries are the same.
"""

import ast
import os
import re
import sys
from pathlib import Path

import pytest
from test_layers import PACKAGE, imported, modules

PROJECT = Path(__file__).parents[1]
EDGES = {"system.py", "run/process.py"}  # files and locks; signals and processes
CONDITIONAL = {
    "fcntl",
    "grp",
    "mmap",
    "msvcrt",
    "posix",
    "pty",
    "pwd",
    "resource",
    "select",
    "signal",
    "termios",
    "tty",
}
EVERYWHERE = {  # what `os` has on all systems, with the same meaning
    *("environ", "name", "sep", "devnull", "path", "PathLike", "stat_result", "cpu_count", "getcwd", "_exit"),
    *("open", "close", "fdopen", "dup", "dup2", "fstat", "fsync", "umask", "access", "fsencode", "fsdecode"),
    *("O_RDONLY", "O_WRONLY", "R_OK", "W_OK", "X_OK"),
}
_DEVICE = re.compile(r"/(dev|proc|sys|tmp|etc|run)/")
_TEXT_FILES = {"open", "read_text", "write_text", "NamedTemporaryFile", "TextIOWrapper"}
_RESERVED = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)(\..*)?$", re.IGNORECASE)
_UNWRITABLE = re.compile(r'[<>:"|?*\\]|[. ]$')


def unportable(module: str, tree: ast.Module) -> list[str]:
    """Return what a module asks for that not all systems have, with its line."""
    if module in EDGES:
        return []
    found = [f"{module}:{line} {name}" for line, name in imported(module, tree) if name.split(".")[0] in CONDITIONAL]
    for node in ast.walk(tree):
        said = _said(node)
        found += [f"{module}:{node.lineno} {said}"] if said else []
    return found


def _said(node: ast.AST) -> str | None:
    if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "os":
        return None if node.attr in EVERYWHERE else f"os.{node.attr}"
    if isinstance(node, ast.Constant) and isinstance(node.value, str) and _DEVICE.match(node.value):
        return node.value
    if isinstance(node, ast.keyword) and node.arg in ("preexec_fn", "start_new_session", "pass_fds"):
        return node.arg
    if isinstance(node, ast.Call) and _opens_text(node):
        return "no encoding"
    return None


def _opens_text(call: ast.Call) -> bool:
    """Return whether a call opens a file for text in whatever encoding a system prefers."""
    last = getattr(call.func, "attr", getattr(call.func, "id", ""))
    named = ast.unparse(call.func).split(".") if last in _TEXT_FILES else [last]
    if last not in _TEXT_FILES or named[0] in ("files", "os", "laspy", "self"):
        return False
    values = [*call.args, *(word.value for word in call.keywords)]
    binary = any(isinstance(each, ast.Constant) and each.value in ("rb", "wb", "r+b", "xb", "ab") for each in values)
    return not binary and "encoding" not in {word.arg for word in call.keywords}


@pytest.mark.parametrize(
    ("planted", "said"),
    [
        ("import fcntl", "fcntl"),
        ("def f():\n    from signal import SIGHUP", "signal.SIGHUP"),
        ("import os\nos.fork()", "os.fork"),
        ("import os\ncores = os.sched_getaffinity(0)", "os.sched_getaffinity"),
        ("import os\nos.rename(a, b)", "os.rename"),
        ("import os\nos.open(path, os.O_NOFOLLOW)", "os.O_NOFOLLOW"),
        ("open('/dev/null', 'wb')", "/dev/null"),
        ("path.open()", "no encoding"),
        ("path.read_text()", "no encoding"),
        ("run(command, preexec_fn=work)", "preexec_fn"),
    ],
)
def test_what_only_some_systems_have_is_seen(planted, said):
    found = unportable("tasks/work.py", ast.parse(planted))
    assert [line.rpartition(" ")[2] for line in found] == [said.rpartition(" ")[2]]
    assert unportable("system.py", ast.parse(planted)) == []


def test_what_only_some_systems_have_is_asked_for_in_two_modules():
    assert [line for module, tree in modules(PACKAGE) for line in unportable(module, tree)] == []
    assert {module for module, _ in modules(PACKAGE)} >= EDGES


def unwritable(names: list[str]) -> list[str]:
    """Return the names of files that some system cannot have, or takes for one with another of them."""
    parts = {name: name.split("/") for name in names}
    bad = [name for name in names if any(_RESERVED.match(part) or _UNWRITABLE.search(part) for part in parts[name])]
    folded = [name.casefold() for name in names]
    return bad + [name for name in names if folded.count(name.casefold()) > 1]


def test_every_system_can_have_the_files_of_the_repository():
    assert unwritable(["docs/aux.md", "a/b:c.py", "a/B.py", "a/b.py", "end./x", "nulls.py", "com.py"]) == [
        "docs/aux.md",
        "a/b:c.py",
        "end./x",
        "a/B.py",
        "a/b.py",
    ]
    folders = ("benchmarks", "camcal", "docs", "sample_configs", "tests")
    paths = (path for folder in folders for path in (PROJECT / folder).rglob("*") if "__pycache__" not in path.parts)
    assert unwritable([path.relative_to(PROJECT).as_posix() for path in paths if path.is_file()]) == []


@pytest.mark.slow
def test_camcal_works_where_the_names_of_posix_are_missing(start_python, tmp_path):
    script = Path(__file__).parent / "run" / "without_posix.py"
    process = start_python(script, cwd=tmp_path, env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)})
    _, err = process.communicate(timeout=120)
    assert process.returncode == 0, err
    lines = err.splitlines()
    assert f"{len(list(modules(PACKAGE))) - 1} modules imported" in lines  # that is, all but camcal/__init__.py
    assert "fan-out: [0, 2, 4, 6, 8], in worker processes without fcntl" in lines
    assert "commands: simulate 0, detect 0, calibrate 0, undistort 0" in lines
    assert sorted(path.name for path in tmp_path.iterdir()) == ["camera.yaml", "corners.csv", "scene", "straight"]
    assert not list(tmp_path.rglob("*.camcal.part-*"))
