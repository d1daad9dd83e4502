"""Maps of a view: where every pixel of it comes from in the camera's image, as other programs draw images by.

.npz: map_x, map_y (H, W) for cv2.remap, and valid. .exr, .png: an ST map, as compositing programs have it: red is
(u + ½)/width, green 1 - (v + ½)/height, from the bottom left corner of the image; blue is 1 where there is a source.
.txt: the offsets of a lens distortion correction unit (Texas Instruments' LDC): a line for every node of a mesh, row by
row, with how far right and down its source is, in eighths of a pixel.
"""

import math
from pathlib import Path

import numpy as np

from camcal import files
from camcal.arrays import Array
from camcal.errors import InvalidInput
from camcal.formats.exr import write_exr
from camcal.images.files import save
from camcal.images.options import MAP_SUFFIXES
from camcal.images.remap import Maps

_WHOLE = 65535
_EIGHTHS = 8
_LARGEST = 32767


def write_maps(path: Path, maps: Maps) -> str:
    """Write the maps of a view in the format of a suffix but .txt, and return how they are used.

    Raises InvalidInput for another suffix, FileError.
    """
    width, height = maps.source_size
    valid = maps.valid()
    if path.suffix == ".npz":
        with files.replacing(path) as temporary, temporary.open("wb") as stream:
            np.savez_compressed(stream, map_x=maps.x, map_y=maps.y, valid=valid)
        return "cv2.remap(image, maps['map_x'], maps['map_y'], cv2.INTER_LINEAR)"
    across = np.where(valid, (maps.x.astype(np.float64) + 0.5) / width, 0.0)
    up = np.where(valid, 1.0 - (maps.y.astype(np.float64) + 0.5) / height, 0.0)
    if path.suffix == ".exr":
        write_exr(path, {"R": across, "G": up, "B": valid})
        return "ST map: red is (u + 1/2)/width, green 1 - (v + 1/2)/height"
    if path.suffix != ".png":
        raise InvalidInput(f"maps are written as {', '.join(MAP_SUFFIXES)}", where=str(path))
    whole = np.rint(_WHOLE * np.stack([valid, up, across], axis=-1)).astype(np.uint16)
    save(path, whole)
    exact = max(width, height) / _WHOLE / 2
    return f"ST map of 16 bits: red is (u + 1/2)/width, green 1 - (v + 1/2)/height, to {exact:.2g} px"


def mesh_nodes(size: tuple[int, int], step: int) -> Array:
    """Return the pixels (rows, columns, 2) of the nodes of a mesh over a view (width, height), the last ones beyond."""
    columns, rows = (math.ceil(side / step) + 1 for side in size)
    return np.stack(np.meshgrid(step * np.arange(columns), step * np.arange(rows)), axis=-1).astype(float)


def write_mesh(path: Path, nodes: Array, sources: Array, step: int) -> str:
    """Write the offsets of nodes (rows, columns, 2) from the pixels they come from, and return how they are used.

    Raises InvalidInput for nodes without a source, or farther away than the unit can hold; FileError.
    """
    missing = int(np.isnan(sources[..., 0]).sum())
    if missing:
        advice = "give --alpha 0, or a smaller --fov"
        raise InvalidInput(f"{missing} of {nodes[..., 0].size} nodes have no source: {advice}", where=str(path))
    offsets = np.rint(_EIGHTHS * (sources - nodes)).astype(np.int64)
    farthest = int(np.abs(offsets).max())
    if farthest > _LARGEST:
        raise InvalidInput(
            f"offsets up to {farthest / _EIGHTHS:.0f} px, the unit holds {_LARGEST // _EIGHTHS}", where=str(path)
        )
    files.write_text(path, "".join(f"{right} {down}\n" for right, down in offsets.reshape(-1, 2).tolist()))
    rows, columns = nodes.shape[:2]
    return f"LDC mesh of {columns} x {rows} nodes, {step} px apart: offsets right and down in 1/8 px"
