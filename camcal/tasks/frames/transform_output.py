"""Where the results of `camcal transform` go, and in which form."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from camcal import files
from camcal.errors import InsufficientData, InvalidInput
from camcal.formats import frames, pose_text
from camcal.formats.pose_forms import Form, form_of
from camcal.geometry.named import NamedTransform
from camcal.run.outputs import refuse_overwriting
from camcal.run.pose_sources import files_of

_TEXTS = (".txt", ".tum", ".kitti")


@dataclass(frozen=True)
class Output:
    """Where transforms go, None for nowhere, and the form of their numbers in texts (None: matrix).

    trajectory: poses over time go there, under a suffix of theirs.
    """

    path: Path | None = None
    form: str | None = None
    trajectory: bool = False

    def __post_init__(self) -> None:
        form_of(self.form)  # which refuses what is none
        if (
            not self.trajectory
            and self.path is not None
            and self.path.suffix.lower() not in (*frames.SUFFIXES, *_TEXTS)
        ):
            known = ", ".join((*frames.SUFFIXES, *_TEXTS))
            raise InvalidInput(f"transforms are written as {known}", where=str(self.path))

    @property
    def numbers(self) -> Form | None:
        """The form of numbers that was asked for."""
        return form_of(self.form)

    def require_own(self, sources: Sequence[str]) -> None:
        """Raise InvalidInput if the output is one of the files that arguments name."""
        if self.path is not None:
            refuse_overwriting([self.path], files_of(sources))

    def write(self, transforms: Sequence[NamedTransform]) -> None:
        """Write transforms if they go anywhere.

        Raises InvalidInput for several in a text, or two of one name, InsufficientData for none.
        """
        if self.path is None:
            return
        if not transforms:
            raise InsufficientData("there are no transforms to write", where=str(self.path))
        if self.path.suffix.lower() in frames.SUFFIXES:
            frames.write(self.path, [_with_frames(transform) for transform in transforms], self.numbers)
            return
        if len(transforms) != 1:
            raise InvalidInput(f"{len(transforms)} transforms do not go into a text; use .yaml", where=str(self.path))
        files.write_text(self.path, pose_text.text_of(transforms[0], self.numbers or Form("matrix")))


def _with_frames(transform: NamedTransform) -> NamedTransform:
    """Return a transform with frames: a and b where it has none."""
    return transform if transform.name else replace(transform, target="a", source="b")
