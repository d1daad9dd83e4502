"""lensfun's XML databases: lenses with their distortion and lateral colour at some focal lengths, without pixels.

A camera is a lens at a focal length (mm) in images of a size: FILE#LENS@FOCAL. Between the focal lengths of the file it
is interpolated as lensfun does. The images are of a sensor with the crop factor of the lens's calibration;
FILE#LENS@FOCAL,CROP are those of another one. r = 1 is half the shorter side of the sensor of the calibration. Focal
lengths of ptlens and poly3 are those of the plane before the distortion, real ones those in the image's middle.
Source: lensfun, libs/lensfun: modifier.cpp (coordinate systems), lens.cpp (interpolation), mod-coord, mod-subpix.cpp.
"""

import math
import re
from bisect import bisect
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree as ET

import numpy as np

from camcal import files
from camcal.arrays import Array
from camcal.cameras.catalogue import MODELS
from camcal.cameras.model import Camera
from camcal.errors import InvalidInput
from camcal.formats.camera_file import CameraEntry, CameraFile
from camcal.formats.cameras.record import CameraFormat, Given, MissingSize, Source
from camcal.formats.cameras.syntax import xml_root, xml_values
from camcal.formats.cameras.values import Lenses, Values

LENSES = Lenses("""
    rectilinear opencv4 f cx cy k1 k2
    rectilinear ptlens f cx cy a2 a3 a4
    fisheye kannala_brandt4 f cx cy k1 k2
    fisheye ftheta f cx cy a2 a3 a4
    equisolid ptlens_equisolid f cx cy a2 a3 a4
    stereographic ptlens_stereographic f cx cy a2 a3 a4
""")  # fmt: skip

_DIAGONAL_MM = math.hypot(36.0, 24.0)
_TERMS: dict[str, dict[str, tuple[str, ...]]] = {
    "distortion": {"poly3": ("k1",), "poly5": ("k1", "k2"), "ptlens": ("c", "b", "a")},
    "tca": {"linear": ("kr", "kb"), "poly3": ("vr", "vb", "cr", "cb", "br", "bb")},
    "real-focal-length": {"": ("real-focal",)},
}
_ONE = ("kr", "kb", "vr", "vb")  # terms that are 1 where they are not given
_POWERS = {"poly3": [2], "poly5": [2, 4], "ptlens": [1, 2, 3]}  # of r, beyond the first
_PARAMETERS = {"k1": 2, "k2": 4, "a2": 1, "a3": 2, "a4": 3, "a5": 4, "k3": 6}  # camcal's, likewise
_LISTED = 5  # lenses that a message names
_SAMPLES = 200  # radii at which a colour is fitted
_ADDRESS = re.compile(r"(.*?)(?:@([0-9.]+) ?(?:mm)?(?:,([0-9.]+))?)?")
Rows = dict[float, Array]  # terms by focal length, mm


class _Lens(NamedTuple):
    """A lens, what its distortion is, and its terms by focal length (mm); centre: halves of the shorter side (2,)."""

    values: Values
    title: str
    crop: float
    aspect: float
    centre: Array
    model: str
    distortion: Rows
    tca: Rows
    real_focal: Rows

    @property
    def unit_mm(self) -> float:
        """Half the shorter side of the sensor of the calibration."""
        return _DIAGONAL_MM / 2 / self.crop / math.hypot(self.aspect, 1.0)

    def entry(self, focal: float, crop: float, size: tuple[int, int]) -> CameraEntry:
        """Return the lens at a focal length (mm) before a sensor of a crop factor, with those of red and blue."""
        reach = math.hypot(size[0] - 1, size[1] - 1) / 2  # px, as lensfun measures sides
        unit = reach * crop / self.crop / math.hypot(self.aspect, 1.0)
        radial = np.zeros(7)  # of r, r², r³ and so on
        radial[_POWERS[self.model]] = _interpolate(self.distortion, focal, 0)
        radial[0] = 1.0 if self.model == "poly5" else 1.0 - radial.sum()
        kind, ideal = self.values.text("type") or "rectilinear", focal
        if self.real_focal:
            ideal = float(_interpolate(self.real_focal, focal, 1)[0]) / radial[0]
        radial *= (ideal / self.unit_mm) ** np.arange(1, 8)  # now of the radius before the distortion, in focal lengths
        if not radial[0] > 0:
            raise self.values.wrong("", f"{self.title}: the distortion at {focal:.4g} mm turns the image over")
        rows = LENSES.of(self.values, "type", kind)
        model = next((row.model for row in rows if set(np.flatnonzero(radial)) <= {0, *_powers_of(row.model)}), None)
        if model is None:
            raise self.values.wrong("type", f"{self.title}: {self.model} of a lens that is {kind} is not read")
        middle = (np.array(size) - 1 + self.centre * (min(size) - 1)) / 2
        colours: list[Array] = []
        if self.tca:
            terms = _interpolate(self.tca, focal, 2).reshape(-1, 2).T
            model = "opencv5" if model == "opencv4" and terms[:, 1:].any() else model  # a power more is nearer to it
            colours = [_colour_terms(model, radial, own, reach / unit) for own in terms]
        channels = {name: _camera(model, own, unit, middle, size) for name, own in zip(("red", "blue"), colours)}  # noqa: B905 - or none
        return CameraEntry(_camera(model, radial, unit, middle, size), channels=channels)


def _powers_of(model: str) -> list[int]:
    """Return the powers of the radius, beyond the first, that a lens model has terms of."""
    return [_PARAMETERS[name] for name in MODELS[model].parameter_names[4:] if name in _PARAMETERS]


def _camera(model: str, radial: Array, unit: float, middle: Array, size: tuple[int, int]) -> Camera:
    names = MODELS[model].parameter_names[4:]
    terms = [radial[_PARAMETERS[name]] / radial[0] if name in _PARAMETERS else 0.0 for name in names]
    return Camera(MODELS[model], size, np.array([radial[0] * unit, radial[0] * unit, *middle, *terms]))


def _colour_terms(model: str, radial: Array, terms: Array, corner: float) -> Array:
    """Return the terms (7,) of the radius of a colour, r (v + c r + b r²) of that of green, up to the corner's r.

    Exact where c and b are 0, else the nearest of the same lens model.
    """
    if not terms[1:].any():
        return np.asarray(radial * terms[0])
    ideal = np.linspace(0.0, 1.5 * corner / radial[0], _SAMPLES)[1:]
    green = np.polynomial.polynomial.polyval(ideal, [0.0, *radial])
    rising = np.cumprod(np.diff(green, prepend=0.0) > 0).astype(bool) & (green <= corner)
    ideal, green = ideal[rising], green[rising]
    powers = [0, *_powers_of(model)]
    basis = ideal[:, None] ** (np.array(powers) + 1)
    result = np.zeros(7)
    result[powers] = np.linalg.lstsq(basis, np.polynomial.polynomial.polyval(green, [0.0, *terms]), rcond=None)[0]
    return result


def _interpolate(rows: Rows, focal: float, plain: int) -> Array:
    """Return the terms at a focal length, by a cubic through the values on both sides with their mean slopes.

    plain: how many of the terms are interpolated themselves; the others times the focal length.
    """
    focals = sorted(rows)
    place = bisect(focals, focal)
    if focal in rows or not 0 < place < len(focals):
        return rows[focal] if focal in rows else rows[focals[min(place, len(focals) - 1)]]

    def scale(length: float) -> Array:
        return np.where(np.arange(len(rows[focals[0]])) < plain, 1.0, length)

    y2, y3 = (rows[each] * scale(each) for each in focals[place - 1 : place + 1])
    y1, y4 = (
        rows[focals[each]] * scale(focals[each]) if 0 <= each < len(focals) else None for each in (place - 2, place + 1)
    )
    t = (focal - focals[place - 1]) / (focals[place] - focals[place - 1])
    slope_2 = y3 - y2 if y1 is None else (y3 - y1) / 2
    slope_3 = y3 - y2 if y4 is None else (y4 - y2) / 2
    value = (2 * t**3 - 3 * t**2 + 1) * y2 + (t**3 - 2 * t**2 + t) * slope_2
    return np.asarray((value + (3 * t**2 - 2 * t**3) * y3 + (t**3 - t**2) * slope_3) / scale(focal))


class _Cameras(Mapping[str, CameraEntry]):
    """The lenses of a file at their focal lengths, and, by LENS@FOCAL,CROP, at any between these."""

    def __init__(self, lenses: Sequence[_Lens], size: tuple[int, int], where: str) -> None:
        self.lenses, self.size, self.where = lenses, size, where
        self.places: dict[str, tuple[_Lens, float, float]] = {}
        for lens in lenses:
            for focal in lens.distortion:
                name = re.sub(r"[^A-Za-z0-9]+", "_", f"{lens.title} {focal:g}mm").strip("_").replace("_T_", "_t_")
                name = name if name[0].isalpha() else f"lens_{name}"
                name = name if name not in self.places else f"{name}_{len(self.places)}"
                self.places[name] = lens, focal, lens.crop

    def __getitem__(self, name: str) -> CameraEntry:
        """Return a camera by its name or as LENS@FOCAL,CROP; raises InvalidInput if it is not clear which."""
        lens, focal, crop = self.places.get(name) or self._choose(name)
        return lens.entry(focal, crop, self.size)

    def __contains__(self, name: object) -> bool:
        return isinstance(name, str)  # what is wrong with it says __getitem__

    def __iter__(self) -> Iterator[str]:
        return iter(self.places)

    def __len__(self) -> int:
        return len(self.places)

    def _choose(self, address: str) -> tuple[_Lens, float, float]:
        title, *numbers = _ADDRESS.fullmatch(address).groups()  # type: ignore[union-attr] # it matches any text
        words = re.findall(r"[a-z0-9.]+", title.lower())
        found = [lens for lens in self.lenses if lens.title.lower() == title.strip().lower()]
        found = found or [lens for lens in self.lenses if all(word in lens.title.lower() for word in words)]
        titles = list(dict.fromkeys(lens.title for lens in found))
        if len(titles) != 1:
            what = f"{len(titles)} lenses are {title!r}" if titles else f"no lens with distortion is {title!r}"
            raise InvalidInput(
                f"{what}: choose one, LENS@FOCAL, of {_list_names(titles or self.lenses)}", where=self.where
            )
        crop = float(numbers[1]) if numbers[1] else found[0].crop
        lens = max(found, key=lambda each: (each.crop <= 1.01 * crop, each.crop))
        focals = sorted(lens.distortion)
        focal = float(numbers[0]) if numbers[0] else focals[0] if len(focals) == 1 else 0.0
        if not focals[0] <= focal <= focals[-1]:
            known = f"{focals[0]:g} mm" if len(focals) == 1 else f"{focals[0]:g} to {focals[-1]:g} mm"
            raise InvalidInput(f"{lens.title} is calibrated at {known}: give {title}@FOCAL", where=self.where)
        return lens, focal, crop


def _list_names(lenses: Sequence[_Lens] | Sequence[str]) -> str:
    """Return the first titles of lenses, and how many more there are."""
    titles = list(dict.fromkeys(each if isinstance(each, str) else each.title for each in lenses))
    more = f" and {len(titles) - _LISTED} more" if len(titles) > _LISTED else ""
    return ", ".join(titles[:_LISTED]) + more


def read(sources: Sequence[Source], given: Given) -> CameraFile:
    """Return the cameras of every lens that has distortion; raises InvalidInput, MissingSize, FileError."""
    source = sources[0]
    # a document type that is declared elsewhere, as the files of lensfun have it, declares no entities here
    plain = re.sub(r"<!DOCTYPE\s+lensdatabase\b[^\[>]*>", "", source.text, count=1)
    root = xml_root(source._replace(text=plain))
    lenses = [lens for element in root.iter("lens") for lens in _lenses(source, element)]
    if not lenses:
        raise InvalidInput("holds no lens with distortion: nothing to undistort", where=str(source.path))
    if given.image_size is None:
        what = f"{len(lenses)} lenses for images of any size ({_list_names(lenses)})"
        raise MissingSize(f"{what}: give FILE#LENS@FOCAL and --size WxH", where=str(source.path))
    return CameraFile(_Cameras(lenses, given.image_size, str(source.path)))


def _lenses(source: Source, element: ET.Element) -> Iterator[_Lens]:
    """Yield a lens for each of its calibrations that has distortion."""
    values = xml_values(source, element)
    maker, model = (" ".join((element.findtext(tag) or "").split()) for tag in ("maker", "model"))
    title = model if model.lower().startswith(maker.lower()) else f"{maker} {model}"
    centre = np.zeros(2)
    for at in (xml_values(source, each) for each in element.findall("center")):
        centre = np.array([at.number("@x"), at.number("@y")])
    for calibration in element.findall("calibration"):
        own = xml_values(source, calibration)
        model, distortion = _rows(source, calibration, "distortion")
        if not distortion:
            continue
        crop, aspect = (
            _ratio(own, f"@{key}") if f"@{key}" in own else _ratio(values, key) if key in values else usual
            for key, usual in (("cropfactor", 1.0), ("aspect-ratio", 1.5))
        )
        real = _rows(source, calibration, "real-focal-length")[1]
        for each in calibration.findall("distortion"):
            own = xml_values(source, each)
            real |= {own.number("@focal"): own.numbers("@real-focal")} if "@real-focal" in own else {}
        yield _Lens(values, title, crop, aspect, centre, model, distortion, _rows(source, calibration, "tca")[1], real)


def _ratio(values: Values, key: str) -> float:
    """Return a positive number, or one that is written as W:H."""
    parts = values.text(key).split(":")
    numbers = Values(values.document, values.path, {key: parts}).numbers(key, 1, 2)
    if not (numbers > 0).all():
        raise values.wrong(key, f"{values.text(key)} is not positive")
    return float(numbers[0] / (numbers[1] if len(numbers) == 2 else 1.0))


def _rows(source: Source, calibration: ET.Element, tag: str) -> tuple[str, Rows]:
    """Return the model of the elements of a name and their terms; as in lensfun, others of another model are left out.

    Raises InvalidInput for a model that is not known.
    """
    word, rows = "", Rows()
    for element in calibration.findall(tag):
        values = xml_values(source, element)
        own = values.text("@model")
        if own == "none" or (rows and own != word):
            continue
        if own not in _TERMS[tag]:
            raise values.wrong("@model", f"{own!r} is none of lensfun's; read are {', '.join(_TERMS[tag])}")
        word = own
        keys = [f"@{key}" for key in _TERMS[tag][word]]
        terms = [values.number(key) if key in values else float(key[1:] in _ONE) for key in keys]
        rows[values.number("@focal")] = np.array(terms)
    return word, rows


def write(path: Path, file: CameraFile) -> None:
    """Write a lens at its focal length, in mm of 35 mm film where the size of its pixels is not known.

    Raises FileError.
    """
    ((name, entry),) = file.cameras.items()
    camera = entry.camera
    lens, _ = LENSES.written(camera)
    size = np.array(camera.image_size)
    unit, aspect = (size.min() - 1) / 2, (size.max() - 1) / (size.min() - 1)
    pitch_mm = float(entry.sensor.get("pixel_pitch_um", 0.0)) / 1000
    crop = _DIAGONAL_MM / (pitch_mm * math.hypot(*(size - 1))) if pitch_mm else 1.0
    unit_mm = _DIAGONAL_MM / 2 / crop / math.hypot(aspect, 1.0)
    ideal = camera.value("fx") / unit  # focal length where r is the radius before the distortion
    own = {name: camera.value(name) for name in camera.model.parameter_names if name in _PARAMETERS}
    if "k1" in own:
        terms = {"k1": own["k1"] / ideal**2, "k2": own["k2"] / ideal**4}
    else:
        # with F for it and fx = F d, d = 1 - a - b - c: F = fx (1 + a2 / F + a3 / F² + a4 / F³)
        roots = np.roots([1.0, -ideal, *(-ideal * own[f"a{power}"] for power in (2, 3, 4))])
        roots = roots.real[np.abs(roots.imag) <= 1e-9 * np.abs(roots)]
        middle, ideal = ideal, float(roots[np.argmin(np.abs(roots - ideal))])
        terms = {key: own[f"a{power}"] * middle / ideal**power for key, power in (("a", 4), ("b", 3), ("c", 2))}
    model = "poly5" if "k1" in own else "ptlens"
    numbers = " ".join(f'{key}="{float(value)!r}"' for key, value in terms.items())
    x, y = (
        2 * (camera.value(f"c{axis}") - (side - 1) / 2) / (size.min() - 1)
        for axis, side in zip("xy", size, strict=True)
    )
    lines = [
        '<lensdatabase version="1">',
        f"  <!-- {LENSFUN.note} -->",
        "  <lens>",
        "    <maker>camcal</maker>",
        f"    <model>{name}</model>",
        "    <mount>Generic</mount>",
        f"    <type>{lens.word}</type>",
        f'    <center x="{float(x)!r}" y="{float(y)!r}"/>',
        f"    <cropfactor>{float(crop)!r}</cropfactor>",
        f"    <aspect-ratio>{float(aspect)!r}</aspect-ratio>",
        "    <calibration>",
        f'      <distortion model="{model}" focal="{float(ideal * unit_mm)!r}" {numbers}/>',
        *("    </calibration>", "  </lens>", "</lensdatabase>", ""),
    ]
    files.write_text(path, "\n".join(lines))


LENSFUN = CameraFormat(
    name="lensfun",
    title="lensfun lens database",
    suffixes=(".xml",),
    models=LENSES.models,
    read=read,
    write=write,
    lenses=LENSES,
    most_cameras=1,
    is_library=True,
    note="FILE#LENS@FOCAL is a lens at a focal length, in mm, and ,CROP after it another sensor's crop factor",
)
