"""The points of a cloud in few bytes, for a page that unpacks them: 16-bit steps, differences, deflate.

Before deflate the bytes of N points stand in planes of N: low and high bytes of x, of y and of z as differences from
point to point (modulo 65536); if there are colours, green, red minus green and blue minus green, also as differences
from point to point (modulo 256); if there is sigma, its codes (0: not known; c: low · ratio^(c - 1)). Neighbours in a
file are mostly neighbours in space, so differences are small and the planes of high bytes shrink to next to nothing.
"""

import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from camcal.arrays import Array
from camcal.report.cloud_scene import CloudScene, evenly

_STEPS = 65535
_THINNEST = 1e-9  # of an axis along which all points are the same
_SIGMA_STEPS = 254
_SAMPLE = 20_000
_JUMP = 1024  # steps from point to point, above which the order of a file is none
_CELL_BITS = 10  # cells of 1024 steps, 64 along each axis


@dataclass(frozen=True)
class PackedCloud:
    """Deflated bytes, and what is needed to make numbers of them.

    origin, step: x, y, z of a point are origin + step · count. sigma: lowest value and ratio from code to code, None
    without sigma.
    """

    content: bytes
    count: int
    origin: tuple[float, ...]
    step: tuple[float, ...]
    colours: bool
    sigma: tuple[float, float] | None

    @property
    def error(self) -> float:
        """How far a point may be from where it was: half a step along each axis, in the unit of the cloud."""
        return float(np.linalg.norm(self.step)) / 2

    def document(self) -> dict[str, Any]:
        return {
            "count": self.count,
            "origin": self.origin,
            "step": self.step,
            "colours": self.colours,
            "sigma": self.sigma,
            "error": self.error,
        }


def pack(scene: CloudScene) -> PackedCloud:
    """Return the points of a scene, with colours and sigma if it has them, in few bytes."""
    axes = [np.ascontiguousarray(axis) for axis in scene.points.T]
    origin = [float(axis.min()) for axis in axes]
    step = [max(float(axis.max()) - low, _THINNEST) / _STEPS for axis, low in zip(axes, origin, strict=True)]
    counts = [_counts(axis, low, length) for axis, low, length in zip(axes, origin, step, strict=True)]
    order = _neighbourly(counts)
    planes = [half for axis in counts for half in _halves(np.diff(axis[order], prepend=np.uint16(0)))]
    if scene.colours is not None:
        red, green, blue = scene.colours[order].T
        planes += [np.diff(plane, prepend=np.uint8(0)) for plane in (green, red - green, blue - green)]
    sigma = None
    if scene.sigma is not None:
        codes, sigma = _sigma_codes(scene.sigma[order])
        planes.append(codes)
    return PackedCloud(
        _deflated(planes), len(scene.points), tuple(origin), tuple(step), scene.colours is not None, sigma
    )


def _deflated(planes: Sequence[Array]) -> bytes:
    """Return planes of bytes as a zlib stream.

    Of differences only runs of zeros repeat: to look for nothing else is faster than the search for longer matches, and
    leaves less.
    """
    deflate = zlib.compressobj(strategy=zlib.Z_RLE)
    return b"".join([*(deflate.compress(plane.tobytes()) for plane in planes), deflate.flush()])


def _counts(axis: Array, low: float, step: float) -> Array:
    """Return the steps (N,), uint16, from the lowest value, to the nearest."""
    return np.rint((axis.astype(np.float64) - low) / step).astype(np.uint16)


def _neighbourly(counts: Sequence[Array]) -> Array | slice:
    """Return an order of x, y, z (N,) in which neighbours follow each other: that of the file, if it is one."""
    places = evenly(len(counts[0]) - 1, _SAMPLE)
    jumps = [np.abs(axis[places + 1].astype(np.int32) - axis[places]) for axis in counts]
    if not len(places) or np.median(jumps) < _JUMP:
        return slice(None)
    x, y, z = (axis.astype(np.int64) >> _CELL_BITS for axis in counts)
    order: Array = np.argsort(x << 16 | y << 8 | z, kind="stable")
    return order


def _halves(differences: Array) -> tuple[Array, Array]:
    """Return low and high bytes of 16-bit numbers; those near 65536 are small negative differences."""
    return (differences & 0xFF).astype(np.uint8), (differences >> 8).astype(np.uint8)


def _sigma_codes(sigma: Array) -> tuple[Array, tuple[float, float]]:
    """Return a byte for every sigma, in equal ratios from the lowest to the highest; and the lowest and the ratio."""
    known = np.isfinite(sigma) & (sigma > 0)
    if not known.any():
        return np.zeros(len(sigma), np.uint8), (1.0, 1.0)
    logarithm = np.log(sigma[known].astype(np.float64))
    low, high = float(logarithm.min()), float(logarithm.max())
    per_code = max((high - low) / _SIGMA_STEPS, 1e-9)
    codes = np.zeros(len(sigma), np.uint8)
    codes[known] = np.rint((logarithm - low) / per_code) + 1
    return codes, (float(np.exp(low)), float(np.exp(per_code)))
