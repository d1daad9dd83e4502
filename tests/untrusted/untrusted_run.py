"""Damaged files through every command: each in a process of its own with little memory, and what it did wrong.

A case is right if the command ends with a documented exit code, says what is wrong in lines of its own (no traceback,
no raw warning, no control characters), stays within its memory and time, and leaves nothing behind but its result.
`benchmarks/fuzz.py` runs thousands.
"""

import os
import re
import resource
import shutil
import signal
import struct
import sys
import zipfile
import zlib
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import untrusted_mutations  # noqa: E402
import untrusted_seeds  # noqa: E402
from untrusted_mutations import ABSURD  # noqa: E402
from untrusted_readers import READERS, Reader  # noqa: E402

MEMORY = 700 << 20  # bytes that a command may take beyond what its imports have
MAX_PIXELS = "20000000"  # little, so that no damaged header asks for much within the limit
TIME_S = 20.0  # of the processor
DOCUMENTED = {0, 2, 3, 4, 5, 6, 7}
WITHOUT_OUTPUT = {2, 3, 4, 5}
LONGEST_LINE = 4100
LONGEST_S = 5.0  # of the processor, for an absurd number
TEXTS = {".yaml", ".yml", ".xml", ".json", ".csv", ".txt", ".tum", ".vnl"}

_CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2028\u2029]")
_WARNING = re.compile(r"\w+Warning:")


@dataclass(frozen=True)
class Case:
    """A command line, the damaged file, and the name of what was done to it."""

    reader: Reader
    mutation: str
    seed: int
    content: bytes


@dataclass(frozen=True)
class Ended:
    """How a command ended: exit code (below 0 a signal), what it printed, what it left, bytes and seconds it took."""

    code: int
    out: str
    err: str
    left: tuple[str, ...]
    peak: int
    seconds: float
    ran_out: bool


def load_everything() -> None:
    """Import all that commands import by themselves, so that a process forked from this one starts at once."""
    from importlib import import_module

    os.environ["OPENCV_IO_MAX_IMAGE_PIXELS"] = MAX_PIXELS  # OpenCV reads it when it is imported
    for module in Path(sys.modules["camcal"].__file__ or "").parent.rglob("*.py"):
        parts = module.relative_to(Path(sys.modules["camcal"].__file__ or "").parent).with_suffix("").parts
        import_module(".".join(("camcal", *parts)).removesuffix(".__init__"))
    for name in (
        "rawpy",
        "scipy.linalg",
        "scipy.special",
        "scipy.stats",
        "scipy.spatial",
        "scipy.sparse",
        "scipy.optimize",
    ):
        import_module(name)
    with suppress(ImportError):
        import_module("typer._adapters")  # brings pydantic where that is installed, which takes half of most cases
    _whole_command()
    with_fonts = import_module("matplotlib.figure").Figure()
    with_fonts.text(0, 0, "x")
    with_fonts.savefig(os.devnull, format="png")


def command(arguments: Sequence[str]) -> int:
    """Return the exit code of a command line in this process; raises what the command raises by mistake."""
    try:
        _whole_command()(list(arguments))
    except SystemExit as left:
        return int(left.code or 0)
    return 0


@cache
def _whole_command() -> Any:
    """Return the command with all its subcommands; building it takes longer than most cases."""
    from typer.main import get_command

    from camcal.cli.main import app

    return get_command(app)


def make_good_files(folder: Path) -> None:
    """Write the good files into `folder`, in a process of its own."""
    folder.mkdir(parents=True, exist_ok=True)
    child = os.fork()
    if child == 0:
        done = 1
        try:
            with Path(os.devnull).open("w") as nowhere:
                sys.stdout = nowhere

                def run(arguments: list[str]) -> None:
                    if (code := command(arguments)) not in (0, 7):
                        raise RuntimeError(f"{arguments} ended with {code}")

                untrusted_seeds.make(folder, run)
                done = 0
        finally:
            os._exit(done)
    if os.waitpid(child, 0)[1] != 0:
        raise RuntimeError("a good file could not be made")


def readers_of(only: str) -> list[Reader]:
    """Return the readers whose names or command lines hold a text."""
    return [reader for reader in READERS if only in reader.name or only in reader.command]


def case(good: Path, reader: Reader, seed: int) -> Case:
    """Return the case that a seed makes for a reader."""
    rng = np.random.default_rng([seed, zlib.crc32(reader.command.encode())])
    content = (good / reader.file).read_bytes()
    choices = untrusted_mutations.mutations_of(reader.file, content)
    names = []
    for _ in range(int(rng.choice([1, 1, 1, 2]))):
        mutation = choices[int(rng.integers(len(choices)))]
        try:
            content = mutation(content, rng) or b""
        except (
            ValueError,
            LookupError,
            OSError,
            struct.error,
            zipfile.BadZipFile,
            NotImplementedError,
            zlib.error,
        ):  # the first one left nothing to damage so
            continue
        names.append(mutation.__name__)
    return Case(reader, "+".join(names), seed, content)


def readers_by_output(only: str) -> list[Reader]:
    """Return a reader for every command and every output of it, new or with what an earlier run left."""
    found = {}
    for reader in readers_of(only):
        words = reader.command.split()
        where = [word for word in words if word.startswith(("OUT", "HERE")) or word == "--resume"]
        found.setdefault((reader.verb, *where), reader)
    return list(found.values())


def cases_of_numbers(good: Path, only: str, most: int | None, seed: int) -> list[tuple[Reader, tuple[int, int], float]]:
    """Return the readers of texts, where a number stands in their files, and absurd values for it.

    most: how many each reader has, spread over places and values, which differ between readers; None for all.
    """
    found = []
    for number, reader in enumerate(dict.fromkeys(readers_of(only))):
        if (good / reader.file).suffix in TEXTS:
            text = (good / reader.file).read_text(encoding="utf-8")
            own = [(reader, at, value) for at in untrusted_mutations.fields(text) for value in ABSURD]
            count = min(most or len(own), len(own))
            shift = 0 if most is None else 7 * number + seed
            found += [own[(k * len(own) // count + shift) % len(own)] for k in range(count)]
    return found


def case_of_number(good: Path, number: int, reader: Reader, at: tuple[int, int], value: float) -> Case:
    """Return the case of an absurd value at a place of a reader's file."""
    text = (good / reader.file).read_text(encoding="utf-8")
    first, last = at
    words = f"line {text.count(chr(10), 0, first) + 1}: {text[max(first - 20, 0) : last]!r} is {value!r}"
    return Case(reader, words, number, (text[:first] + repr(value) + text[last:]).encode())


def run(case: Case, good: Path, room: Path, largest: int = resource.RLIM_INFINITY) -> Ended:
    """Run a case in an empty folder `room` and return how it ended; largest: bytes that it may write to a file."""
    shutil.rmtree(room, ignore_errors=True)
    room.mkdir()
    damaged = room / case.reader.file
    damaged.write_bytes(case.content)
    for name in case.reader.beside:
        shutil.copy(good / name, room)
    before = {path.name for path in room.iterdir()}
    arguments = case.reader.arguments(damaged, good, room / "out")
    arguments = [str(room / word) if word in case.reader.beside else word for word in arguments]
    (room.parent / "out.txt").unlink(missing_ok=True)
    child = os.fork()
    if child == 0:
        _serve(arguments, room, largest)
    _, status, usage = os.wait4(child, 0)
    out, err = ((room.parent / name).read_text(errors="replace") for name in ("out.txt", "err.txt"))
    after = () if case.reader.keeps else room.rglob("*")
    left = tuple(str(path.relative_to(room)) for path in after if path.is_file() and path.name not in before)
    code = os.waitstatus_to_exitcode(status)
    return Ended(code, out, err, left, usage.ru_maxrss << 10, usage.ru_utime + usage.ru_stime, "out of memory" in err)


def _serve(arguments: list[str], room: Path, largest: int) -> None:
    """Run a command in this forked process and end it."""
    code = 1
    try:
        size = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (size + MEMORY, size + MEMORY))
        resource.setrlimit(resource.RLIMIT_CPU, (int(TIME_S), int(TIME_S) + 5))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        resource.setrlimit(resource.RLIMIT_FSIZE, (largest, largest))
        sys.dont_write_bytecode = True  # it would be cut off there, and every later process would read the rest
        signal.alarm(int(3 * TIME_S))
        os.chdir(room)
        for number, name in ((1, "out.txt"), (2, "err.txt")):
            opened = os.open(room.parent / name, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
            os.dup2(opened, number)
        sys.stdout, sys.stderr = (os.fdopen(number, "w", encoding="utf-8", closefd=False) for number in (1, 2))
        from camcal.cli import main

        main.prepare()
        code = command(arguments)
    except BaseException:  # noqa: BLE001 - as the interpreter would show it
        import traceback

        traceback.print_exc()
        code = 1
    finally:
        for stream in (sys.stdout, sys.stderr):
            with suppress(OSError, ValueError):
                stream.flush()
        os._exit(code)


def violations_of_full_disk(ended: Ended) -> list[str]:
    """Return what a command did wrong whose files could not grow; whole files that were written before may stay."""
    found = [fault for fault in violations(ended) if not fault.startswith(("left ", "litter"))]
    if any(".camcal.part-" in name for name in ended.left):
        found.append("a half-written file")
    if ended.code not in {0, *WITHOUT_OUTPUT}:
        found.append(f"exit {ended.code}")
    if ended.code == 3 and "cannot be written: File too large" not in ended.err:
        found.append(f"said {ended.err.strip()[-160:]!r}")
    return found


def violations_of_number(case: Case, ended: Ended) -> list[str]:
    """Return what a command did wrong with an absurd number: a usage error names the file, and nothing takes long.

    Of a settings file it may name the value alone, as of one on the command line.
    """
    found = violations(ended)
    settings = "--config FILE" in case.reader.command
    if ended.code == 2 and f"{case.reader.file}:" not in ended.err and not settings:
        found.append(f"no place in {ended.err.strip()[-160:]!r}")
    if ended.seconds > LONGEST_S:
        found.append(f"{ended.seconds:.1f} s")
    return found


def violations(ended: Ended) -> list[str]:
    """Return what a command did wrong, in words."""
    found = []
    if ended.code not in DOCUMENTED:
        last = ended.err.strip().splitlines()[-1:] or ["nothing said"]
        found.append(f"exit {ended.code}: {last[0][:200]}")
    lines = ended.err.splitlines()
    if "Traceback" in ended.err and ended.code in DOCUMENTED:
        found.append("a traceback")
    if _WARNING.search(ended.err) and ended.code in DOCUMENTED:
        found.append(f"a raw warning: {_WARNING.search(ended.err)[0]}")
    elif ended.code in DOCUMENTED and any(not line.startswith("camcal: ") for line in lines):
        wrong = next(line for line in lines if not line.startswith("camcal: "))
        found.append(f"a line that is not its own: {wrong[:120]!r}")
    if _CONTROL.search(ended.err) or _CONTROL.search(ended.out):
        found.append("control characters")
    if ended.code in WITHOUT_OUTPUT and "camcal: error: " not in ended.err:
        found.append(f"exit {ended.code} without a word")
    if any(len(line) > LONGEST_LINE for line in lines):
        found.append("an endless line")
    if ended.code in WITHOUT_OUTPUT and ended.left:
        found.append(f"left {ended.left[0]} behind")
    elif litter := [name for name in ended.left if Path(name).name.startswith(".") and ".camcal-output" not in name]:
        found.append(f"litter: {litter[0]}")
    if ended.ran_out:
        found.append(f"out of memory: {ended.err.strip().splitlines()[-1][:160]}")
    return found
