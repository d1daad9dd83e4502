"""Tags on objects: markers of a family and the rigid objects they belong to.

Corners of a tag are in the order in which markers are found: clockwise from its top-left as printed (markers.Markers).
"""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np

from camcal.arrays import Array, FloatArray, readonly
from camcal.errors import InvalidInput
from camcal.targets.markers.families import Family, family_named

OPENCV, APRILTAG = "opencv", "apriltag"
TAG_FRAMES = (OPENCV, APRILTAG)

_CORNERS = {
    OPENCV: np.array([[-0.5, 0.5, 0.0], [0.5, 0.5, 0.0], [0.5, -0.5, 0.0], [-0.5, -0.5, 0.0]]),
    APRILTAG: np.array([[-0.5, -0.5, 0.0], [0.5, -0.5, 0.0], [0.5, 0.5, 0.0], [-0.5, 0.5, 0.0]]),
}
_SINGLE = re.compile(r"tag_\d+\Z")
_FLATTEST = 1e-3  # the least angle between sides (rad) that a tag can be read at
_BENT = 0.05  # of a side: corners farther out of their plane are no tag's


@dataclass(frozen=True, eq=False)
class TagObjects:
    """What the tags of a family stand for.

    bundles: by name, the corners (4, 3) of every tag on a rigid object in that object's frame (m), by id.
    size: side (m) of tags on no bundle, each an object of its own; None: those without a size of their own are ignored.
    sizes: of single tags that differ, by id. ids: single tags that count, None: all of the family.
    tag_frame: of single tags, see `tag_corners`. The family's name is settled to one of markers.FAMILIES.
    Raises InvalidInput if an id is not of the family or is given twice, or if corners are no tag's.
    """

    family: str
    size: float | None = None
    ids: tuple[int, ...] | None = None
    sizes: Mapping[int, float] = field(default_factory=dict)
    bundles: Mapping[str, Mapping[int, FloatArray]] = field(default_factory=dict)
    tag_frame: str = OPENCV

    def __post_init__(self) -> None:
        family = family_named(self.family)
        object.__setattr__(self, "family", family.name)
        if self.tag_frame not in TAG_FRAMES:
            raise InvalidInput(f"tag frame {self.tag_frame!r} is unknown; use {' or '.join(TAG_FRAMES)}")
        if self.size is None and not self.sizes and not self.bundles:
            raise InvalidInput("tags need a size, such as 53mm, or corners in a bundle")
        if self.ids is not None and self.size is None:
            raise InvalidInput("ids need the size of the tags")
        for size in (*([] if self.size is None else [self.size]), *self.sizes.values()):
            require_size(size)
        _require_ids(self, family)
        object.__setattr__(
            self,
            "bundles",
            {name: {tag: _tag(tag, corners) for tag, corners in tags.items()} for name, tags in self.bundles.items()},
        )

    def find(self, tag: int) -> tuple[str, FloatArray] | None:
        """Return the name of the object a tag is on and its corners (4, 3) in that object's frame, None if on none."""
        for name, tags in self.bundles.items():
            if tag in tags:
                return name, tags[tag]
        size = self.sizes.get(tag, self.size if self.ids is None or tag in self.ids else None)
        return None if size is None else (single_name(tag), tag_corners(size, self.tag_frame))


def tag_corners(size: float, tag_frame: str = OPENCV) -> Array:
    """Return the corners (4, 3) of a tag of side `size` in its own frame, whose origin is the tag's middle.

    opencv: x right, y up, z out of the tag, towards who looks at it; (-s, s) (s, s) (s, -s) (-s, -s) with s half the
    side, as cv2.SOLVEPNP_IPPE_SQUARE wants them. apriltag: x right, y down, z into the tag, as the AprilTag project has
    it; (-s, -s) (s, -s) (s, s) (-s, s).
    """
    return _CORNERS[tag_frame] * size


def single_name(tag: int) -> str:
    """Return the name of the object that is one tag."""
    return f"tag_{tag}"


def require_size(size: float) -> None:
    """Raise InvalidInput for a side that no tag has."""
    if not (np.isfinite(size) and size > 0):
        raise InvalidInput(f"the side of a tag must be positive, found {size:g}")


def require_id(tag: int, family: Family) -> None:
    """Raise InvalidInput for an id that the family does not have."""
    if not 0 <= tag < family.count:
        raise InvalidInput(f"id {tag} is not in {family.name}, whose ids are 0 to {family.count - 1}")


def require_quadrangle(corners: Array) -> None:
    """Raise InvalidInput unless corners (4, 3) go once around a plane, convex quadrangle."""
    sides = np.roll(corners, -1, axis=0) - corners
    lengths = np.linalg.norm(sides, axis=1)
    if not (np.isfinite(corners).all() and lengths.min() > 0):
        raise InvalidInput("two corners are the same" if np.isfinite(corners).all() else "a corner is not finite")
    turns = np.cross(sides, np.roll(sides, -1, axis=0)) / (lengths * np.roll(lengths, -1))[:, None]
    normal = np.cross(corners[2] - corners[0], corners[3] - corners[1])
    length = float(np.linalg.norm(normal))
    if length == 0 or (turns @ normal).min() < _FLATTEST * length:
        raise InvalidInput("the corners are not a convex quadrangle in order: clockwise from top-left")
    if abs((corners[1] - corners[0]) @ normal) / length > _BENT * lengths.max():
        raise InvalidInput("the corners are not in one plane")


def _tag(tag: int, corners: Array) -> Array:
    result = readonly(corners, (4, 3), f"corners of id {tag}")
    try:
        require_quadrangle(result)
    except InvalidInput as error:
        raise InvalidInput(f"id {tag}: {error.message}") from error
    return result


def _require_ids(tags: TagObjects, family: Family) -> None:
    owners: dict[int, str] = {}
    for name, tag in _placed(tags):
        require_id(tag, family)
        if tag in owners:
            raise InvalidInput(f"id {tag} is on {owners[tag]} and on {name}; each tag belongs to one object")
        owners[tag] = name
    for tag in tags.ids or ():
        require_id(tag, family)
    if len(set(tags.ids or ())) < len(tags.ids or ()):
        raise InvalidInput("an id is listed twice")
    for name, bundle in tags.bundles.items():
        if _SINGLE.match(name) or not bundle:
            raise InvalidInput(
                f"bundle {name!r} has no tag" if not bundle else f"{name!r} is the name of a single tag, not a bundle's"
            )


def _placed(tags: TagObjects) -> Iterator[tuple[str, int]]:
    yield from ((single_name(tag), tag) for tag in tags.sizes)
    yield from ((name, tag) for name, bundle in tags.bundles.items() for tag in bundle)
