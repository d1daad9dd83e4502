"""Where results go: a file or a folder, no two to one place, and never over an input or over what others wrote."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from camcal.errors import InvalidInput


def place(inputs: Sequence[Path], output: Path, suffix: str, kinds: Iterable[str]) -> dict[Path, Path]:
    """Return the file for each input: the output itself for a single one, else one by its name in a folder.

    suffix: of files in a folder. kinds: suffixes that a file may have.
    Raises InvalidInput if the output is a file for several inputs, of another kind, or a suffix without a name; see
    also `refuse_collisions`.
    """
    if output.name.lower() in kinds and not output.is_dir():
        raise InvalidInput(f"is a suffix without a name; write NAME{output.name}, or a folder", where=str(output))
    if output.suffix and not output.is_dir():
        if len(inputs) > 1:
            raise InvalidInput(f"{len(inputs)} inputs do not go into one file; give a folder", where=str(output))
        if output.suffix.lower() not in kinds:
            raise InvalidInput(f"{output.suffix} is not written; use {', '.join(kinds)}", where=str(output))
        outputs = {inputs[0]: output}
    else:
        outputs = {path: output / f"{path.stem}{suffix}" for path in inputs}
    refuse_collisions(outputs)
    refuse_overwriting(outputs.values(), inputs)
    return outputs


def require_folder(path: Path, option: str) -> None:
    """Raise InvalidInput, naming the option, if files cannot go to this folder because it is a file."""
    if path.exists() and not path.is_dir():
        raise InvalidInput(f"{option} takes a folder, this is a file", where=str(path))


def refuse_overwriting(outputs: Iterable[Path], inputs: Iterable[Path]) -> None:
    """Raise InvalidInput if an output is one of the inputs."""
    read = {path.resolve() for path in inputs}
    for path in outputs:
        if path.resolve() in read:
            raise InvalidInput("is an input and is not overwritten; choose another output", where=str(path))


def refuse_collisions(outputs: Mapping[Path, Path]) -> None:
    """Raise InvalidInput if two inputs (the keys) would be written to one file."""
    taken: dict[Path, Path] = {}
    for source, file in outputs.items():
        if file in taken:
            raise InvalidInput(f"{taken[file]} and {source} would both be written to it; rename one", where=str(file))
        taken[file] = source
