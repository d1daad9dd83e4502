"""A point cloud as one offline HTML page for browsers with WebGL.

The page unpacks the points: 16-bit steps, differences, deflate. Before deflate the bytes of N points stand in planes of
N: low and high bytes of x, of y and of z as differences from point to point (modulo 65536); if there are colours,
green, red minus green and blue minus green, also as differences from point to point (modulo 256); if there is sigma,
its codes (0: not known; c: low · ratio^(c - 1)). Neighbours in a file are mostly neighbours in space, so differences
are small and the planes of high bytes shrink to next to nothing.

Where the Rerun viewer is installed, a cloud can be recorded for it or shown in it.
"""

import base64
import hashlib
import html
import importlib
import json
import os
import sys
import zlib
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from camcal.arrays import Array
from camcal.dataclass import dataclass
from camcal.errors import FileError, InvalidInput
from camcal.files import replacing
from camcal.report.cloud_scene import CloudScene, evenly, named_views, view_of
from camcal.report.colour_scale import Paint, scale_of, turbo_table

_STEPS = 65535
_THINNEST = 1e-9  # of an axis along which all points are the same
_SIGMA_STEPS = 254
_SAMPLE = 20_000
_JUMP = 1024  # steps from point to point, above which the order of a file is none
_CELL_BITS = 10  # cells of 1024 steps, 64 along each axis
_ASSETS = files("camcal.report") / "assets" / "cloud_view"
_SCRIPTS = ("vectors", "scale", "cloud", "viewpoint", "painter", "measuring", "drawing", "gestures", "main")
_SPACE = "\N{NARROW NO-BREAK SPACE}"
SUFFIX = ".rrd"
_APPLICATION = "camcal view"
_IDENTIFIER = "camcal"  # the same in every run
_SCREENS = ("DISPLAY", "WAYLAND_DISPLAY")


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
        _deflate(planes), len(scene.points), tuple(origin), tuple(step), scene.colours is not None, sigma
    )


def _deflate(planes: Sequence[Array]) -> bytes:
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


@dataclass(frozen=True)
class Start:
    """How a page looks at first: see `colour_scale.COLOURS` and `cloud_views.view_of`; point_size: a factor."""

    colour: str
    view: str = "camera"
    point_size: float = 1.0


def page(scene: CloudScene, title: str, start: Start) -> str:
    """Return the HTML page of a cloud. The same scene gives the same page, byte for byte.

    Raises InvalidInput for a view that is none.
    """
    packed = pack(scene)
    style, script = _asset("style.css"), "\n".join(_asset(f"{name}.js") for name in _SCRIPTS)
    parts = {
        "policy": f"default-src 'none'; script-src {_source(script)}; style-src {_source(style)}",
        "title": html.escape(title),
        "style": style,
        "script": script,
        # A "<" could end the element that holds the document.
        "facts": json.dumps(_facts(scene, packed, start), allow_nan=False).replace("<", "\\u003c"),
        "packed": base64.b64encode(packed.content).decode("ascii"),
    }
    whole = _asset("page.html").split("{{")
    return whole[0] + "".join(parts[name] + rest for name, rest in (piece.split("}}", 1) for piece in whole[1:]))


def _source(content: str) -> str:
    """Return what allows the one element with this content, on lines of its own, and no other (W3C CSP, 8.3)."""
    digest = hashlib.sha256(f"\n{content}\n".encode()).digest()
    return f"'sha256-{base64.b64encode(digest).decode('ascii')}'"


def _asset(name: str) -> str:
    return (_ASSETS / name).read_text(encoding="utf-8")


def _facts(scene: CloudScene, packed: PackedCloud, start: Start) -> dict[str, Any]:
    """Return what the page knows besides the points: lengths in the unit of the file; x right, y down, z forward."""
    spacing, grows = scene.spacing
    scales = {"depth": scale_of(scene.depth)} | ({"sigma": scale_of(scene.sigma)} if scene.sigma is not None else {})
    return {
        "unit": scene.unit,
        "statistics": statistics(scene, packed),
        "packed": packed.document(),
        "view_T_cloud": scene.view_T_cloud.tolist(),
        "from_camera": scene.from_camera,
        "tangents": scene.tangents.tolist(),
        "depth": scene.median_depth,
        "box": scene.box.tolist(),
        "views": {name: view.document() for name, view in named_views(scene).items()},
        "spacing": spacing,
        "spacing_grows": grows,
        "scales": {
            name: {"low": scale.low, "high": scale.high, "logarithmic": scale.logarithmic}
            for name, scale in scales.items()
        },
        "turbo": base64.b64encode(turbo_table().tobytes()).decode("ascii"),
        "start": view_of(start.view, scene).document(),
        "colour": start.colour,
        "point_size": start.point_size,
    }


def statistics(scene: CloudScene, packed: PackedCloud) -> str:
    """Return a line that says what the page holds, what it leaves out, and to what resolution it stores the points."""
    shown = packed.count + scene.outside
    points = f"{_count(shown)} points"
    if shown < scene.total:
        points = f"{_count(shown)} of {_count(scene.total)} points, taken evenly"
    outside = f"{_count(scene.outside)} of them far outside left out" if scene.outside else ""
    depth = f"half of them nearer than {scene.median_depth:.4g} {scene.unit}" if scene.from_camera else ""
    exact = f"stored to ±{packed.error:.2g} {scene.unit} (resolution of this page, not accuracy)"
    return " · ".join(filter(None, (points, outside, depth, exact, f"frame: {scene.frame}")))


def _count(number: int) -> str:
    return f"{number:,}".replace(",", _SPACE)


def require_rerun() -> Any:
    """Return the module of the Rerun SDK; raises InvalidInput, naming the extra, where it is not installed."""
    try:
        return importlib.import_module("rerun")
    except ImportError as error:
        raise InvalidInput("Rerun is not installed; pip install 'camcal[view]', or write .html instead") from error


def save_recording(path: Path, scene: CloudScene, paint: Paint) -> None:
    """Write a recording of a cloud. Raises InvalidInput without the Rerun SDK, FileError if it cannot be written."""
    rerun = require_rerun()
    with replacing(path) as temporary:
        recording = rerun.RecordingStream(_APPLICATION, recording_id=_IDENTIFIER)
        recording.save(temporary)
        _log(rerun, recording, scene, paint)
        recording.flush()
        recording.disconnect()
        if not temporary.stat().st_size:
            raise FileError("Rerun wrote no file", where=str(path))


def open_viewer(scene: CloudScene, paint: Paint) -> None:
    """Show a cloud in the Rerun viewer, which stays open. Raises InvalidInput without the Rerun SDK or a screen."""
    rerun = require_rerun()
    if sys.platform == "linux" and not any(map(os.environ.get, _SCREENS)):
        raise InvalidInput(f"no display for Rerun: write a file with -o NAME{SUFFIX}")
    recording = rerun.RecordingStream(_APPLICATION, recording_id=_IDENTIFIER)
    try:
        recording.spawn()
        _log(rerun, recording, scene, paint)
        recording.flush()
    except RuntimeError as error:
        reason = str(error).splitlines()[0]
        raise InvalidInput(f"the Rerun viewer does not start: {reason} Write for it with -o NAME{SUFFIX}") from error


def _log(rerun: Any, recording: Any, scene: CloudScene, paint: Paint) -> None:
    spacing, grows = scene.spacing
    radius = 0.5 * spacing * (scene.median_depth if grows else 1.0)
    recording.log("cloud", getattr(rerun.ViewCoordinates, _axes(scene.view_T_cloud)), static=True)
    recording.log("cloud/points", rerun.Points3D(scene.points, colors=paint.colours, radii=abs(radius)), static=True)


def _axes(view_T_cloud: Array) -> str:
    """Return where x, y and z of a cloud point, as the first letters of right, left, down, up, forward and back."""
    pairs = ("RL", "DU", "FB")
    rows = np.abs(view_T_cloud).argmax(axis=0).tolist()
    return "".join(pairs[row][int(view_T_cloud[row, axis] < 0)] for axis, row in enumerate(rows))
