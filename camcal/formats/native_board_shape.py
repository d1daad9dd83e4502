"""The shape of the board that a calibration found, as a block of a camera file.

    board: {type: chessboard, inner_corners: [9, 6], square_mm: 25.0}
    classes:                              # optional
      bow: {scale: 0.00039, std: 0.0001}
    coefficients: {xy: 1.2e-05, P2(x): 0.00021, P2(y): -3.1e-05, stretch: -0.003, shear: 1.0e-05}
    uncertainty: {std: {xy: 2.0e-06, ...}, covariance_order: [...], covariance: [...]}
    deflection_m: 0.00031
    deflection_std_m: 1.5e-05
    offsets: one [x, y, z] per corner, in the order of the ids (optional)
    tiers: [bow, stretch]                 # optional, in older files

Coefficients, offsets and deflection are in metres, in squares when the square's size is unknown (the keys then end in
_squares); stretch and shear are ratios. Scales are shares of the board's longer side, ratios for stretch and shear.
"""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from camcal.formats import boards, covariance
from camcal.formats.schema import items, mapping, number, one_of
from camcal.formats.strict_yaml import Fault, child
from camcal.targets.surface import CLASSES, CORNER_CLASSES, OFFSETS, TERMS, TIERS, Surface

# A key of the file is a plain word.
KEY_OF_TERM = {term: {"x/y scale": "stretch"}.get(term, term.replace(" ", "_")) for term in TERMS}
KEY_OF_CLASS = {name: name.replace(" ", "_") for name in (*CLASSES, *CORNER_CLASSES)}
_TERM_OF_KEY = {key: term for term, key in KEY_OF_TERM.items()}
_CLASS_OF_KEY = {key: name for name, key in KEY_OF_CLASS.items()}

_SCALE = mapping({"scale": number(0), "std": number(0)})
_SHAPE = mapping(
    {
        "board": boards.check,
        "coefficients": mapping({}, dict.fromkeys(_TERM_OF_KEY, number())),
        "uncertainty": mapping({}, covariance.KEYS),
    },
    {
        "tiers": items(one_of((*TIERS, OFFSETS), "tier")),
        "classes": mapping({}, dict.fromkeys(_CLASS_OF_KEY, _SCALE)),
        **{f"{what}_{unit}": number(0) for what in ("deflection", "deflection_std") for unit in ("m", "squares")},
        "offsets": items(items(number(), 3)),
    },
)


def check(data: Any, path: str) -> Iterator[Fault]:
    """Check the block."""
    faults = list(_SHAPE(data, path))
    yield from faults
    if faults:
        return
    board, terms = boards.from_block(data["board"]), _terms(data)
    yield from covariance.check(data["uncertainty"], child(path, "uncertainty"), terms)
    lacking = [name for name in terms if name not in data["uncertainty"].get("std", {})]
    if lacking:
        yield Fault(child(path, "uncertainty"), f"std is missing for {', '.join(lacking)}")
    other = "squares" if board.unit == "m" else "m"
    for key in (f"deflection_{other}", f"deflection_std_{other}"):
        if key in data:
            yield Fault(child(path, key), f"the board's lengths are in {board.unit}; write deflection_{board.unit}")
    if "offsets" in data and len(data["offsets"]) != board.count:
        yield Fault(child(path, "offsets"), f"{len(data['offsets'])} offsets; the board has {board.count} corners")


def read(data: Mapping[str, Any], folder: Path) -> Surface:
    """Return the surface of data that has passed `check`."""
    board, keys = boards.from_block(data["board"]), _terms(data)
    known, _ = covariance.read(data["uncertainty"], keys, folder)
    return Surface(
        board,
        tuple(data.get("tiers", ())),
        terms=tuple(_TERM_OF_KEY[key] for key in keys),
        coefficients=np.array([float(data["coefficients"][key]) for key in keys]),
        covariance=np.zeros((0, 0)) if known is None else known,
        offsets=np.array(data["offsets"], dtype=float) if "offsets" in data else None,
        deflection=float(data.get(f"deflection_{board.unit}", 0.0)),
        deflection_std=float(data.get(f"deflection_std_{board.unit}", 0.0)),
        classes={
            _CLASS_OF_KEY[key]: (float(found["scale"]), float(found["std"]))
            for key, found in data.get("classes", {}).items()
            if key in _CLASS_OF_KEY  # and not x_ keys of others
        },
    )


def _terms(data: Mapping[str, Any]) -> list[str]:
    return [key for key in data["coefficients"] if key in _TERM_OF_KEY]


def block(surface: Surface, beside: Path) -> dict[str, Any]:
    """Return a surface as plain data; beside: the file it is for."""
    keys, unit = [KEY_OF_TERM[term] for term in surface.terms], surface.board.unit
    return {
        "board": boards.block(surface.board),
        "tiers": list(surface.tiers) or None,
        "classes": {
            KEY_OF_CLASS[name]: {"scale": float(scale), "std": float(std)}
            for name, (scale, std) in surface.classes.items()
        }
        or None,
        "coefficients": dict(zip(keys, surface.coefficients.tolist(), strict=True)),
        "uncertainty": covariance.block(keys, surface.covariance, beside),
        f"deflection_{unit}": float(surface.deflection),
        f"deflection_std_{unit}": float(surface.deflection_std),
        "offsets": None if surface.offsets is None else surface.offsets.tolist(),
    }
