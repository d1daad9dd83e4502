"""Points of an object and where images show them, as a CSV: what `camcal pnp --points` reads.

    image,id,X,Y,Z,u,v
    a.png,0,0.0,0.0,0.0,101.25,88.5

X, Y, Z are metres in the object's frame; u, v pixels with (0, 0) at the centre of the top-left pixel. The columns may
stand in any order. image may be left out (one image); id and suu, suv, svv (covariance, px²) may be added.
"""

from pathlib import Path

import numpy as np

from camcal.arrays import Array
from camcal.errors import InsufficientData, InvalidInput
from camcal.estimate.pnp import Correspondences
from camcal.formats.tables import Table, numbered_lines

COLUMNS = ("X", "Y", "Z", "u", "v")
COVARIANCE = ("suu", "suv", "svv")
OPTIONAL = ("image", "id", *COVARIANCE)
MAX_ID = 10**9
MARGIN = 0.1  # a point farther outside than this share of the image's side is a mistake, not a measurement


def read(path: Path, image_size: tuple[int, int]) -> list[Correspondences]:
    """Return the correspondences of every image in a file, images in the order in which it first names them.

    image_size: (width, height) of the camera, in which the pixels must lie.
    Raises InvalidInput with file and line for the first row that breaks a rule, FileError if the file cannot be read.
    """
    table = Table.from_csv(str(path), numbered_lines(path), COLUMNS, OPTIONAL)
    if not len(table):
        raise InsufficientData("holds no points", where=str(path))
    points, pixels = _columns(table, COLUMNS[:3]), _columns(table, COLUMNS[3:])
    _refuse_outside(table, pixels, image_size)
    covariance = _covariance(table)
    images = table.columns.get("image", [path.name] * len(table))
    rows: dict[str, list[int]] = {}
    for row, image in enumerate(images):
        rows.setdefault(image, []).append(row)
    for image, chosen in rows.items():
        _refuse_repeats(table.rows(np.array(chosen)), image, points[chosen])
    return [
        Correspondences(image, points[chosen], pixels[chosen], None if covariance is None else covariance[chosen])
        for image, chosen in rows.items()
    ]


def _columns(table: Table, names: tuple[str, ...]) -> Array:
    return np.column_stack([table.numbers(name) for name in names])


def _covariance(table: Table) -> Array | None:
    """Return the covariances (N, 2, 2) in px², None without the columns."""
    given = [name for name in COVARIANCE if name in table.columns]
    if not given:
        return None
    if len(given) < len(COVARIANCE):
        raise InvalidInput(f"column {given[0]!r} without the others of {','.join(COVARIANCE)}", where=table.path)
    suu, suv, svv = (table.numbers(name) for name in COVARIANCE)
    bad = np.asarray((suu <= 0) | (suu * svv <= suv**2))
    table.refuse(bad, lambda _row: "suu, suv, svv are no covariance (not positive)")
    return np.stack([suu, suv, suv, svv], axis=1).reshape(-1, 2, 2)


def _refuse_outside(table: Table, pixels: Array, image_size: tuple[int, int]) -> None:
    size = np.array(image_size)
    outside = np.any((pixels < -0.5 - MARGIN * size) | (pixels > size - 0.5 + MARGIN * size), axis=1)
    table.refuse(
        outside,
        lambda row: (
            f"({pixels[row, 0]:g}, {pixels[row, 1]:g}) is far outside the camera's image of "
            f"{size[0]} x {size[1]}; are u and v exchanged, or is it another camera?"
        ),
    )


def _refuse_repeats(table: Table, image: str, points: Array) -> None:
    """Refuse a point that stands twice in one image, by its id or by its coordinates."""
    if "id" in table.columns:
        ids = table.integers("id", 0, MAX_ID)
        table.refuse(_repeated(ids[:, None]), lambda row: f"image {image!r}: id {ids[row]} stands twice")
    named = "({:g}, {:g}, {:g})"
    table.refuse(_repeated(points), lambda row: f"image {image!r}: the point {named.format(*points[row])} stands twice")


def _repeated(values: Array) -> Array:
    """Return the mask (N,) of rows (N, D) that are equal to an earlier one."""
    first = np.unique(values, axis=0, return_index=True)[1]
    return ~np.isin(np.arange(len(values)), first)
