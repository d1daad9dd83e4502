"""Whether two results of a calibration agree: figures within 1e-6 of their standard deviations."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from math import hypot, isfinite
from pathlib import Path
from typing import Any

import numpy as np

from camcal.formats import documents, native
from camcal.formats.camera_file import STEP, CameraEntry, CameraFile

EQUAL = 1e-6  # standard deviations
_FEW = 100.0  # degrees of freedom, where a file does not say them


@dataclass(frozen=True)
class Difference:
    """A figure that differs: its name, what it was and is, and the difference in standard deviations."""

    name: str
    before: str
    after: str
    sigmas: float = float("inf")

    @property
    def line(self) -> str:
        """The difference in words."""
        how = f" ({self.sigmas:.2g} standard deviations)" if isfinite(self.sigmas) else ""
        return f"{self.name}: {self.before} in the report, {self.after} now{how}"


def parsed(text: str, where: str) -> CameraFile:
    """Return the content of the text of a camera file, without the joint covariance of a rig, which may be elsewhere.

    Raises InvalidInput or FileError as for a file.
    """
    document = documents.parse(text, where, native.check)
    data = {key: value for key, value in document.data.items() if key != "joint_covariance"}
    return native.from_document(documents.Document(where, data, document.lines), Path())


def differences(before: CameraFile, after: CameraFile) -> list[Difference]:
    """Return the figures that differ by more than EQUAL standard deviations, and what else differs."""
    return [*_cameras(before, after), *_transforms(before, after)]


def _cameras(before: CameraFile, after: CameraFile) -> Iterator[Difference]:
    if list(before.cameras) != list(after.cameras):
        yield Difference("cameras", ", ".join(before.cameras), ", ".join(after.cameras))
        return
    for name, old in before.cameras.items():
        yield from _entry(name, old, after.cameras[name])


def _entry(name: str, old: CameraEntry, new: CameraEntry) -> Iterator[Difference]:
    one, other = old.camera, new.camera
    if one.model.name != other.model.name or one.image_size != other.image_size:
        yield Difference(f"{name}: lens model", _lens(old), _lens(new))
        return
    for parameter in one.model.parameter_names:
        std = one.std(parameter) or 0.0
        yield from _figure(f"{name}.{parameter}", one.value(parameter), other.value(parameter), std)
        yield from _figure(f"{name}.{parameter} std", std, other.std(parameter) or 0.0, std)
    dof = _FEW if old.noise is None else float(old.noise.degrees_of_freedom or _FEW)
    for key in dict.fromkeys([*old.quality, *new.quality]):
        was, now = old.quality.get(key, float("nan")), new.quality.get(key, float("nan"))
        yield from _figure(f"{name}.{key}", was, now, abs(was) / (2 * dof) ** 0.5 if key.endswith("_px") else 0.0)
    if _verdict(old) != _verdict(new):
        yield Difference(f"{name}: verdict", _verdict(old), _verdict(new))


def _lens(entry: CameraEntry) -> str:
    return f"{entry.camera.model.name} {'x'.join(map(str, entry.camera.image_size))}"


def _verdict(entry: CameraEntry) -> str:
    return "unknown" if entry.verdict is None else "trustworthy" if entry.verdict.trustworthy else "not trustworthy"


def _transforms(before: CameraFile, after: CameraFile) -> Iterator[Difference]:
    if set(before.transforms) != set(after.transforms):
        yield Difference("transforms", ", ".join(before.transforms), ", ".join(after.transforms))
        return
    for name, old in before.transforms.items():
        new = after.transforms[name]
        stds = np.zeros(6) if old.covariance is None else np.sqrt(np.diag(old.covariance))
        step = (new.pose @ old.pose.inverse()).vector()
        moved = [*(new.pose.translation - old.pose.translation), *step]
        for axis, value, std in zip(STEP, moved, stds.tolist(), strict=True):
            yield from _figure(f"{name}.{axis} change", 0.0, float(value), std)


def _figure(name: str, was: float, now: float, std: float) -> Iterator[Difference]:
    """Yield a figure if it differs: by more than EQUAL of its std, or of its last digits where it has none."""
    apart = abs(now - was)
    limit = EQUAL * std if std > 0 else EQUAL * EQUAL * max(abs(was), EQUAL)
    if not apart <= limit + 1e-11 * hypot(was, now):
        yield Difference(name, f"{was:.12g}", f"{now:.12g}", apart / std if std > 0 else float("inf"))


def refusal_difference(before: str, after: str) -> list[Difference]:
    """Return the difference of two reasons for which there is no calibration, none if they are the same."""
    return [] if before == after else [Difference("refusal", before or "none", after or "none")]


def recorded_environment(run: Mapping[str, Any]) -> dict[str, str]:
    """Return the versions and the machine that a page carries."""
    return {str(name): str(version) for name, version in run["environment"].items()}
