"""The order of the steps of a pipeline, which follows from their files, and what is wrong with it."""

import fnmatch
import glob
from collections.abc import Iterable, Iterator, Mapping, Sequence
from collections.abc import Set as AbstractSet
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

from camcal import system
from camcal.dataclass import dataclass
from camcal.errors import FileError
from camcal.formats.documents import Fault
from camcal.images import videos
from camcal.options import INPUT, PATH, Argument, Declared
from camcal.run.options import inputs_of, is_folder
from camcal.run.paths import IMAGE_SUFFIXES, require_there
from camcal.tasks.pipelines.reading import Pipeline
from camcal.tasks.pipelines.step import Step, families, place_of

_FILE_SUFFIXES = IMAGE_SUFFIXES | videos.SUFFIXES | {
    ".yaml", ".yml", ".json", ".xml", ".csv", ".vnl", ".txt", ".tum", ".pfm", ".exr", ".ply", ".html", ".npz", ".dng"
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Order:
    """The steps by their names in an order in which each comes after those that it needs, and the names of these."""

    steps: Mapping[str, Step]
    needs: Mapping[str, tuple[str, ...]]

    def below(self, names: Iterable[str]) -> set[str]:
        """Return the names of steps and of all that need them."""
        found = set(names)
        for name in self.steps:
            if found.intersection(self.needs[name]):
                found.add(name)
        return found

    def above(self, name: str) -> set[str]:
        """Return the names of all steps that a step needs, of those that these need too."""
        found: set[str] = set()
        ahead = list(self.needs[name])
        while ahead:
            other = ahead.pop()
            if other not in found:
                found.add(other)
                ahead += self.needs[other]
        return found


def ordered(pipeline: Pipeline) -> Order:
    """Return the steps in their order; raises InvalidInput for files that two steps write, and for a cycle."""
    steps = {step.name: step for step in pipeline.steps}
    if found := dict.fromkeys(_duplicate_outputs(pipeline)):
        raise pipeline.document.error(found)
    makers = _Makers(pipeline.steps)
    of_family = {name: [step.name for step in members] for name, members in families(pipeline.steps).items()}
    needs = {
        name: tuple(
            dict.fromkeys([*makers.needed(step), *(each for family in step.before for each in of_family[family])])
        )
        for name, step in steps.items()
    }
    try:
        names = list(TopologicalSorter(needs).static_order())
    except CycleError as error:
        cycle = list(reversed(error.args[1]))
        text = f"each needs the result of the one before: {' -> '.join(cycle)}"
        raise pipeline.document.error([pipeline.fault(steps[cycle[0]], text)]) from error
    place = {name: number for number, name in enumerate(steps)}
    depth: dict[str, int] = {}
    for name in names:
        depth[name] = 1 + max((depth[other] for other in needs[name]), default=-1)
    names.sort(key=lambda name: (depth[name], place[name]))
    order = Order({name: steps[name] for name in names}, needs)
    if found := dict.fromkeys(_open_orders(pipeline, order, makers)):
        raise pipeline.document.error(found)
    return order


class _Makers:
    """The steps that write files and folders, by the parts of the paths."""

    def __init__(self, steps: Sequence[Step]) -> None:
        self.of: dict[tuple[str, ...], str] = {}
        self.inside: dict[tuple[str, ...], list[tuple[str, bool]]] = {}
        for step in steps:
            for path, each in step.outputs.items():
                parts = _parts(path)
                self.of[parts] = step.name
                self.inside.setdefault(parts[:-1], []).append((step.name, is_folder(each, path)))

    def needed(self, step: Step) -> Iterator[str]:
        """Yield the names of the steps that write what a step reads."""
        for path in step.inputs:
            for name, child_folder in self.around(path):
                if name != step.name and (not child_folder or step.recursive):
                    yield name

    def around(self, path: Path) -> Iterator[tuple[str, bool]]:
        """Yield the steps that write a path or into it, and whether it is a folder below the path.

        A step writes a path if that, or a folder around it, is an output, or if the path is the folder of an output.
        """
        parts = _parts(path)
        if glob.has_magic(str(path)):
            yield from ((name, False) for written, name in self.of.items() if _matches(parts, written))
            return
        yield from ((self.of[parts[:end]], False) for end in range(1, len(parts) + 1) if parts[:end] in self.of)
        yield from self.inside.get(parts, ())


def _parts(path: Path) -> tuple[str, ...]:
    return place_of(path).parts


def _matches(pattern: Sequence[str], written: Sequence[str]) -> bool:
    """Return whether an output, or what may be inside it, matches a pattern, both by the parts of their paths."""
    for wanted, part in zip(pattern, written, strict=False):
        if wanted == "**":
            return True
        if not fnmatch.fnmatchcase(part, wanted):
            return False
    return len(written) <= len(pattern)


def _duplicate_outputs(pipeline: Pipeline) -> Iterator[Fault]:
    known: dict[str, Step] = {}
    for step in pipeline.steps:
        for path, each in step.outputs.items():
            other = known.setdefault(system.place_of(path), step)
            if other is not step:
                text = f"is written by step {other.name} too; give each a place of its own"
                if other.family == step.family:
                    text = "is the same for several items; put the item of the list into it"
                yield pipeline.fault(step, f"{each.key}: {path} {text}")


def _open_orders(pipeline: Pipeline, order: Order, makers: _Makers) -> Iterator[Fault]:
    """Yield steps that read a folder into which another one writes a folder, where it is open which comes first."""
    for step in order.steps.values():
        for path in step.inputs:
            for name in {name for name, below in makers.around(path) if below and name != step.name}:
                if name not in order.above(step.name) and step.name not in order.above(name):
                    text = f"reads {path}, into which step {name} writes; add 'after: {order.steps[name].family}'"
                    yield pipeline.fault(step, text)


def missing_inputs(pipeline: Pipeline, order: Order, chosen: AbstractSet[str]) -> Iterator[Fault]:
    """Yield files that the chosen steps need and that are neither there nor made by a chosen step before them."""
    makers = _Makers(pipeline.steps)
    for name in chosen:
        step, above = order.steps[name], order.above(name)
        for each, path in _named_files(step):
            makers_of = {other for other, _ in makers.around(path)} - {name}
            if makers_of & above & chosen or _is_there(path):
                continue
            if makers_of & above:
                advice = f"{path} is not there and step {min(makers_of & above)}, which makes it, is not chosen"
            elif makers_of:
                advice = f"{path} is not there; if step {min(makers_of)} makes it, add 'after' with its name"
            else:
                advice = f"{path}: {_missing(path)}"
            yield Fault(f"steps.{step.family}.{'arguments' if each.positional else each.key}", advice)


def _named_files(step: Step) -> Iterator[tuple[Declared, Path]]:
    """Yield the files and folders that the options of a step certainly name as inputs."""
    for each, value in step.given.items():
        if inputs_of(each, value):
            yield from ((each, path) for text in each.texts(value) if (path := _named_file(each, text)) is not None)


def _named_file(each: Declared, text: str) -> Path | None:
    """Return the file that a text names as FILE, NAME=FILE or FILE#NAME; None for one that may mean something else."""
    _, equals, rest = text.partition("=")
    body = rest if equals and not Path(text).exists() else text
    body = body.rpartition("#")[0] if "#" in body and not Path(body).exists() else body
    if each.type is PATH:
        return Path(body)
    option = each.option
    is_file = isinstance(option, Argument) and option.group == INPUT and not option.numbers
    if ":" in body or not (is_file or Path(body).suffix.lower() in _FILE_SUFFIXES):
        return None
    return Path(body)


def _is_there(path: Path) -> bool:
    return videos.file_of(path).exists() or bool(glob.glob(str(path), recursive=True))  # noqa: PTH207 - of absolute patterns too


def _missing(path: Path) -> str:
    if glob.has_magic(str(path)):
        return "matches no file"
    try:
        require_there(path)
    except FileError as error:
        return error.message
    return "is not there"
