"""Where makers keep how a frame was taken. The files here are only as much of theirs as that takes."""

import io
import struct
from typing import NamedTuple

import pytest
from PIL import Image as Pillow
from PIL.TiffImagePlugin import IFDRational

from camcal.raw.mosaic import Capture
from camcal.raw.reading import capture_of


class Known(NamedTuple):
    """What LibRaw says; by default what it says when it knows nothing."""

    iso_speed: float = 0.0
    shutter_speed: float = 1.0
    aperture: float = 1.0
    focal_length: float = 0.0


def block(make=None, model=None, **numbers):
    tags = Pillow.Exif()
    if make:
        tags[0x010F], tags[0x0110] = make, model
    directory = tags.get_ifd(0x8769)
    for name, tag in (("exposure_s", 0x829A), ("f_number", 0x829D), ("focal_mm", 0x920A)):
        if name in numbers:
            directory[tag] = IFDRational(numbers[name])
    if "iso" in numbers:
        directory[0x8827] = numbers["iso"]
    return tags.tobytes()[6:]


def fuji(exif):
    preview = io.BytesIO()
    Pillow.new("L", (8, 8)).save(preview, "JPEG", exif=b"Exif\0\0" + exif)
    head = b"FUJIFILMCCD-RAW ".ljust(84, b"\0")
    return head + struct.pack(">II", 120, len(preview.getvalue())) + bytes(28) + preview.getvalue() + bytes(50)


def canon(*blocks):
    boxes = (struct.pack(">I", 8 + len(b)) + name + b for name, b in zip((b"CMT1", b"CMT2"), blocks, strict=True))
    return struct.pack(">I", 24) + b"ftypcrx " + bytes(12) + b"".join(boxes)


def facts(capture):
    return {name: value for name, value in vars(capture).items() if value}


SAID = {"make": "Acme", "model": "X", "exposure_s": 0.25, "f_number": 8.0, "iso": 100, "focal_mm": 35.0}


@pytest.mark.parametrize("wrapped", [lambda b: b, fuji, lambda b: canon(b, b)], ids=["tiff", "fuji", "canon"])
def test_the_tags_of_every_kind_of_file_are_found(wrapped):
    assert facts(capture_of(wrapped(block(**SAID)), Known())) == SAID


def test_a_box_of_its_own_for_the_capture_adds_to_the_first():
    content = canon(block("Acme", "X"), block(iso=1600))
    assert facts(capture_of(content, Known())) == {"make": "Acme", "model": "X", "iso": 1600}


def test_what_libraw_knows_fills_the_gaps_and_no_more():
    known = Known(200.0, 0.01, 4.0, 85.0)
    found = facts(capture_of(block(iso=400), known))
    assert found == {"exposure_s": 0.01, "iso": 400, "f_number": 4.0, "focal_mm": 85.0}


def test_the_defaults_of_libraw_are_no_facts():
    assert vars(capture_of(b"no tags here", Known())) == vars(Capture())


def test_an_exposure_of_one_second_is_believed_if_the_tags_say_it():
    assert capture_of(block(exposure_s=1.0), Known()).exposure_s == 1


@pytest.mark.parametrize("content", [b"FUJIFILMCCD-RAW", canon(b"", b"")[:30], canon(b"", b""), b""])
def test_a_file_that_ends_early_says_nothing(content):
    assert vars(capture_of(content, Known())) == vars(Capture())
