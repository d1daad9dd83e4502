"""Images for detectors: ordinary images, and raw frames without demosaicing.

Filling in colours mixes red, green and blue, which a lens does not put in the same place. A corner is therefore found
where green was sampled, or in all samples alike, and measured by the samples of one colour alone.
"""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from camcal.arrays import Array
from camcal.errors import InvalidInput, Located
from camcal.files import read_bytes
from camcal.images.files import gray_8bit, gray_levels, load
from camcal.images.image import RAW_SUFFIXES, Image
from camcal.raw.demosaic import demosaic
from camcal.raw.develop import balance_in_place, linearise
from camcal.raw.frame_facts import check_phase
from camcal.raw.mosaic import Mosaic, by_place, sites
from camcal.raw.names import GRAY, GREEN, MONO, PATTERNS
from camcal.raw.options import AS_IMAGES, HEADERLESS_SUFFIXES, NO_LAYOUT, Gains, ImageReadOptions
from camcal.raw.reading import read_mosaic
from camcal.targets.detection import MaskedImage

COLOURS = ("red", "blue")

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
            found = detection_image_of(read_mosaic(path, reading.pattern, layout, content), reading)
        else:
            found = _of_image(load(path, content=content), reading)
    return replace(found, sha256=hashlib.sha256(content).hexdigest()) if hashed and content is not None else found


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
