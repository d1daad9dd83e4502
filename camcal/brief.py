"""What the records of the library show of themselves, and what to use in the place of names that they do not have."""

from collections.abc import Mapping, Sequence
from dataclasses import MISSING, Field, fields, is_dataclass
from typing import TYPE_CHECKING, Any, NoReturn

_LONGEST, _LONGEST_VALUE, _FEW = 500, 80, 6

# Names that people look for, and what does the same.
ELSEWHERE = {
    "undistort_points": "camera.unproject(pixels).directions for rays, view.project(rays) for pixels of another view",
    "project_points": "camera.project(points).pixels",
    "save": "camcal.write_camera_file(path, camera)",
    "to_opencv": "camera.K and camera.dist, of cv2.fisheye for a fisheye lens",
    "distortion": "camera.dist",
    "poses": "calibration.views: each has its pose camera_T_board",
    "rms": "calibration.rms_px",
    "plot": "the option figures of the calibration: CalibrateOptions(figures=...), or camcal plot FILE",
    "write_report": "the option report of the calibration: CalibrateOptions(report='report.html')",
    "jacobian": "camera.project_with_jacobians(points)",
    "uncertainty_at": "camcal.projection_covariances(camera, pixels)",
}


class Brief:
    """A record whose repr is a line: fields that have not their default, arrays by their shapes."""

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        if "__repr__" not in cls.__dict__:
            cls.__repr__ = _describe  # type: ignore[method-assign] # dataclasses keep one of the class's own

    if not TYPE_CHECKING:  # to which every name would exist

        def __getattr__(self, name: str) -> NoReturn:
            raise missing(f"{type(self).__name__!r} object", name, dir(self))


def missing(owner: str, name: str, known: Sequence[str]) -> AttributeError:
    """Return the error of a name that an object or module does not have, with the right one if there is one."""
    from camcal.parsing import did_you_mean

    if name in ELSEWHERE:
        hint = f"; use {ELSEWHERE[name]}"
    elif name.startswith("_"):  # what Python itself looks for, often in vain
        hint = ""
    else:
        hint = did_you_mean(name, [each for each in known if not each.startswith("_")])
    return AttributeError(f"{owner} has no attribute {name!r}{hint}")


def _describe(record: Any) -> str:
    shown = [
        f"{own.name}={_value(getattr(record, own.name))}"
        for own in fields(record)
        if own.repr and not _usual(record, own)
    ]
    text = f"{type(record).__name__}({', '.join(shown)})"
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 2]}…)"


def _usual(record: Any, own: Field[Any]) -> bool:
    """Return whether a field has its default."""
    value = getattr(record, own.name)
    default = own.default_factory() if own.default_factory is not MISSING else own.default
    return value is default or (isinstance(value, (str, int, float, tuple, Mapping)) and bool(value == default))


def _value(value: Any) -> str:
    if hasattr(value, "dtype") and value.size > _FEW:  # an array: options have none, and do not wait for numpy
        return f"{value.dtype} {value.shape}"
    if isinstance(value, Mapping):
        text = "{" + ", ".join(map(str, value)) + "}"
    elif isinstance(value, Sequence) and not isinstance(value, str) and len(value) > _FEW:
        return f"<{len(value)} {type(value[0]).__name__}>"
    else:
        text = f"{value:.7g}" if isinstance(value, float) else repr(value)
    if len(text) <= _LONGEST_VALUE:
        return text
    return f"{type(value).__name__}(…)" if is_dataclass(value) else f"{text[: _LONGEST_VALUE - 1]}…"
