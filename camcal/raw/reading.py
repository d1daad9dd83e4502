"""Reading frames: raw ones of every kind as mosaics, and all kinds of images for detectors.

Raw frames are camera raw files, bare mosaics in image files, and header-less dumps of a sensor. Of camera raw files
LibRaw gives the sensor's own counts, never its look; how a frame was taken stands where its maker keeps that: as TIFF,
in a preview, or in boxes.

Detectors are given raw frames without demosaicing, as filling in colours mixes red, green and blue, which a lens does
not put in the same place. A corner is found where green was sampled, or in all samples alike, and measured by the
samples of one colour alone.
Source: Exif 2.32 (JEITA CP-3451E), section 4.6; L. Chevalier, "Describing the Canon Raw v3 (CR3) file format".
"""

import hashlib
import struct
from collections.abc import Mapping
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from camcal.arrays import Array
from camcal.dataclass import dataclass, field, replace
from camcal.errors import FileError, InvalidInput, Located
from camcal.files import read_bytes
from camcal.images import exif
from camcal.images.exif import JPEG, PNG, read_jpeg
from camcal.images.files import gray_8bit, gray_levels, load, png_has_colour
from camcal.images.image import RAW_SUFFIXES, Image
from camcal.images.options import require_pixels
from camcal.images.videos import address_of
from camcal.raw import COLOURS, GRAY, GREEN, MONO, PATTERNS
from camcal.raw.demosaic import demosaic
from camcal.raw.develop import balance_in_place, linearise
from camcal.raw.frame_facts import check_phase
from camcal.raw.headerless import read_headerless
from camcal.raw.mosaic import (
    Capture,
    Mosaic,
    by_place,
    cell_side,
    full_scale,
    is_x_trans,
    phases,
    require_pattern,
    sites,
)
from camcal.raw.options import (
    AS_IMAGES,
    BARE_SUFFIXES,
    HEADERLESS_SUFFIXES,
    NO_LAYOUT,
    Gains,
    GivenLayout,
    ImageReadOptions,
)
from camcal.targets.detection import MaskedImage


def read_mosaic(
    path: str | Path, pattern: str | None = None, layout: GivenLayout = NO_LAYOUT, content: bytes | None = None
) -> Mosaic:
    """Return the raw frame of a camera raw file, a bare mosaic (PNG, TIFF, PGM, NPY), or a header-less file.

    pattern: of a bare mosaic, and of a header-less file whose pixel format does not name it. layout: of a header-less
    file (.raw, .bin). A camera file brings its pattern, levels and white balance; the others have black 0 and the
    white of their type or pixel format. content: of the file, where it has been read already.
    Raises FileError if the file cannot be read, InvalidInput if it holds no mosaic, if the pattern or the layout is
    missing (with the layouts that fit the file), or if the pattern contradicts the file, or a layout is given for one
    that says its own.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    with Located(path):
        if address_of(path) is not None:
            from camcal.images.bag import mosaic  # here, since it needs an extra

            image, told = mosaic(path)
            if told and pattern not in (None, told):
                raise InvalidInput(f"pattern {told} in the message, {pattern} by --pattern; leave --pattern out")
            return _bare(path, told or pattern, image)
        if suffix in HEADERLESS_SUFFIXES:
            complete = layout.complete(path, pattern)
            values, colours = read_headerless(path, complete)
            return Mosaic(values, colours, np.zeros((2, 2)), complete.pixel_format.white)
        if layout != NO_LAYOUT:
            raise InvalidInput("has a header: --format, --size and others are for .raw and .bin files")
        if suffix in BARE_SUFFIXES:
            return _read_bare(path, pattern, content)
        frame = read_camera_raw(path, content)
        if pattern not in (None, frame.pattern):
            raise InvalidInput(f"pattern {frame.pattern} in the file, {pattern} by --pattern; leave --pattern out")
        return frame


def _read_bare(path: Path, pattern: str | None, content: bytes | None) -> Mosaic:
    if content is None and path.suffix.lower() == ".png":
        content = read_bytes(path)
    if content is not None and content.startswith(PNG) and png_has_colour(content):
        raise InvalidInput("a mosaic has one channel, this image has 3 or more: it is in colour already")
    return _bare(path, pattern, load(path, content=content))


def _bare(path: Path, pattern: str | None, image: Image) -> Mosaic:
    if pattern is None:
        raise missing_pattern(path)
    if image.channels != 1:
        raise InvalidInput(f"a mosaic has one channel, this image has {image.channels}: it is in colour already")
    values = image.pixels
    return Mosaic(values, pattern, np.zeros((2, 2)), full_scale(values.dtype), orientation=image.orientation)


def missing_pattern(path: Path) -> InvalidInput:
    """Return the error for a bare mosaic whose pattern was not given."""
    message = f"a bare mosaic has no colour pattern; give --pattern {'|'.join(PATTERNS)}"
    return InvalidInput(message, where=str(path))


_ORIENTATIONS = (1, 2, 4, 3, 5, 8, 6, 7)  # as EXIF counts them, by LibRaw's bits: mirror in x, in y, then transpose

# LibRaw's XYZ of linear sRGB's red, green and blue, white D65; its own inverse of a camera's matrix goes through it.
_XYZ_M_SRGB = np.array([[0.412453, 0.357580, 0.180423], [0.212671, 0.715160, 0.072169], [0.019334, 0.119193, 0.950227]])

_MASK_GUARD = 8  # columns beside the image that light may creep into
_MASK_WIDTH = 16  # columns, at least, for a median worth the name
_MASK_SPREAD = 0.01  # of the white level: samples without light differ by their noise only


def read_camera_raw(path: Path, content: bytes | None = None) -> Mosaic:
    """Return the raw frame of a camera raw file: counts, pattern, levels, white balance, colour, orientation, capture.

    Raises FileError if the file is missing, cut off or not one that LibRaw reads, InvalidInput if it holds no mosaic.
    """
    import rawpy

    content = read_bytes(path) if content is None else content
    if exif.is_cut_off(content):
        raise FileError(f"truncated: refers to data beyond its {len(content)} bytes", where=str(path))
    try:
        with rawpy.imread(BytesIO(content)) as raw:
            require_pixels((raw.sizes.raw_width, raw.sizes.raw_height), path)
            if raw.raw_type != rawpy.RawType.Flat:
                raise InvalidInput(
                    "has full colour in every pixel (linear DNG, sRAW or Foveon), no mosaic: it is demosaiced already; "
                    "export it from a raw converter as TIFF or PNG, which all other commands read"
                )
            return _frame(raw, content)
    except rawpy.LibRawError as error:
        text = error.args[0] if error.args else error
        reason = text.decode(errors="replace") if isinstance(text, bytes) else str(text)
        raise FileError(f"not a readable camera raw file ({reason})", where=str(path)) from error


def pattern_of(codes: Array | None, letters: bytes) -> str:
    """Return the pattern from a camera file's cell of colour indices and the letter of each index.

    Raises InvalidInput for other colours than R, G, B, for other cells than 2 × 2 and X-Trans, and for none at all.
    """
    if codes is None:
        raise InvalidInput("has no colour filter pattern")
    pattern = "".join(chr(letters[code]) for code in codes.ravel())
    if not set(pattern) <= set("RGB"):
        raise InvalidInput(f"has a filter pattern of {', '.join(sorted(set(pattern)))}; only red, green, blue are read")
    if codes.shape != (2, 2) and not is_x_trans(pattern):
        raise InvalidInput(f"has a pattern of {codes.shape[0]} × {codes.shape[1]}; only Bayer and X-Trans are read")
    return pattern if is_x_trans(pattern) else require_pattern(pattern)


def _frame(raw: Any, content: bytes) -> Mosaic:
    """Return the frame that LibRaw has read; levels are as the metadata state them, else as the frame itself tells."""
    codes = None if raw.num_colors == 1 else _cell(raw)
    pattern = MONO if codes is None else pattern_of(codes, raw.color_desc)
    side = cell_side(pattern)
    blacks = np.asarray(raw.black_level_per_channel, dtype=float)
    black = np.full((side, side), blacks[0]) if codes is None else blacks[codes]
    whites = [level for level in raw.camera_white_level_per_channel or () if level > blacks.max()]
    gains = np.asarray(raw.camera_whitebalance[:3], dtype=float)
    balanced = pattern != MONO and np.isfinite(gains).all() and (gains > 0).all()
    return Mosaic(
        values=raw.raw_image_visible,
        pattern=pattern,
        black=black if blacks.any() else _masked_black(raw, pattern),
        white=float(min(whites, default=raw.white_level)),
        camera_gains=gains if balanced else None,
        camera_M_xyz=None if pattern == MONO else _camera_matrix(raw),
        orientation=_ORIENTATIONS[raw.sizes.flip & 7],
        capture=capture_of(content, raw.other),
    )


def _cell(raw: Any) -> Array | None:
    """Return the colour indices of the first cell of the image; LibRaw's own cell of X-Trans begins at the margin."""
    try:
        cell = raw.raw_pattern
    except NotImplementedError as error:  # cells of other heights, which LibRaw can say and its binding cannot
        raise InvalidInput("has a filter pattern that is neither Bayer nor X-Trans") from error
    if cell is None:
        return None
    top, left = raw.sizes.top_margin, raw.sizes.left_margin
    codes = [raw.raw_color(top + row, left + column) for row, column in np.ndindex(*cell.shape)]
    return np.reshape(codes, cell.shape)


def _masked_black(raw: Any, pattern: str) -> Array:
    """Return the median counts of the columns left of the image if they are masked, for every place of the cell.

    They are masked if they differ by noise only and are as dark as the darkest of the image; else the answer is 0.
    """
    side = cell_side(pattern)
    sizes, image = raw.sizes, raw.raw_image_visible
    rows = slice(sizes.top_margin, sizes.top_margin + sizes.height)
    margin = raw.raw_image[rows, sizes.left_margin % side : max(0, sizes.left_margin - _MASK_GUARD)]
    if margin.shape[1] < _MASK_WIDTH:
        return np.zeros((side, side))
    low, middle, high = np.percentile(margin, [1, 50, 99])
    if high - low > _MASK_SPREAD * raw.white_level or middle > np.percentile(image, 1):
        return np.zeros((side, side))
    return np.reshape([np.median(margin[place]) for place in phases(pattern)], (side, side))


def _camera_matrix(raw: Any) -> Array | None:
    """Return the matrix from XYZ to the camera's colours, None if unknown.

    LibRaw gives that of a DNG file away only as its way to sRGB: inverted, with every row scaled to a sum of 1 over
    linear sRGB; the scales are its daylight balance.
    """
    stated = np.asarray(raw.rgb_xyz_matrix, dtype=float)[:3]
    if stated.any():
        return stated
    to_srgb = np.asarray(raw.color_matrix, dtype=float)[:, :3]
    scales = np.asarray(raw.daylight_whitebalance[:3], dtype=float)
    if not (scales > 0).all() or not abs(np.linalg.det(to_srgb)) > 0:
        return None
    return np.asarray(np.linalg.inv(_XYZ_M_SRGB @ to_srgb) / scales[:, np.newaxis])


_FUJI = b"FUJIFILMCCD-RAW"
_FUJI_PREVIEW = 84  # where the offset and the length of the preview stand, a JPEG file with an EXIF block
_CANON_BOXES = (b"CMT1", b"CMT2")  # the first directory, and the one about the capture
_CANON_SEARCH = 1 << 16


def capture_of(content: bytes, known: Any) -> Capture:
    """Return how a frame was taken by the EXIF tags of its camera file, where they are silent by what LibRaw knows.

    known: LibRaw's iso_speed, shutter_speed (s), aperture (f-number) and focal_length (mm).
    """
    facts: dict[str, Any] = {
        # 0, or 2 to the power of 0, is what LibRaw makes of no value
        "exposure_s": None if known.shutter_speed in (0, 1) else known.shutter_speed,
        "iso": known.iso_speed or None,
        "f_number": None if known.aperture in (0, 1) else known.aperture,
        "focal_mm": known.focal_length or None,
    }
    blocks = [content]
    if content.startswith(_FUJI):
        blocks = [_preview_exif(content)]
    elif content[4:8] == b"ftyp":
        blocks = [_box(content, name) for name in _CANON_BOXES]
    for block in blocks:
        facts |= exif.capture_facts(block)
    return Capture(**facts)


def _preview_exif(content: bytes) -> bytes:
    try:
        offset, length = struct.unpack_from(">II", content, _FUJI_PREVIEW)
    except struct.error:
        return b""
    preview = content[offset : offset + length]
    return read_jpeg(preview).exif if preview.startswith(JPEG) else b""


def _box(content: bytes, name: bytes) -> bytes:
    """Return what a box of a Canon CR3 file holds, nothing if it is not there; its length stands before its name."""
    place = content.find(name, 4, _CANON_SEARCH)
    if place < 0:
        return b""
    (length,) = struct.unpack_from(">I", content, place - 4)
    return content[place + 4 : place - 4 + length]


_CHANNELS = {"blue": 0, "green": 1, "red": 2}  # of colour images
_GRAY_LEVELS, _ROUNDING = 255.0, 1e-6
_BRIGHTEST = 0.999  # of the samples; what is above may be a lamp
_USED_CELLS = 1 << 17
_CLIPPED = 0.98


@dataclass(frozen=True, eq=False)
class DetectionImage:
    """What is examined: gray (H, W) uint8, in which a board is found; EXIF orientation, not applied.

    measured: the samples that say where its corners are, None for gray itself. colours: those of COLOURS, if asked for.
    sha256: of the file, if asked for and where the file was read as a whole.
    """

    gray: Array
    orientation: int
    measured: MaskedImage | None = None
    colours: Mapping[str, MaskedImage] = field(default_factory=dict)
    sha256: str | None = None

    @property
    def samples(self) -> MaskedImage:
        """The samples from which corners are located."""
        return self.measured or MaskedImage(self.gray)


def read_detection_image(path: Path, reading: ImageReadOptions = AS_IMAGES, *, hashed: bool = False) -> DetectionImage:
    """Return the detection image of an image, a camera raw file, a bare mosaic or a header-less file.

    hashed: with its hash. Raises FileError if it cannot be read, InvalidInput if it is no mosaic, or has not the
    colours asked for.
    """
    suffix = path.suffix.lower()
    content = None if suffix in HEADERLESS_SUFFIXES else read_bytes(path)  # those may be far longer than a frame
    with Located(path):
        if is_raw(path, reading):
            layout = reading.layout if suffix in HEADERLESS_SUFFIXES else NO_LAYOUT
            image = detection_image_of(read_mosaic(path, reading.pattern, layout, content), reading)
        else:
            image = _of_image(load(path, content=content), reading)
    return replace(image, sha256=hashlib.sha256(content).hexdigest()) if hashed and content is not None else image


def is_raw(path: Path, reading: ImageReadOptions) -> bool:
    """Return whether a file holds a raw frame; colours of other images have been mixed by demosaicing."""
    return path.suffix.lower() in RAW_SUFFIXES | HEADERLESS_SUFFIXES or reading.pattern is not None


def _of_image(image: Image, reading: ImageReadOptions) -> DetectionImage:
    if not reading.colours:
        deep = None if image.pixels.dtype == np.uint8 else MaskedImage(gray_levels(image.pixels))
        return DetectionImage(gray_8bit(image.pixels), image.orientation, deep)
    if image.channels == 1:
        raise InvalidInput("is gray and has no channels; if it is a raw frame, give its --pattern")
    planes = {colour: image.pixels[:, :, channel] for colour, channel in _CHANNELS.items()}
    colours = {colour: MaskedImage(gray_levels(planes[colour])) for colour in COLOURS}
    green = MaskedImage(gray_levels(planes[GREEN]))
    return DetectionImage(gray_8bit(planes[GREEN]), image.orientation, green, colours)


def detection_image_of(frame: Mosaic, reading: ImageReadOptions = AS_IMAGES) -> DetectionImage:
    """Return the detection image of a raw frame.

    Raises InvalidInput for X-Trans, a pattern that contradicts the frame, or colours that it has not.
    """
    if frame.pattern != MONO and frame.pattern not in PATTERNS:
        raise InvalidInput("has an X-Trans pattern; corners are found in Bayer mosaics. 'camcal demosaic' develops it")
    if frame.pattern == MONO:
        if reading.colours:
            raise InvalidInput("is of a sensor without colours and has no channels")
        return DetectionImage(gray_8bit(linearise(frame)), frame.orientation)
    check_phase(frame)
    light = linearise(frame)
    if reading.algorithm == GRAY:
        balance_in_place(light, frame.pattern, agreeing_gains(light, frame.pattern))
        return DetectionImage(gray_8bit(light), frame.orientation)
    gray = gray_8bit(demosaic(light, frame.pattern, GREEN))
    light *= np.float32(_GRAY_LEVELS / max(float(np.quantile(light[::4, ::3], _BRIGHTEST)), _ROUNDING))
    colours = {name: _samples(light, frame.pattern, name) for name in (COLOURS if reading.colours else ())}
    return DetectionImage(gray, frame.orientation, _samples(light, frame.pattern, GREEN), colours)


def _samples(light: Array, pattern: str, colour: str) -> MaskedImage:
    mask = np.zeros(light.shape, np.bool_)
    for site in sites(pattern, colour[0].upper()):
        mask[site] = True
    return MaskedImage(light, mask)


def agreeing_gains(light: Array, pattern: str) -> Gains:
    """Return gains of red, green, blue that make most of a mosaic (H, W) of linear light agree with its green.

    A board is black and white; what stands around it may have any colour and is outvoted: the gain of a colour c is the
    weighted median of g / c over the cells, which minimises Σ |g - gain · c|.
    """
    planes = by_place(light, pattern)
    stride = max(1, planes[0].size // _USED_CELLS)
    samples = [(letter, plane[::stride].ravel()) for letter, plane in zip(pattern, planes, strict=True)]
    cells = {colour: np.mean([plane for letter, plane in samples if letter == colour], axis=0) for colour in "RGB"}
    every = np.stack(list(cells.values()))
    usable = (every.max(axis=0) < _CLIPPED) & (every.min(axis=0) > 0)
    green = cells["G"][usable]
    red, blue = (_weighted_median(green / cells[colour][usable], cells[colour][usable]) for colour in "RB")
    return red, 1.0, blue


def _weighted_median(values: Array, weights: Array) -> float:
    """Return the value with half of the weight on either side, 1 for none."""
    if not values.size:
        return 1.0
    order = np.argsort(values)
    heaped = np.cumsum(weights[order], dtype=np.float64)
    return float(values[order][np.searchsorted(heaped, heaped[-1] / 2)])
