"""Left and right images that belong together, by their names."""

import re
from collections.abc import Callable, Sequence
from pathlib import Path

from camcal.errors import InvalidInput
from camcal.run.inputs import find_images

# As words or before a capital or a digit (left_01, imgL, leftImage, L7), not within words such as bright.
_SIDE = re.compile(
    r"(?<![A-Za-z])(?:left|right|Left|Right|LEFT|RIGHT|[lrLR])(?![a-z])|(?<=[a-z])(?:Left|Right|[LR])(?![a-z])"
)
_NUMBER = re.compile(r"(?<!\d)[01](?!\d)")


def find_pairs(
    lefts: Sequence[Path | str], rights: Sequence[Path | str], recursive: bool = False
) -> list[tuple[Path, Path]]:
    """Return the pairs (left, right) that files, folders and quoted patterns stand for, in natural order of the left.

    Raises FileError as `find_images` does, InvalidInput as `paired` does, or if an image stands on both sides.
    """
    left, right = find_images(lefts, recursive), find_images(rights, recursive)
    alone = len(left) == len(right) == 1
    pairs = [(left[0], right[0])] if alone else paired(left, right, ("left", "right images"))
    for first, second in pairs:
        if first.resolve() == second.resolve():
            raise InvalidInput("is given as the left and as the right image", where=str(first))
    return pairs


def paired(left: Sequence[Path], right: Sequence[Path], sides: tuple[str, str]) -> list[tuple[Path, Path]]:
    """Return the files of two sides that belong together, in the order of the left.

    They are paired by name where names agree but for marks such as left, right, L, R, 0 and 1, and in the order given
    where no two names do. sides: what a message calls so many of each.
    Raises InvalidInput if one side has more files or only some names agree.
    """
    return _by_name(left, right) or _in_order(left, right, sides)


def _by_name(left: Sequence[Path], right: Sequence[Path]) -> list[tuple[Path, Path]] | None:
    """Return the pairs if some reading of the names gives each image its partner."""
    for name in _READINGS:
        partners = {name(path): path for path in right}
        names = [name(path) for path in left]
        if len(set(names)) == len(left) and len(partners) == len(right) and set(names) == set(partners):
            return [(path, partners[key]) for path, key in zip(left, names, strict=True)]
    return None


def _in_order(left: Sequence[Path], right: Sequence[Path], sides: tuple[str, str]) -> list[tuple[Path, Path]]:
    lonely = _lonely(left, right)
    counts = f"{len(left)} {sides[0]} and {len(right)} {sides[1]}"
    if len(left) != len(right):
        raise InvalidInput(f"{counts} do not pair up" + (f"; {lonely} has no partner" if lonely else ""))
    if lonely:
        raise InvalidInput(f"{counts} agree in some names only; {lonely} has no partner")
    return list(zip(left, right, strict=True))


def _lonely(left: Sequence[Path], right: Sequence[Path]) -> Path | None:
    """Return the first image whose name has no partner in the reading that pairs most; None if none pairs any."""
    best: tuple[int, Path | None] = (0, None)
    for name in _READINGS:
        sides = {name(path) for path in left}, {name(path) for path in right}
        shared = sides[0] & sides[1]
        if len(shared) > best[0]:
            best = len(shared), next((path for path in (*left, *right) if name(path) not in shared), None)
    return best[1]


def _stem(path: Path) -> str:
    return path.stem


def _without_sides(path: Path) -> str:
    return _SIDE.sub("", path.stem)


def _without_numbers(path: Path) -> str:
    return _NUMBER.sub("", path.stem)


def _with_folder(path: Path) -> str:
    """Return the name after that of its folder, both without marks, for scene1/left.png or cam0/0001.png."""
    return "/".join(_NUMBER.sub("", _SIDE.sub("", part)) for part in (path.absolute().parent.name, path.stem))


_READINGS: tuple[Callable[[Path], str], ...] = (_stem, _without_sides, _without_numbers, _with_folder)
