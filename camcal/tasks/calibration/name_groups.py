"""Groups of images that their names suggest: those of a left and a right camera, of folders, of prefixes."""

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import PurePath

_LEAST = 3  # images of a group and outside of it
_MOST = 4  # values that tell cameras; what has more of them counts images
_TOKENS = re.compile(r"[^\W\d_]+|\d+")


def name_groups(images: Sequence[str]) -> tuple[frozenset[str], ...]:
    """Return groups of images, each of which may be another camera's than all the rest, by their paths.

    Images are alike in the letters and numbers of their names but for one that takes two to four values (left and
    right, cam0 and cam1, L and R), in their folder, or in the kind of their names (IMG_0001, scan-3-b).
    """
    groups: dict[frozenset[str], None] = {}
    for keys in _partitions(images):
        counts = Counter(keys)
        if not 1 < len(counts) <= _MOST:
            continue
        for value, count in counts.items():
            group = frozenset(image for image, key in zip(images, keys, strict=True) if key == value)
            rest = len(images) - count
            if min(count, rest) >= _LEAST and frozenset(images) - group not in groups:
                groups[group] = None
    return tuple(groups)


def _partitions(images: Sequence[str]) -> Iterator[list[str]]:
    """Yield what may tell cameras: a key of every image."""
    paths = [PurePath(image) for image in images]
    depth = max((len(path.parts) for path in paths), default=0)
    for level in range(2, depth + 1):  # the folder itself and those above it
        yield [path.parts[-level] if len(path.parts) >= level else "" for path in paths]
    tokens = [_TOKENS.findall(path.name.lower()) for path in paths]
    kinds = [" ".join("0" if token.isdigit() else token for token in name) for name in tokens]
    yield kinds
    longest = max(map(len, tokens), default=0)
    for place in range(longest):
        yield [name[place] if place < len(name) else "" for name in tokens]
