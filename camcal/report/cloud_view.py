"""A point cloud as one page that shows it: opened from disk, offline, nothing else needed than a browser with WebGL."""

import base64
import html
import json
from dataclasses import dataclass
from importlib.resources import files
from typing import Any

from camcal.report.cloud_packing import PackedCloud, pack
from camcal.report.cloud_scene import CloudScene
from camcal.report.cloud_views import named_views, view_of
from camcal.report.colour_scale import ColourScale, scale_of, turbo_table

_ASSETS = files("camcal.report") / "assets" / "cloud_view"
_SCRIPTS = ("vectors", "scale", "cloud", "viewpoint", "painter", "measuring", "drawing", "gestures", "main")
_SPACE = "\N{NARROW NO-BREAK SPACE}"


@dataclass(frozen=True)
class Start:
    """How a page looks at first: see `cloud_paint.COLOURS` and `cloud_views.view_of`; point_size: a factor."""

    colour: str
    view: str = "camera"
    point_size: float = 1.0


def page(scene: CloudScene, title: str, start: Start) -> str:
    """Return the HTML page of a cloud. The same scene gives the same page, byte for byte.

    Raises InvalidInput for a view that is none.
    """
    packed = pack(scene)
    parts = {
        "title": html.escape(title),
        "style": _asset("style.css"),
        "script": "\n".join(_asset(f"{name}.js") for name in _SCRIPTS),
        # A "<" could end the element that holds the document.
        "facts": json.dumps(_facts(scene, packed, start), allow_nan=False).replace("<", "\\u003c"),
        "packed": base64.b64encode(packed.content).decode("ascii"),
    }
    whole = _asset("page.html").split("{{")
    return whole[0] + "".join(parts[name] + rest for name, rest in (piece.split("}}", 1) for piece in whole[1:]))


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
        "scales": {name: _document(scale) for name, scale in scales.items()},
        "turbo": base64.b64encode(turbo_table().tobytes()).decode("ascii"),
        "start": view_of(start.view, scene).document(),
        "colour": start.colour,
        "point_size": start.point_size,
    }


def _document(scale: ColourScale) -> dict[str, Any]:
    return {"low": scale.low, "high": scale.high, "logarithmic": scale.logarithmic}


def statistics(scene: CloudScene, packed: PackedCloud) -> str:
    """Return a line that says what the page holds, what it leaves out, and how exact it is."""
    shown = packed.count + scene.outside
    points = f"{_count(shown)} points"
    if shown < scene.total:
        points = f"{_count(shown)} of {_count(scene.total)} points, taken evenly"
    outside = f"{_count(scene.outside)} of them far outside left out" if scene.outside else ""
    depth = f"half of them nearer than {scene.median_depth:.4g} {scene.unit}" if scene.from_camera else ""
    exact = f"positions to ±{packed.error:.2g} {scene.unit}"
    return " · ".join(filter(None, (points, outside, depth, exact, f"frame: {scene.frame}")))


def _count(number: int) -> str:
    return f"{number:,}".replace(",", _SPACE)
