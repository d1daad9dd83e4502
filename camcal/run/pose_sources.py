"""Poses as they are named on a command line: numbers, files, transforms of files, with a name before them if need be.

    "1 0 0.5 0 0 1.5708"            numbers, in a form that is said beside them
    "Rz(90deg)"                     a turn about a coordinate axis; Rx, Ry, Rz, deg or rad
    base_T_cam="1 0 0.5 0 0 1.57"   and what they take where
    pose.txt, base_T_cam=pose.txt   a file of numbers; a remark '# base_T_cam' in it, or its own name, says the frames
    frames.yaml, rig.yaml           all transforms of a file
    frames.yaml#base_T_tag          one of them, or what a chain of them gives
    poses.yaml#image.png            the pose of one image

Camera files are read here too: every command warns of implausible values in one.
"""

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

from camcal import files
from camcal.errors import InsufficientData, InvalidInput, Located
from camcal.formats import frames, pose_text, split_address, trajectories
from camcal.formats.frames import LooseTransform
from camcal.formats.pose_text import Form, LoosePose, elementary, guessed, is_elementary, is_row, numbers_in
from camcal.geometry.frame_graph import FrameGraph
from camcal.geometry.pose import JOINT, NamedTransform, frames_of
from camcal.parsing import did_you_mean

Item = TypeVar("Item", NamedTransform, LooseTransform)

_NAMED = re.compile(r"([A-Za-z][A-Za-z0-9_]*_T_[A-Za-z0-9_]+)=(.*)", re.DOTALL)
_TABLES = {*frames.SUFFIXES, ".csv"}


def read_transforms(
    texts: Sequence[str], form: Form | None = None, *, allow_none: bool = False
) -> tuple[NamedTransform, ...]:
    """Return the transforms that arguments stand for, in their order; those without a name have empty frames.

    form: of numbers and of files of numbers; None where their count leaves no doubt. Arguments that are single numbers
    are one pose together. Raises InvalidInput and FileError, naming the argument, InsufficientData for a file without
    transforms unless that is allowed.
    """
    return tuple(
        item for text in _join(texts) for item in (_of(text, form) if allow_none else _some(_of(text, form), text))
    )


def read_one(text: str, form: Form | None = None) -> NamedTransform:
    """Return the one transform that an argument stands for; raises InvalidInput if it is several."""
    found = read_transforms([text], form)
    if len(found) != 1:
        names = ", ".join(dict.fromkeys(transform.name for transform in found))
        raise InvalidInput(f"holds {len(found)} transforms; choose one, as {text}#a_T_b: {names}", where=text)
    return found[0]


def read_loose(texts: Sequence[str], form: Form | None = None) -> tuple[LooseTransform, ...]:
    """Return transforms as they are written, which may be no rotations; otherwise as `read_transforms`."""
    return tuple(item for text in _join(texts) for item in _some(_loose(text, form), text))


def read_trajectories(texts: Sequence[str]) -> tuple[NamedTransform, ...]:
    """Return every pose of trajectory files, a_T_b=FILE where they do not say their frames; `where` has the time.

    Raises FileError and InvalidInput, naming the file.
    """
    return tuple(item for text in texts for item in _over_time(text))


def files_of(texts: Sequence[str]) -> list[Path]:
    """Return the files among arguments."""
    bodies = [split_name(text)[1] for text in _join(texts)]
    return [split_address(body)[0] for body in bodies if not _is_said(body)]


def _over_time(text: str) -> tuple[NamedTransform, ...]:
    name, body = split_name(text)
    found = trajectories.read(Path(body), name or None)
    target, source = frames_of(found.frames)
    covariances = [None] * len(found) if found.covariances is None else found.covariances
    return tuple(
        NamedTransform(target, source, found.pose(index), covariance, f"{body}#{stamp:.9g}")
        for index, (stamp, covariance) in enumerate(zip(found.stamps, covariances, strict=True))
    )


def _some(found: Sequence[Item], text: str) -> Sequence[Item]:
    """Return what an argument stands for; raises InsufficientData if that is nothing."""
    if not found:
        raise InsufficientData("holds no transforms", where=split_name(text)[1])
    return found


def _join(texts: Sequence[str]) -> list[str]:
    """Return arguments, or one of them all if each is a single number."""
    if len(texts) > 1 and all(len(text.split()) == 1 and is_row(text) for text in texts):
        return [" ".join(texts)]
    return list(texts)


def _is_said(text: str) -> bool:
    """Return whether an argument says a pose itself, not a file that does."""
    return is_elementary(text) or is_row(text)


def _parse_pose(text: str, form: Form | None) -> LoosePose:
    """Return the pose that an argument says itself."""
    with Located(repr(_tidy(text))):
        if is_elementary(text):
            return elementary(text)
        numbers = numbers_in(text)
        return (form or guessed(len(numbers))).parse(numbers)


def split_name(text: str) -> tuple[str, str]:
    """Return the name before an argument, empty without one, and the rest; raises InvalidInput if that is nothing."""
    match = _NAMED.match(text)
    name, body = (match[1], match[2]) if match else ("", text)
    if not body.strip():
        raise InvalidInput(f"{text!r} is not a pose: expected numbers, a file or FILE#NAME")
    return name, body


def _of(text: str, form: Form | None) -> tuple[NamedTransform, ...]:
    name, body = split_name(text)
    path, address = split_address(body)
    if _is_said(body) or files.suffix_of(path) not in _TABLES:
        return tuple(item.named() for item in _loose(text, form))
    found = frames.read(path)
    if address is not None:
        found = (_addressed(found, address, body),)
    if not name:
        return found
    if len(found) != 1:
        raise InvalidInput(f"{name} is one transform, the file has {len(found)}; choose one with #", where=body)
    target, source = frames_of(name)
    return (replace(found[0], target=target, source=source),)


def _loose(text: str, form: Form | None) -> tuple[LooseTransform, ...]:
    name, body = split_name(text)
    if _is_said(body):
        return (LooseTransform(name, _parse_pose(body, form), None, repr(_tidy(body))),)
    path, address = split_address(body)
    if files.suffix_of(path) not in _TABLES:
        if address is not None:
            raise InvalidInput(f"a file of numbers holds one pose, and none by the name {address!r}", where=body)
        return (LooseTransform(name or pose_text.name_in(path), pose_text.read_loose(path, form), None, str(path)),)
    found = frames.read_loose(path)
    if address is None:
        return found
    chosen = [item for item in found if address in {item.name, item.where.partition("#")[2]}]
    if not chosen:
        raise InvalidInput(
            f"no transform {address!r}{did_you_mean(address, [item.name for item in found])}", where=body
        )
    return tuple(chosen)


def _tidy(text: str) -> str:
    """Return numbers with one blank between them."""
    return " ".join(text.split())


def _addressed(found: Sequence[NamedTransform], address: str, where: str) -> NamedTransform:
    """Return the transform of a name or an image; one that is not there may follow from others."""
    chosen = [item for item in found if address in {item.name, item.where.partition("#")[2]}]
    if len(chosen) > 1:
        raise InvalidInput(f"{len(chosen)} transforms are named {address!r}", where=where)
    if chosen:
        return chosen[0]
    if JOINT not in address:
        known = [item.where.partition("#")[2] or item.name for item in found]
        raise InvalidInput(f"no pose named {address!r}{did_you_mean(address, known)}", where=where)
    with Located(where):
        graph = FrameGraph(found)
        target, source = frames_of(address)
        derived = graph.along(graph.path(target, source))
    return NamedTransform(target, source, derived.pose, derived.covariance_of(dict(enumerate(found))), where)
