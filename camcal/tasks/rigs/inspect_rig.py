"""What `camcal inspect` says of the cameras of a rig together, and the picture of them."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from camcal import files
from camcal.cameras.model import Rig
from camcal.cameras.validity import ImageCircle
from camcal.dataclass import dataclass, field
from camcal.errors import InvalidInput
from camcal.formats import boards
from camcal.formats.camera_file import CameraFile, rig_of
from camcal.formats.schema import integer, items, mapping, number, text
from camcal.geometry.frame_graph import CameraLink, certain_path
from camcal.geometry.pose import Pose
from camcal.messages import counted
from camcal.quality.rig_geometry import PairGeometry, pair_geometry
from camcal.targets.board import Board

SUFFIXES = (".png", ".html")
_FAR = 1e4  # m, rad: no board is farther
_POSE = mapping({"t": items(number(-_FAR, _FAR), 3), "rotation_vector": items(number(-_FAR, _FAR), 3)})
_LINK = mapping({"cameras": items(text, 2), "boards": items(text), "captures": integer(1), "std_m": number(0, _FAR)})
_SIZE = (1280, 960)
_VIEWS = ("35,25", "front", "top", "side")  # degrees to the right and up: cameras and boards are seen side by side
_MOST_BOARDS = 60
_LEAST_COMMON = 0.05  # of the images: what two cameras see together


@dataclass(frozen=True, eq=False)
class RigInspection:
    """The cameras of a file as a rig, its frame, what pairs of them make, and the boards in its frame.

    pairs: every camera with the first one, or one with which it sees more. board: None where the file does not say it.
    measured: figures of the calibration that the file's provenance has under `rig`. circles: image circles of cameras.
    paths: of the pairs, what links lead from the one camera to the other with the least uncertainty, where the file
    says it.
    """

    rig: Rig
    frame: str
    pairs: tuple[PairGeometry, ...]
    boards: tuple[Pose, ...] = ()
    board: Board | None = None
    measured: Mapping[str, object] = field(default_factory=dict)
    circles: Mapping[str, ImageCircle] = field(default_factory=dict)
    paths: tuple[tuple[CameraLink, ...], ...] = ()


def inspect_rig(file: CameraFile, where: str) -> RigInspection | None:
    """Return what the cameras of a file make together, None for a single one or if transforms do not join them."""
    if len(file.cameras) < 2:
        return None
    try:
        rig, frame = rig_of(file, where)
    except InvalidInput:
        return None
    names = list(rig.cameras)
    circles = {name: entry.image_circle for name, entry in file.cameras.items() if entry.image_circle is not None}
    pairs = tuple(_pair(rig, names[: index + 1], other, circles) for index, other in enumerate(names[1:]))
    measured = file.provenance.get("rig")
    measured = dict(measured) if isinstance(measured, Mapping) else {}
    links = tuple(_links(measured.pop("links", None), names))
    return RigInspection(
        rig,
        frame,
        pairs,
        tuple(_boards(file, rig)),
        _board(file.provenance.get("board")),
        measured,
        circles,
        tuple(certain_path(links, pair.first, pair.second) for pair in pairs) if links else (),
    )


def _links(data: object, names: Sequence[str]) -> Iterator[CameraLink]:
    """Yield the links between cameras that a provenance tells; what is none is passed over."""
    for each in data if isinstance(data, list) else []:
        if not any(_LINK(each, "")) and len(set(each["cameras"]) & set(names)) == 2:
            cameras = str(each["cameras"][0]), str(each["cameras"][1])
            yield CameraLink(cameras, tuple(map(str, each["boards"])), each["captures"], float(each["std_m"]))


def path_words(path: Sequence[CameraLink], first: str) -> str:
    """Return the links from one camera to another in words, with the standard deviation of a position by them."""
    words, camera = [first], first
    for link in path:
        [camera] = set(link.cameras) - {camera}
        by = f" by {' and '.join(link.boards)}" if link.boards else ""
        words.append(f"{camera}{by} ({counted(link.captures, 'capture')}, {1e3 * link.std:.2g} mm)")
    std = float(np.sqrt(sum(link.std**2 for link in path)))
    return f"{' – '.join(words)}" + (f": {1e3 * std:.2g} mm" if len(path) > 1 else "")


def _pair(rig: Rig, before: Sequence[str], camera: str, circles: Mapping[str, ImageCircle]) -> PairGeometry:
    """Return what a camera makes with the first one, or if they see hardly anything together, with the camera before it
    that sees most of the same.
    """
    pairs = []
    for other in before:
        pairs.append(pair_geometry(rig, other, camera, circles=circles))
        if min(pairs[0].common) >= _LEAST_COMMON:
            break
    return max(pairs, key=lambda pair: min(pair.common))


def _board(data: object) -> Board | None:
    """Return the board that a provenance names, None unless it is one."""
    return boards.from_block(data) if isinstance(data, dict) and not any(boards.check(data, "board")) else None


def _boards(file: CameraFile, rig: Rig) -> Iterator[Pose]:
    """Yield rig_T_board of the images that say where the board was."""
    images = file.provenance.get("images")
    for image in images if isinstance(images, list) else []:
        if not isinstance(image, Mapping) or image.get("camera") not in rig.cameras:
            continue
        pose = image.get("camera_T_board")
        if isinstance(pose, dict) and not any(_POSE(pose, "camera_T_board")):
            camera_T_board = Pose.from_vector(np.array(pose["rotation_vector"]), np.array(pose["t"]))
            yield rig.rig_T_camera[str(image["camera"])] @ camera_T_board


def draw_rig(found: RigInspection, output: Path) -> None:
    """Write the picture of a rig, or the page that shows it from all sides; raises FileError."""
    from camcal.images.image_circle import evenly_spaced
    from camcal.report.cloud_pictures import montage
    from camcal.report.cloud_view import Start, page
    from camcal.report.colour_scale import paint_of
    from camcal.report.rig_scene import rig_scene

    chosen = evenly_spaced(len(found.boards), _MOST_BOARDS)
    scene = rig_scene(found.rig, [found.boards[index] for index in chosen], found.board, found.circles)
    if output.suffix.lower() == ".html":
        files.write_text(output, page(scene, output.stem, Start("image", _VIEWS[0])))
    else:
        from camcal.images.files import save

        save(output, montage(scene, paint_of(scene), _SIZE, views=_VIEWS)[:, :, ::-1])


def colour_words(found: RigInspection) -> str:
    """Return which camera has which colour in the picture."""
    from camcal.report.rig_scene import colour_name

    return ", ".join(f"{name} {colour_name(index)}" for index, name in enumerate(found.rig.cameras))


def as_data(found: RigInspection | None) -> dict[str, Any] | None:
    """Return what a rig can measure as plain data; m, degrees, px."""
    if found is None:
        return None
    pairs = [_pair_data(pair) for pair in found.pairs]
    for pair, path in zip(pairs, found.paths, strict=False):
        pair["path"] = [link.as_data() for link in path]
    return {"frame": found.frame, "pairs": pairs, "measured": dict(found.measured)}


def _pair_data(pair: PairGeometry) -> dict[str, Any]:
    degrees = None if pair.rotation.std is None else float(np.degrees(pair.rotation.std))
    return {
        "cameras": [pair.first, pair.second],
        "baseline_m": pair.baseline.value,
        "baseline_std_m": pair.baseline.std,
        "rotation_deg": float(np.degrees(pair.rotation.value)),
        "rotation_std_deg": degrees,
        "vergence_deg": float(np.degrees(pair.vergence)),
        "converging": pair.converging,
        "common_field": list(pair.common),
        "epipolar_px": pair.epipolar_px,
        "depth": [
            {
                "distance_m": own.distance,
                "matching_std_m": own.matching,
                "calibration_std_m": own.calibration,
                "common_field": own.common,
            }
            for own in pair.depths
        ],
    }
