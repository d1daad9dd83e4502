"""Disparity maps in files: images (8-bit, 16-bit with a scale, float TIFF, PFM, EXR) and NumPy arrays.

A sidecar beside a map says its scale and what means "no match" in it; see `disparity_sidecar`.
PFM files are gray, rows from the bottom up.
"""

import re
from pathlib import Path

import cv2
import numpy as np

from camcal.arrays import Array, Float32Array, readonly
from camcal.dataclass import dataclass
from camcal.errors import FileError, InvalidInput
from camcal.files import natural_key, read_bytes, replacing
from camcal.formats import disparity_sidecar
from camcal.formats.disparity_sidecar import INF, INVALID_CODES, NAN, ZERO, Sidecar
from camcal.formats.exr import read_exr, write_exr
from camcal.images import exif
from camcal.images.files import load, require_allowed, save
from camcal.images.image import arrays_of, read_npy, write_npy
from camcal.messages import Message

KITTI_SCALE = 256.0  # 16-bit disparity is in 1/256 px by the convention of the KITTI benchmark
OPENCV_SCALE = 16.0  # signed 16-bit disparity is what OpenCV's matchers give
_USUAL_SCALES = {"uint16": KITTI_SCALE, "int16": OPENCV_SCALE}  # of maps without a sidecar
SUFFIXES = (".pfm", ".tiff", ".tif", ".png", ".npy", ".npz", ".exr")

_ARRAY = "disparity"
_TIFF = (".tiff", ".tif")
_FULL = 65535
_PFM_HEADER = re.compile(rb"Pf\s+(\d{1,9})\s+(\d{1,9})\s+([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s")


@dataclass(frozen=True, eq=False)
class DisparityMap:
    """Disparity (H, W), float32 pixels, left minus right, and the counts per pixel by which the file was divided.

    What means "no match" is left in `values` as the file has it. invalid: "nan" or "inf": what is not finite; "0": that
    and what is zero or negative. sidecar: what stands beside the file, None if nothing does.
    """

    values: Float32Array
    scale: float
    invalid: str = ZERO
    sidecar: Sidecar | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "values", readonly(self.values, (None, None), "disparity", np.float32))

    def matched(self) -> Float32Array:
        """Return the disparity (H, W), float32 pixels, NaN wherever there is no match."""
        known = np.isfinite(self.values)
        if self.invalid == ZERO:
            known &= self.values > 0
        return np.where(known, self.values, np.float32(np.nan))

    @property
    def signed(self) -> bool:
        """Whether zero and less are matches: they were searched for, and do not mean that there is none."""
        searched = self.sidecar.searched if self.sidecar else None
        return self.invalid != ZERO and searched is not None and searched[0] < 0


@dataclass(frozen=True)
class Written:
    """How a map was written: counts per pixel, what means "no match", and warnings."""

    scale: float
    invalid: str
    warnings: tuple[Message, ...] = ()


def read(path: str | Path, scale: float | None = None, invalid: str | None = None) -> DisparityMap:
    """Return the disparity map of a file.

    scale, invalid: as in `DisparityMap`; without them what the sidecar says, and without one 256 for unsigned and 16
    for signed 16-bit numbers, 1 for all others, and "0".
    Raises FileError if the file cannot be read, InvalidInput if it is in colour, holds several arrays, the scale is not
    positive or the code is unknown.
    """
    path = Path(path)
    values = _gray(_read_values(path), path)
    sidecar = disparity_sidecar.read(path)
    if scale is None:
        scale = sidecar.scale if sidecar else _USUAL_SCALES.get(values.dtype.name, 1.0)
    if invalid is None:
        invalid = sidecar.invalid if sidecar else ZERO
    if invalid not in INVALID_CODES:
        raise InvalidInput(f"the code of no match is one of {', '.join(INVALID_CODES)}, found {invalid!r}")
    with np.errstate(over="ignore", invalid="ignore"):  # infinite is no match
        found = values.astype(np.float32) / np.float32(_positive(scale))
    return DisparityMap(found, scale, invalid, sidecar)


def maps_in(folder: Path) -> list[Path]:
    """Return the disparity maps in a folder, in natural order: those with a sidecar, or all images if none has one.

    Raises FileError if there is none.
    """
    images = [path for path in folder.iterdir() if path.suffix.lower() in SUFFIXES and path.name[0] != "."]
    maps = [path for path in images if disparity_sidecar.path_beside(path).is_file()] or images
    if not maps:
        raise FileError(f"contains no disparity map ({', '.join(SUFFIXES)})", where=str(folder))
    return sorted(maps, key=lambda path: natural_key(path.name))


def write(path: str | Path, values: Array, *, scale: float | None = None) -> Written:
    """Write a disparity map (H, W), pixels, in the form that the suffix names; return how.

    values: what is not finite means "no match". PFM, TIFF, EXR and NumPy files hold them as float32. A PNG holds
    counts, by default KITTI's 256 per pixel and a smaller power of two where those do not reach; a match is never coded
    0. scale: of a PNG.
    Raises InvalidInput if the type of file is unknown or cannot hold the values, FileError if it cannot be written.
    """
    path = Path(path)
    require_suffix(path)
    suffix = path.suffix.lower()
    if suffix == ".png":
        return _write_png(path, values, scale)
    if scale not in (None, 1.0):
        raise InvalidInput(f"{suffix} is not scaled; a scale of {scale:g} is for .png", where=str(path))
    code = INF if suffix == ".pfm" else NAN
    plain = np.where(np.isfinite(values), values, float(code)).astype(np.float32)
    if suffix == ".npz":
        with replacing(path) as temporary:
            np.savez(temporary, allow_pickle=False, **{_ARRAY: plain})
    else:
        {".pfm": write_pfm, ".npy": write_npy, ".exr": write_exr}.get(suffix, save)(path, plain)
    return Written(1.0, code)


def require_suffix(path: Path) -> None:
    """Raise InvalidInput unless disparity maps are written as this type of file."""
    if path.suffix.lower() not in SUFFIXES:
        found = path.suffix or "no suffix"
        raise InvalidInput(f"disparity maps are {', '.join(SUFFIXES)}, found {found}", where=str(path))


def _write_png(path: Path, values: Array, scale: float | None) -> Written:
    known = np.isfinite(values)
    smallest, largest = (float(values[known].min()), float(values[known].max())) if known.any() else (0.0, 0.0)
    if smallest < 0:
        raise InvalidInput(f"a PNG cannot store {smallest:.2f} px; write .tiff or .pfm", where=str(path))
    chosen = _fitting_scale(largest) if scale is None else _positive(scale)
    if round(largest * chosen) > _FULL:
        raise InvalidInput(
            f"a PNG of {chosen:g} counts per pixel cannot store {largest:.2f} px; write .tiff or .pfm", where=str(path)
        )
    counts = np.maximum(np.rint(np.where(known, values, 0) * chosen), 1)  # 0 would say that there is no match
    save(path, np.where(known, counts, 0).astype(np.uint16))
    if scale is not None or chosen == KITTI_SCALE:
        return Written(chosen, ZERO)
    text = f"{largest:.2f} px exceed 16 bits at 256 counts per pixel: written at {chosen:g}"
    figures = {"largest_px": largest, "scale": chosen}
    return Written(chosen, ZERO, (Message("reduced_disparity_scale", text, figures, str(path)),))


def _fitting_scale(largest: float) -> float:
    scale = KITTI_SCALE
    while scale > 1 and round(largest * scale) > _FULL:
        scale /= 2
    return scale


def _positive(scale: float) -> float:
    if not (np.isfinite(scale) and scale > 0):
        raise InvalidInput(f"the scale of a disparity map must be positive, found {scale:g}")
    return scale


def _gray(values: Array, path: Path) -> Array:
    """Return (H, W) of what is gray, also where a file repeats it as red, green and blue."""
    if values.ndim == 3 and values.shape[2] == 3 and not np.ptp(values, axis=2).any():
        values = values[:, :, 0]
    if values.ndim != 2 or values.size == 0:
        raise InvalidInput(f"a disparity map has rows and columns, found shape {values.shape}", where=str(path))
    return values


def _read_values(path: Path) -> Array:
    suffix = path.suffix.lower()
    if suffix in _TIFF:
        return _read_tiff(path)
    readers = {".npy": read_npy, ".npz": _read_npz, ".pfm": read_pfm, ".exr": read_exr}
    return readers[suffix](path) if suffix in readers else load(path).pixels


def _read_tiff(path: Path) -> Array:
    """Return the values of a TIFF file, which unlike an image may have a sign."""
    content = read_bytes(path)
    require_allowed(path, content)
    if exif.orientation(content) != exif.UPRIGHT:
        content = exif.with_orientation(content, exif.UPRIGHT)  # OpenCV turns TIFF images whatever it is asked
    try:
        values = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED | cv2.IMREAD_IGNORE_ORIENTATION)
    except cv2.error:
        values = None
    if values is None:
        raise FileError("not a readable TIFF file", where=str(path))
    return np.asarray(values)


def _read_npz(path: Path) -> Array:
    """Return the one array of a NumPy archive, or the one named disparity."""
    try:
        arrays = arrays_of(read_bytes(path))
    except ValueError as error:
        raise FileError("not a readable NumPy archive", where=str(path)) from error
    names = list(arrays)
    values = arrays.get(names[0] if len(names) == 1 else _ARRAY)
    if values is None:
        held = f"holds the arrays {', '.join(names[:8])}" if names else "holds no array"
        raise InvalidInput(f"{held}; one is needed, or one named {_ARRAY}", where=str(path))
    if values.dtype.kind not in "uif":
        raise FileError("contains no numeric array", where=str(path))
    return np.asarray(values)


def read_pfm(path: Path) -> Array:
    """Return the values (H, W), float32, of a gray PFM file, from the top down.

    The size of the number that tells the byte order by its sign is left alone: Middlebury writes 1/255 there without
    meaning it, and OpenCV, which divides by it, reads disparities 255 times too large.
    Raises FileError if the file is missing, in colour, cut off or no PFM.
    """
    content = read_bytes(path)
    header = _PFM_HEADER.match(content)
    if header is None:
        raise FileError("not a gray PFM file (its header is Pf, width, height, byte order)", where=str(path))
    width, height = int(header[1]), int(header[2])
    order = "<f4" if float(header[3]) < 0 else ">f4"
    if len(content) - header.end() != 4 * width * height:
        found = len(content) - header.end()
        raise FileError(f"{width} × {height} pixels take {4 * width * height} bytes, found {found}", where=str(path))
    values = np.frombuffer(content, order, offset=header.end()).reshape(height, width)
    return values[::-1].astype(np.float32)


def write_pfm(path: Path, values: Array) -> None:
    """Write values (H, W) as float32, the lowest byte first, in one step."""
    height, width = values.shape
    with replacing(path) as temporary, temporary.open("wb") as stream:
        stream.write(b"Pf\n%d %d\n-1.0\n" % (width, height))
        stream.write(values[::-1].astype("<f4").data)
