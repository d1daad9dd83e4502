"""The sidecar of a disparity map, a JSON file beside it: scale, invalid value, geometry, provenance.

`disparity.png` has `disparity.png.json`. Paths in it are relative to its folder.
"""

import json
import os
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from camcal import files
from camcal.arrays import FloatArray, readonly
from camcal.dataclass import dataclass, field
from camcal.errors import InvalidInput, Located
from camcal.formats.documents import Fault, child, parse_json
from camcal.formats.emit import rounded
from camcal.formats.schema import integer, items, mapping, matrix, number, one_of, text, unchecked
from camcal.stereo.depth_error import CalibrationError
from camcal.stereo.disparity import BESIDE, StereoGeometry
from camcal.stereo.rectify.record import AXES, PINHOLE, PROJECTIONS

SCHEMA = "camcal/disparity/1"
NAN = "nan"
INF = "inf"
ZERO = "0"
INVALID_CODES = (NAN, INF, ZERO)
SUFFIX = ".json"

_LIMIT = 1 << 20


@dataclass(frozen=True)
class SourceFile:
    """A file that a map was made of, and the SHA-256 of its bytes as 64 hex digits."""

    path: Path
    sha256: str


@dataclass(frozen=True, eq=False)
class Sidecar:
    """What is known of a disparity map.

    scale: counts of the file per pixel of disparity. invalid: what means "no match", one of INVALID_CODES. geometry:
    of the rectified pair. image: the rectified left image. sigma, confidence: images of the uncertainty (pixels) and
    of the class of every pixel, see `stereo.disparity`. searched: smallest and largest disparity searched for, pixels.
    matcher: its settings. inputs: the files it was made of, by their part. camera_R_rectified: (3, 3), from the
    rectified to the real left camera. relative_sigma: standard deviations of fx and baseline as shares of them.
    calibration: what the uncertainty of the whole calibration adds to that of the depth.
    """

    scale: float = 1.0
    invalid: str = NAN
    geometry: StereoGeometry | None = None
    image: Path | None = None
    sigma: Path | None = None
    confidence: Path | None = None
    searched: tuple[int, int] | None = None
    matcher: Mapping[str, object] = field(default_factory=dict)
    inputs: Mapping[str, SourceFile] = field(default_factory=dict)
    camera_R_rectified: FloatArray | None = None
    relative_sigma: Mapping[str, float] | None = None
    calibration: CalibrationError | None = None

    def __post_init__(self) -> None:
        if not 0 < self.scale < float("inf"):
            raise InvalidInput(f"the scale of a disparity map must be positive, found {self.scale:g}")
        if self.invalid not in INVALID_CODES:
            raise InvalidInput(f"the code of no match is one of {', '.join(INVALID_CODES)}, found {self.invalid!r}")
        if self.camera_R_rectified is not None:
            turn = readonly(self.camera_R_rectified, (3, 3), "camera_R_rectified")
            object.__setattr__(self, "camera_R_rectified", turn)


def path_beside(disparity: Path) -> Path:
    """Return where the sidecar of a disparity map stands."""
    return disparity.with_name(disparity.name + SUFFIX)


def write(disparity: Path, sidecar: Sidecar) -> None:
    """Write the sidecar of a disparity map beside it."""
    path = path_beside(disparity)
    files.write_text(path, json.dumps(_document(sidecar, path.parent), indent=1, ensure_ascii=False) + "\n")


def read(disparity: Path) -> Sidecar | None:
    """Return the sidecar of a disparity map, paths taken from its folder; None if there is none.

    Raises FileError if it is damaged, InvalidInput with a line for each fault of its content.
    """
    path = path_beside(disparity)
    if not path.exists():
        return None
    data = parse_json(files.read_text(path, _LIMIT), str(path))
    faults = list(_CHECK(data, "")) if isinstance(data, dict) else [Fault("", "not a JSON object")]
    if faults:
        lines = [f"{fault.path}: {fault.text}" if fault.path else fault.text for fault in faults]
        raise InvalidInput(f"\n{path}: ".join(lines), where=str(path))
    with Located(path):
        return _record(data, path.parent)


def _record(data: Mapping[str, Any], folder: Path) -> Sidecar:
    simple = ("scale", "invalid", "matcher", "relative_sigma")
    paths = {name: folder / data[name] for name in ("image", "sigma", "confidence") if name in data}
    turn = data.get("camera_R_rectified")
    return Sidecar(
        **{name: data[name] for name in simple if name in data},
        **paths,
        geometry=StereoGeometry(**data["geometry"]) if "geometry" in data else None,
        searched=(data["searched"][0], data["searched"][1]) if "searched" in data else None,
        inputs={
            part: SourceFile(folder / source["path"], source["sha256"])
            for part, source in data.get("inputs", {}).items()
        },
        camera_R_rectified=None if turn is None else readonly(turn, (3, 3), "camera_R_rectified"),
        calibration=CalibrationError(**data["calibration"]) if "calibration" in data else None,
    )


def _document(sidecar: Sidecar, folder: Path) -> dict[str, Any]:
    """Return the sidecar as plain data, without what is not known."""
    turn = sidecar.camera_R_rectified
    inputs = {
        part: {"path": _relative(source.path, folder), "sha256": source.sha256}
        for part, source in sidecar.inputs.items()
    }
    error = sidecar.calibration
    data = {
        "schema": SCHEMA,
        "scale": sidecar.scale,
        "invalid": sidecar.invalid,
        "geometry": geometry_document(sidecar.geometry) if sidecar.geometry else None,
        "image": _relative(sidecar.image, folder),
        "sigma": _relative(sidecar.sigma, folder),
        "confidence": _relative(sidecar.confidence, folder),
        "searched": list(sidecar.searched) if sidecar.searched else None,
        "matcher": dict(sidecar.matcher) or None,
        "inputs": inputs or None,
        "camera_R_rectified": None if turn is None else turn.tolist(),
        "relative_sigma": dict(sidecar.relative_sigma) if sidecar.relative_sigma else None,
        "calibration": error and {name: getattr(error, name).tolist() for name in ("columns", "rows", "variance")},
    }
    return {name: rounded(value) for name, value in data.items() if value is not None}


def geometry_document(geometry: StereoGeometry) -> dict[str, Any]:
    """Return a geometry as plain data; of a pinhole pair beside each other without projection and axis."""
    usual = {"projection": PINHOLE, "axis": BESIDE}
    return {name: value for name, value in asdict(geometry).items() if value != usual.get(name)}


def _relative(path: Path | None, folder: Path) -> str | None:
    return None if path is None else Path(os.path.relpath(path, folder)).as_posix()


_NODES = mapping({"columns": items(number()), "rows": items(number()), "variance": unchecked})


def _check_calibration(value: Any, path: str) -> Iterator[Fault]:
    """Check the nodes of a calibration's error, and that each power has a table of as many rows and columns."""
    faults = list(_NODES(value, path))
    yield from faults
    if not faults:
        table = matrix(len(value["rows"]), len(value["columns"]))
        yield from items(table, 3)(value["variance"], child(path, "variance"))


_POSITIVE = number(positive=True)
_CHECK = mapping(
    {"schema": one_of([SCHEMA], "schema"), "scale": _POSITIVE, "invalid": one_of(INVALID_CODES, "code")},
    {
        "geometry": mapping(
            {"fx": _POSITIVE, "fy": _POSITIVE, "cx": number(), "cy": number(), "baseline": _POSITIVE},
            {"doffs": number(), "projection": one_of(PROJECTIONS, "projection"), "axis": one_of(AXES, "axis")},
        ),
        "image": text,
        "sigma": text,
        "confidence": text,
        "searched": items(integer(), 2),
        "matcher": mapping({}, others=unchecked),
        "inputs": mapping({}, others=mapping({"path": text, "sha256": text})),
        "camera_R_rectified": matrix(3, 3),
        "relative_sigma": mapping({}, {"fx": number(0), "baseline": number(0)}),
        "calibration": _check_calibration,
    },
)
