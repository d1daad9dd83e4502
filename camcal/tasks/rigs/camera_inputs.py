"""Which inputs are of which camera: NAME=PATH, paths named by their folders or patterns, one folder with all images."""

import re
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from collections.abc import Set as AbstractSet
from pathlib import Path, PurePath

from camcal.dataclass import dataclass
from camcal.errors import InvalidInput
from camcal.formats.native import NAME
from camcal.geometry.pose import JOINT
from camcal.images.bag import topics_of
from camcal.images.videos import address_of, file_of, is_video
from camcal.messages import counted
from camcal.run.paths import IMAGE_SUFFIXES, Media, find_media
from camcal.tasks.calibration.board_views import is_table

SYNTAX = "give NAME=PATH for each camera, such as left=photos/left right=photos/right"
_MOST_CAMERAS = 16  # in one folder; a part of names with more values counts images
_LEAST_SHARED = 0.5  # of the images in a folder: whose names differ by the camera alone from those of another one
_TOKENS = re.compile(r"[A-Z]?[a-z]+|[A-Z]+|\d+")
_SIDES = {"l": "left", "r": "right", "m": "middle", "c": "centre", "t": "top", "b": "bottom"}
_PLACES = frozenset(
    {*_SIDES, *_SIDES.values(), "center", "upper", "lower", "front", "rear", "back", "up", "down", "master", "slave"}
)
_CAMERA_WORDS = frozenset({"cam", "camera", "c", "dev", "device", "sensor", "view", "kinect", "cn"})


@dataclass(frozen=True)
class CameraInputs:
    """The images, videos and detections files of a camera; its name is empty where the detections name the cameras."""

    name: str
    images: tuple[Path, ...] = ()
    videos: tuple[Path, ...] = ()
    tables: tuple[str, ...] = ()


@dataclass(frozen=True)
class _Split:
    """A way to sort images of one folder by camera, and the share of images that have a counterpart."""

    groups: Mapping[str, tuple[Path, ...]]
    shared: float
    named: bool  # whether the part of the names that differs is known to name cameras


def cameras_of(
    texts: Sequence[str], recursive: bool = False, also: AbstractSet[str] = frozenset()
) -> tuple[tuple[CameraInputs, ...], tuple[str, ...]]:
    """Return the inputs of every camera in the order given, and a line of the report where names were worked out.

    also: suffixes of images beside the usual ones. Raises InvalidInput where the cameras cannot be told apart, or an
    image is of two of them; FileError as `find_media` does.
    """
    given = [_named(text) for text in texts]
    if not given:
        raise InvalidInput(f"no images given: {SYNTAX}")
    if len(given) == 1 and address_of(alone := Path(given[0][1])) == (alone, ""):
        given = [("", str(topic)) for topic in topics_of(alone)]
    unnamed = [path for name, path in given if not name]
    if unnamed and len(unnamed) < len(given):
        raise InvalidInput(f"some inputs name their camera and this one does not: {SYNTAX}", where=unnamed[0])
    if len(unnamed) == 1:
        [path] = unnamed
        if is_video(Path(path)) and file_of(Path(path)).exists():
            raise InvalidInput(f"is the video of one camera: {SYNTAX}", where=path)
        return _in_one(path, recursive, also)
    lines: tuple[str, ...] = ()
    if unnamed:
        names = _names_of(unnamed)
        given = list(zip(names, unnamed, strict=True))
        lines = (f"cameras by the names of their inputs: {', '.join(dict.fromkeys(names))}",)
    paths: dict[str, list[str]] = defaultdict(list)
    for name, path in given:
        require_name(name)
        paths[name].append(path)
    cameras = tuple(_inputs(name, texts, recursive, also) for name, texts in paths.items())
    if len(cameras) == 1:
        raise InvalidInput(f"all images are of camera {cameras[0].name!r}: a rig has two or more; {SYNTAX}")
    _refuse_shared(cameras)
    return cameras, lines


def require_name(name: str, what: str = "camera") -> None:
    """Raise InvalidInput unless a camera, or something else, may have this name in a file."""
    if not NAME.match(name) or JOINT in name:
        raise InvalidInput(f"{name!r} is not a valid name of a {what}: letters, digits and single '_', a letter first")


def _named(text: str) -> tuple[str, str]:
    """Return the camera that an input names, empty without one, and its path."""
    name, mark, path = text.partition("=")
    if not mark or "/" in name or Path(text).exists():
        return "", text
    if not name or not path:
        raise InvalidInput(f"no {'path' if name else 'name'} in {text!r}: {SYNTAX}")
    return name, path


def _inputs(name: str, texts: Sequence[str], recursive: bool, also: AbstractSet[str]) -> CameraInputs:
    tables = tuple(text for text in texts if is_table(text))
    others = [text for text in texts if not is_table(text)]
    media = find_media(others, recursive, also) if others else Media((), ())
    return CameraInputs(name, media.images, media.videos, tables)


def _refuse_shared(cameras: Sequence[CameraInputs]) -> None:
    """Raise InvalidInput for an image that is given for two cameras."""
    owner: dict[Path, str] = {}
    for camera in cameras:
        for path in (*camera.images, *camera.videos):
            other = owner.setdefault(path.resolve(), camera.name)
            if other != camera.name:
                raise InvalidInput(f"is given for camera {other!r} and for camera {camera.name!r}", where=str(path))


def _names_of(paths: Sequence[str]) -> list[str]:
    """Return names for inputs: of a folder its own, of a pattern what it says, of a file its stem; raises InvalidInput
    where two inputs would have one name.
    """
    depth = max(len(PurePath(path).parts) for path in paths)
    for level in range(1, depth + 1):
        found = [_tidy(_part(path, level)) for path in paths]
        if len(set(found)) == len(found) and all(NAME.match(name) for name in found):
            return found
    raise InvalidInput(f"the cameras of {' and '.join(paths)} have no names: {SYNTAX}")


def _part(path: str, level: int) -> str:
    """Return a part of a path, counted from its end, without suffix and wildcards."""
    parts = PurePath(path).parts
    part = parts[-level] if level <= len(parts) else ""
    return PurePath(part).stem if level == 1 and not Path(path).is_dir() else part


def _tidy(part: str) -> str:
    """Return a part of a path as the name of a camera."""
    words = re.findall(r"[A-Za-z0-9]+", re.sub(r"\[[^\]]*\]|[*?]", " ", part))
    return (f"cam{words[0]}" if words and words[0].isdigit() else "") or "_".join(words)


def _in_one(path: str, recursive: bool, also: AbstractSet[str]) -> tuple[tuple[CameraInputs, ...], tuple[str, ...]]:
    """Return the cameras whose images are in one folder or pattern, or in the folders in it."""
    if is_table(path):
        return (CameraInputs("", tables=(path,)),), ()
    folders = _folders_in(path, also)
    if folders:
        return cameras_of([f"{_tidy(folder.name)}={folder}" for folder in folders], recursive, also)
    media = find_media([path], recursive, also)
    if not media.images:
        return cameras_of(list(map(str, media.videos)), recursive, also)
    groups = split_by_name(media.images)
    if groups is None:
        what = counted(len(media.images), "image")
        raise InvalidInput(f"the names of {what} do not tell which camera took them: {SYNTAX}", where=path)
    words = ", ".join(f"{name} ({group[0].name} … {group[-1].name})" for name, group in groups.items())
    cameras = tuple(CameraInputs(name, group) for name, group in groups.items())
    return cameras, (f"cameras by the names of the images: {words}",)


def _folders_in(path: str, also: AbstractSet[str]) -> list[Path]:
    """Return the folders of cameras in a folder that itself holds neither images nor videos."""
    folder = Path(path)
    if not folder.is_dir() or any(_has_media([each], also) for each in folder.iterdir() if each.is_file()):
        return []
    below = [each for each in sorted(folder.iterdir()) if each.is_dir() and not each.name.startswith(".")]
    found = [each for each in below if _has_media(each.iterdir(), also)]
    return found if len(found) > 1 else []


def _has_media(paths: Iterable[Path], also: AbstractSet[str]) -> bool:
    return any(path.suffix.lower() in IMAGE_SUFFIXES | also or is_video(path) for path in paths)


def split_by_name(paths: Sequence[Path]) -> dict[str, tuple[Path, ...]] | None:
    """Return images by the names of their cameras, None where their names do not tell them.

    Names of two cameras are alike but for one part: left and right, l and r, cam0 and cam1, a and b. A part that is
    known to name cameras is preferred, then folders, then words, then the fewest cameras.
    """
    names = [_TOKENS.findall(path.stem) for path in paths]
    longest = max(map(len, names), default=0)
    splits = [split for place in range(-longest, longest) if (split := _split(paths, names, place)) is not None]
    # names that differ in one part alone may be of one camera's images
    good = [own for own in splits if own.shared >= _LEAST_SHARED and (own.named or len(paths) >= 2 * len(own.groups))]
    best = min(
        good, key=lambda own: (not own.named, -round(own.shared, 1), _is_counted(own), len(own.groups)), default=None
    )
    if best is not None and best.named:
        return dict(best.groups)
    folders: dict[str, list[Path]] = defaultdict(list)
    for path in paths:
        folders[_tidy(path.parent.name)].append(path)
    if len(folders) > 1:
        return {name: tuple(group) for name, group in folders.items()} if all(map(NAME.match, folders)) else None
    return None if best is None else dict(best.groups)


def _is_counted(split: _Split) -> bool:
    """Return whether cameras would be told apart by a number that no word says is a camera's."""
    return all(re.fullmatch(r"cam\d+", name) for name in split.groups) and not split.named


def _split(paths: Sequence[Path], names: Sequence[Sequence[str]], place: int) -> _Split | None:
    """Return the images sorted by the part at a place of their names, None where that is no part of all."""
    if any(not -len(name) <= place < len(name) for name in names):
        return None
    values = [name[place].lower() for name in names]
    if not 1 < len(set(values)) <= _MOST_CAMERAS:
        return None
    positions = [place % len(name) for name in names]
    parts = zip(paths, names, positions, strict=True)
    rests = [(path.parent, *name[:at], "", *name[at + 1 :]) for path, name, at in parts]
    if len(set(zip(values, rests, strict=True))) < len(paths):
        return None
    counts = Counter(rests)
    before = {name[at - 1].lower() if at else "" for name, at in zip(names, positions, strict=True)}
    by_number = before <= _CAMERA_WORDS and all(value.isdigit() for value in values)
    groups: dict[str, list[Path]] = defaultdict(list)
    for path, value in sorted(zip(paths, values, strict=True), key=lambda pair: _rank(pair[1])):
        groups[_camera_name(value, set(values))].append(path)
    return _Split(
        {name: tuple(group) for name, group in groups.items()},
        sum(counts[rest] > 1 for rest in rests) / len(paths),
        by_number or set(values) <= _PLACES,
    )


def _rank(value: str) -> tuple[int, int, str]:
    """Return where a camera comes among the others: left and top first, numbers in their order."""
    first = ("left", "l", "top", "t", "upper", "front", "master")
    return (0 if value in first else 1, int(value) if value.isdigit() else 0, value)


def _camera_name(value: str, values: set[str]) -> str:
    if values <= set(_SIDES):
        return _SIDES[value]
    return f"cam{value}" if value.isdigit() else value


def varying(stems: Sequence[Sequence[str]]) -> Iterator[list[tuple[int | str, ...]]]:
    """Yield for every camera the parts of its names that are not the same in all names of each camera, numbers as such.

    Where all names have equally many parts, a part that varies for one camera is kept for all.
    """
    parts = [[_TOKENS.findall(stem) for stem in own] for own in stems]
    kept = [_differing(own) for own in parts]
    if len({len(part) for own in parts for part in own}) == 1:
        kept = [sorted(set().union(*kept))] * len(parts)
    for own, places in zip(parts, kept, strict=True):
        yield [tuple(_number_or_word(part[place]) for place in places if place < len(part)) for part in own]


def _differing(parts: Sequence[Sequence[str]]) -> list[int]:
    """Return the places at which parts of names differ, all of them where names have different numbers of parts."""
    lengths = {len(part) for part in parts}
    places = range(max(lengths, default=0))
    return [place for place in places if len(lengths) > 1 or len({part[place] for part in parts}) > 1]


def _number_or_word(part: str) -> int | str:
    return int(part) if part.isdigit() else part
