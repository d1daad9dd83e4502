"""Records: what those of the library show of themselves, and how a record becomes a document.

A field is written under its own name and in SI units; its metadata, an `entry`, give it another name, unit or form, and
words for a table. Records in a document become documents, and arrays lists, where it is printed.
"""

from collections.abc import Mapping, Sequence
from dataclasses import MISSING, Field, fields, is_dataclass
from typing import TYPE_CHECKING, Any, NoReturn

from camcal.dataclass import dataclass

_ENTRY = "entry"


@dataclass(frozen=True)
class Entry:
    """How a field is written: its key ("" for its name), and the factor from SI units to those of the document, or
    factors of the values of a tuple.

    words, unit: what a table says of it. parts: keys of the values of a tuple. omitted: not at all. merged: its entries
    stand among those of the record.
    """

    key: str = ""
    factor: float | tuple[float, ...] = 1.0
    words: str = ""
    unit: str = ""
    parts: tuple[str, ...] = ()
    omitted: bool = False
    merged: bool = False

    def of(self, value: Any) -> Any:
        """Return a value as it is written; None, what is not known, stays."""
        if value is None:
            return None
        if isinstance(self.factor, tuple):
            value = [factor * part for factor, part in zip(self.factor, value, strict=True)]
        elif self.factor != 1.0:
            value *= self.factor
        return dict(zip(self.parts, value, strict=True)) if self.parts else value


def entry(
    key: str = "", factor: float | tuple[float, ...] = 1.0, words: str = "", unit: str = "", **form: Any
) -> Mapping[str, Entry]:
    """Return the metadata of a field, see `Entry`."""
    return {_ENTRY: Entry(key, factor, words, unit, **form)}


OMITTED, MERGED = entry(omitted=True), entry(merged=True)


def entries(record: Any) -> dict[str, Entry]:
    """Return how those fields of a record, or of its class, are written that say so, by their names, in their order."""
    return {field.name: field.metadata[_ENTRY] for field in fields(record) if _ENTRY in field.metadata}


def figures(record: Any) -> dict[str, Any]:
    """Return what the fields of a record that say how they are written write, by key."""
    return {how.key or name: how.of(getattr(record, name)) for name, how in entries(record).items()}


def document(record: Any) -> dict[str, Any]:
    """Return what all fields of a record write, by key."""
    written: dict[str, Any] = {}
    for field in fields(record):
        how, value = field.metadata.get(_ENTRY, _PLAIN), getattr(record, field.name)
        if how.merged:
            written |= document(value)
        elif not how.omitted:
            written[how.key or field.name] = how.of(value)
    return written


_PLAIN = Entry()


def is_record(value: Any) -> bool:
    """Return whether a value has a document."""
    return is_dataclass(value) and not isinstance(value, type)


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
    "uncertainty_at": "camera.projection_std(pixels), camcal.projection_covariances(camera, pixels)",
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
