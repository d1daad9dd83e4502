"""Where the results of `camcal transform` go, and in which form."""

from collections.abc import Sequence
from dataclasses import replace

from camcal import files
from camcal.errors import InsufficientData, InvalidInput
from camcal.formats import frames, pose_text
from camcal.formats.pose_text import Form
from camcal.geometry.named import NamedTransform
from camcal.run.outputs import refuse_overwriting
from camcal.run.pose_sources import files_of
from camcal.tasks.frames.options import Output


def require_own(output: Output, sources: Sequence[str]) -> None:
    """Raise InvalidInput if the output is one of the files that arguments name."""
    if output.path is not None:
        refuse_overwriting([output.path], files_of(sources))


def write(output: Output, transforms: Sequence[NamedTransform]) -> None:
    """Write transforms if they go anywhere.

    Raises InvalidInput for several in a text, or two of one name, InsufficientData for none.
    """
    path = output.path
    if path is None:
        return
    if not transforms:
        raise InsufficientData("there are no transforms to write", where=str(path))
    if path.suffix.lower() in frames.SUFFIXES:
        frames.write(path, [_with_frames(transform) for transform in transforms], output.numbers)
        return
    if len(transforms) != 1:
        raise InvalidInput(f"{len(transforms)} transforms do not go into a text; use .yaml", where=str(path))
    files.write_text(path, pose_text.text_of(transforms[0], output.numbers or Form("matrix")))


def _with_frames(transform: NamedTransform) -> NamedTransform:
    """Return a transform with frames: a and b where it has none."""
    return transform if transform.name else replace(transform, target="a", source="b")
