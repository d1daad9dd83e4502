"""What a command reads: files, folders and patterns as lists of images; `rig.yaml#left`, a file and camera.

Files that camcal wrote into a folder (see `outputs`) are left out beside other images, so that a second run does not
read what the first one wrote; a folder with nothing else was named on purpose and is read.

Left and right images belong together by their names. Results go to a file or a folder, no two to one place.
"""

import glob
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from collections.abc import Set as AbstractSet
from pathlib import Path

from camcal import files, system
from camcal.dataclass import dataclass
from camcal.errors import FileError, InvalidInput
from camcal.images.image import RAW_SUFFIXES, conversion_advice
from camcal.images.videos import BAG_SUFFIXES, SUFFIXES, address_of, file_of, is_video
from camcal.parsing import in_one_line, nearest
from camcal.run.outputs import listed

IMAGE_SUFFIXES = RAW_SUFFIXES | {
    ".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".pgm", ".ppm", ".pnm", ".webp", ".jp2", ".npy"
}  # fmt: skip

# As words or before a capital or a digit (left_01, imgL, leftImage, L7), not within words such as bright.
_SIDE = re.compile(
    r"(?<![A-Za-z])(?:left|right|Left|Right|LEFT|RIGHT|[lrLR])(?![a-z])|(?<=[a-z])(?:Left|Right|[LR])(?![a-z])"
)
_NUMBER = re.compile(r"(?<!\d)[01](?!\d)")


@dataclass(frozen=True)
class Media:
    """Images and videos, each without duplicates and in natural order of their paths."""

    images: tuple[Path, ...]
    videos: tuple[Path, ...]


def find_media(inputs: Sequence[Path | str], recursive: bool = False, also: AbstractSet[str] = frozenset()) -> Media:
    """Return the images and videos that files, folders and quoted patterns stand for.

    A file is taken whatever its suffix; a bag stands for a topic with images, see `images.bag`. Folders and patterns
    give files with a known suffix, or one of `also`, hidden ones left out.
    Raises InvalidInput without inputs, FileError for a missing path and for a folder or pattern that yields nothing.
    """
    if not inputs:
        raise InvalidInput("no images given; name files, a folder or a quoted pattern such as 'photos/*.jpg'")
    known = IMAGE_SUFFIXES | SUFFIXES | also
    given: dict[Path, int] = {}
    for place, text in enumerate(inputs):
        for path in _expand(str(text), recursive, known):
            if path.suffix.lower() in BAG_SUFFIXES or "#" in str(path) or path.is_dir():  # all that may be a bag
                from camcal.images.bag import addressed  # here, since it decodes images

                path = addressed(path)  # noqa: PLW2901
            given.setdefault(path, place)
    ordered = sorted(given, key=_natural_path)
    first: dict[Path, Path] = {}  # names of files, by what they are: the first name in the first input that has one
    for path in sorted(ordered, key=given.__getitem__):
        first.setdefault(path.resolve(), path)
    chosen = set(first.values())
    paths = [path for path in ordered if path in chosen]
    videos = [path for path in paths if path.suffix.lower() in SUFFIXES or ("#" in str(path) and is_video(path))]
    for path in paths:
        files.note_read(file_of(path) if path in videos else path)
    return Media(images=tuple(path for path in paths if path not in videos), videos=tuple(videos))


def find_images(
    inputs: Sequence[Path | str], recursive: bool = False, also: AbstractSet[str] = frozenset()
) -> list[Path]:
    """Return the images that files, folders and quoted patterns stand for, in natural order; see `find_media`.

    Videos in folders are left out. Raises FileError for a video that is named, and if there is nothing but videos.
    """
    media = find_media(inputs, recursive, also)
    named = [path for path in map(Path, inputs) if is_video(path)]
    if named or not media.images:
        raise FileError("is a video, images are needed", where=str((named or media.videos)[0]))
    return list(media.images)


def find_files(inputs: Sequence[str]) -> list[Path]:
    """Return the files that names and quoted patterns stand for, those of a pattern in natural order.

    Raises FileError for a file that is not there and for a pattern that matches none.
    """
    found: list[Path] = []
    for text in inputs:
        if glob.has_magic(text) and not Path(text).exists():
            matches = map(Path, glob.glob(text, recursive=True))  # noqa: PTH207 - as in `_matching`
            found += sorted((path for path in matches if path.is_file()), key=_natural_path)
            if not found:
                raise FileError("matches no file", where=text)
        else:
            require_there(Path(text))
            found.append(Path(text))
    return found


def require_there(path: Path) -> None:
    """Raise FileError, with the nearest name beside it, unless a file or folder is there."""
    if str(path) != files.STANDARD and not path.exists():
        raise FileError(_missing(path), where=str(path))


def _expand(text: str, recursive: bool, known: AbstractSet[str]) -> list[Path]:
    path = Path(text)
    try:
        if path.is_dir() and address_of(path) is None:
            return _in_folder(path, recursive, known)
        if path.exists():
            return [path]
    except OSError as error:  # such as a name that is too long
        raise FileError(f"cannot be read: {error.strerror}", where=str(error.filename or text)) from error
    if address_of(path) is not None:
        require_there(file_of(path))
        return [path]
    if glob.has_magic(text):
        return _matching(text, known)
    raise FileError(_missing(path), where=text)


def _in_folder(folder: Path, recursive: bool, known: AbstractSet[str]) -> list[Path]:
    everything = list(_walk(folder)) if recursive else list(folder.iterdir())
    found = _without_outputs([path for path in everything if _is_medium(path, known)])
    if not found:
        below = not recursive and any(path.is_dir() for path in everything)
        advice = "; --recursive reads the folders below it" if below else ""
        raise FileError(f"holds no image ({_contents(everything)}){advice}{_conversion(everything)}", where=str(folder))
    return found


def _walk(folder: Path) -> Iterator[Path]:
    for path in folder.iterdir():
        yield path
        if path.is_dir() and not path.is_symlink() and not path.name.startswith("."):
            yield from _walk(path)


def _matching(pattern: str, known: AbstractSet[str]) -> list[Path]:
    names = glob.glob(pattern, recursive=True)  # noqa: PTH207 - Path.glob refuses absolute patterns
    everything = [Path(name) for name in names]
    found = _without_outputs([path for path in everything if _is_medium(path, known)])
    if not found:
        found_there = f"matches no image ({_contents(everything)}){_conversion(everything)}"
        matches = found_there if everything else "matches no file"
        raise FileError(matches, where=pattern)
    return found


def _is_medium(path: Path, known: AbstractSet[str]) -> bool:
    """Return whether a path in a folder stands for an image or a video; reading a broken link says that it is one."""
    named = path.suffix.lower() in known and path.name[0] != "."
    return named and (path.is_file() or (path.is_symlink() and not path.exists()))


def _without_outputs(paths: list[Path]) -> list[Path]:
    written = {folder: listed(folder) for folder in {path.parent for path in paths}}
    return [path for path in paths if in_one_line(path.name) not in written[path.parent]] or paths


def _contents(paths: Iterable[Path]) -> str:
    """Return what a folder holds in words, such as '12 .txt, 1 folder'."""
    kinds = Counter("folder" if path.is_dir() else path.suffix.lower() or "without suffix" for path in paths)
    words = [f"{count} {kind}{'s' if kind == 'folder' and count > 1 else ''}" for kind, count in kinds.most_common(5)]
    return ", ".join(words) or "it is empty"


def _conversion(paths: Iterable[Path]) -> str:
    advice = conversion_advice(path.suffix for path in paths)
    return f"; {advice}" if advice else ""


def _missing(path: Path) -> str:
    """Return what is missing of a path that does not exist, with the nearest name beside it."""
    while not path.parent.is_dir() and path.parent != path:
        path = path.parent
    try:
        near = nearest(path.name, (other.name for other in path.parent.iterdir()))
    except OSError:
        near = None
    return f"no such file. Did you mean '{path.parent / near}'?" if near else "no such file"


def _natural_path(path: Path) -> tuple[object, ...]:
    return tuple(files.natural_key(part) for part in path.parts)


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
    for name in NAME_READINGS:
        partners = {name(path): path for path in right}
        names = [name(path) for path in left]
        if len(set(names)) == len(left) and len(partners) == len(right) and set(names) == set(partners):
            return [(path, partners[key]) for path, key in zip(left, names, strict=True)]
    return None


def _in_order(left: Sequence[Path], right: Sequence[Path], sides: tuple[str, str]) -> list[tuple[Path, Path]]:
    lonely = _lonely(left, right)
    counts = f"{len(left)} {sides[0]} and {len(right)} {sides[1]}"
    if len(left) != len(right):
        raise InvalidInput(f"{counts} differ" + (f"; {lonely} is unpaired" if lonely else ""))
    if lonely:
        raise InvalidInput(f"{counts} have only some names in common; {lonely} is unpaired")
    return list(zip(left, right, strict=True))


def _lonely(left: Sequence[Path], right: Sequence[Path]) -> Path | None:
    """Return the first image whose name has no partner in the reading that pairs most; None if none pairs any."""
    best: tuple[int, Path | None] = (0, None)
    for name in NAME_READINGS:
        sides = {name(path) for path in left}, {name(path) for path in right}
        shared = sides[0] & sides[1]
        if len(shared) > best[0]:
            best = len(shared), next((path for path in (*left, *right) if name(path) not in shared), None)
    return best[1]


def _with_folder(path: Path) -> str:
    """Return the name after that of its folder, both without marks, for scene1/left.png or cam0/0001.png."""
    return "/".join(_NUMBER.sub("", _SIDE.sub("", part)) for part in (path.absolute().parent.name, path.stem))


NAME_READINGS: tuple[Callable[[Path], str], ...] = (
    lambda path: path.stem,
    lambda path: _SIDE.sub("", path.stem),
    lambda path: _NUMBER.sub("", path.stem),
    _with_folder,
)


def names_file(output: Path, kinds: Iterable[str]) -> bool:
    """Return whether an output is a file, not a folder; raises InvalidInput for a suffix that is none of its kinds."""
    if output.is_dir() or not (output.suffix or output.name.lower() in kinds):
        return False
    if output.name.lower() in kinds:
        raise InvalidInput(f"is a suffix without a name; write NAME{output.name}, or a folder", where=str(output))
    if output.suffix.lower() not in kinds:
        raise InvalidInput(f"{output.suffix} is not written; use {', '.join(kinds)}", where=str(output))
    return True


def require_one(output: Path, count: int) -> None:
    """Raise InvalidInput if more than one input would go into a file."""
    if count > 1:
        raise InvalidInput(f"{count} inputs cannot be written to one file; give a folder", where=str(output))


def place(inputs: Sequence[Path], output: Path, suffix: str, kinds: Iterable[str]) -> dict[Path, Path]:
    """Return the file for each input: the output itself for a single one, else one by its name in a folder.

    suffix: of files in a folder. kinds: suffixes that a file may have.
    Raises InvalidInput if the output is a file for several inputs, of another kind, or a suffix without a name; see
    also `refuse_collisions`.
    """
    if names_file(output, kinds):
        require_one(output, len(inputs))
        outputs = {inputs[0]: output}
    else:
        outputs = {path: output / f"{path.stem}{suffix}" for path in inputs}
    refuse_collisions(outputs)
    return outputs


def refuse_collisions(outputs: Mapping[Path, Path]) -> None:
    """Raise InvalidInput if two inputs (the keys) would be written to one file, in folders that ignore case too."""
    taken: dict[str, Path] = {}
    for source, file in outputs.items():
        place = system.place_of(file)
        if place in taken:
            raise InvalidInput(f"{taken[place]} and {source} would both be written to it; rename one", where=str(file))
        taken[place] = source
