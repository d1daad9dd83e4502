"""Correspondences of points and pixels, the input of `camcal pnp --points`, as CSV, YAML or JSON.

    image,id,X,Y,Z,u,v
    a.png,0,0.0,0.0,0.0,101.25,88.5

X, Y, Z are metres in the object's frame; u, v pixels with (0, 0) at the centre of the top-left pixel. The columns may
stand in any order. Optional are image (without it all points are of one), id (a whole number, which names a point in
messages), camera (of a rig; images of the same name are then one instant), and one way to say how well pixels are
known: sigma, the standard deviation of u and of v in pixels; suu, suv, svv, their covariance in px²; or weight, by how
much more a squared residual counts than that of a point of weight 1 (0 leaves the point out). YAML and JSON have the
same names, a mapping for each point:

    points:
      - {image: a.png, id: 0, X: 0.0, Y: 0.0, Z: 0.0, u: 101.25, v: 88.5}

Tables of points alone, which `camcal transform points` takes to another frame, are here too.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from camcal import files
from camcal.arrays import Array, readonly
from camcal.dataclass import dataclass
from camcal.errors import InsufficientData, InvalidInput
from camcal.estimate.poses.records import Correspondences
from camcal.formats.documents import Fault, child, load_either
from camcal.formats.schema import mapping
from camcal.formats.tables import COVARIANCE, Table, cell, csv_rows, far_outside, numbered_lines, pixel_covariances

COLUMNS = ("X", "Y", "Z", "u", "v")
OPTIONAL = ("image", "id", "camera", "sigma", *COVARIANCE, "weight")
YAML = (".yaml", ".yml")
JSON = (".json",)
MAX_ID = 10**9
FARTHEST = 1e9  # m from the origin; squares of squares of more are no numbers any longer
BEYOND = 1e12  # of a sigma, a variance or a weight; its inverse is the least

_MAX_VALUES = 20_000_000  # of a YAML file, which is a table here

Size = tuple[int, int]

POSITION = ("x", "y", "z")
NORMAL = ("nx", "ny", "nz")
SPACE_COVARIANCE = ("sxx", "sxy", "sxz", "syy", "syz", "szz")

_VARIANCES = ("sxx", "syy", "szz")
_UPPER = np.triu_indices(3)


@dataclass(frozen=True, eq=False)
class PointViews:
    """The correspondences of every image, and the ids (N,) of their points, image by image.

    absolute: whether the covariances are in px², not up to a factor that only the residuals tell.
    """

    views: tuple[Correspondences, ...]
    ids: tuple[Array, ...]
    absolute: bool


def read(path: Path, image_size: Size | Mapping[str, Size]) -> PointViews:
    """Return the correspondences of every image in a file, images in the order in which it first names them.

    image_size: (width, height) of the camera in which the pixels must lie, or of every camera of a rig by its name.
    Points of weight 0 are left out. Raises InvalidInput with file and line for the first row that breaks a rule,
    InsufficientData for a file without points, FileError if it cannot be read.
    """
    table = _weighty(_table(path))
    if not len(table):
        raise InsufficientData("holds no points", where=str(path))
    sizes = image_size if isinstance(image_size, Mapping) else {_only_camera(table): image_size}
    cameras = _cameras(table, sizes)
    points, pixels = (np.column_stack([table.numbers(name) for name in part]) for part in (COLUMNS[:3], COLUMNS[3:]))
    farthest = np.abs(points).max(axis=1)
    table.refuse(
        farthest > FARTHEST,
        lambda row: f"a coordinate of {farthest[row]:g} m is implausible: check that X, Y, Z are in metres",
    )
    _refuse_outside(table, pixels, np.array([sizes[name] for name in cameras]))
    covariance = _covariance(table)
    ids = table.integers("id", 0, MAX_ID) if "id" in table.columns else None
    views, numbers = [], []
    for (image, camera), rows in _by_image(table, path.name, cameras).items():
        _refuse_repeats(table.rows(rows), image, points[rows], None if ids is None else ids[rows])
        spread = None if covariance is None else covariance[rows]
        named = camera if image_size is sizes else None
        views.append(Correspondences(image, points[rows], pixels[rows], spread, named))
        numbers.append(readonly(np.arange(len(rows)) if ids is None else ids[rows], (None,), "ids", np.intp))
    return PointViews(tuple(views), tuple(numbers), covariance is not None and "weight" not in table.columns)


def _table(path: Path) -> Table:
    suffix = files.suffix_of(path)
    if suffix in (*JSON, *YAML):
        document = load_either(path, mapping({"points": _check_points}), _MAX_VALUES)
        points = document["points"]
        names = list(points[0]) if points else list(COLUMNS)
        rows = [[str(point[name]) for name in names] for point in points]
        places = (f"points[{index}]" for index in range(len(points)))
        lines = [document.line(place) if document.lines else place for place in places]
        return Table.of_rows(document.where, names, rows, lines)
    return Table.from_csv(str(path), numbered_lines(path), COLUMNS, OPTIONAL)


def _check_points(points: Any, path: str) -> Iterator[Fault]:
    """Check that YAML or JSON holds a list of points which all have the same keys."""
    if not isinstance(points, list):
        yield Fault(path, "expected a list of mappings with X, Y, Z, u, v")
        return
    point = mapping(dict.fromkeys(COLUMNS, _scalar), dict.fromkeys(OPTIONAL, _scalar))
    for index, item in enumerate(points):
        place = child(path, index)
        faults = list(point(item, place))
        yield from faults
        if not faults and set(item) != set(points[0]):
            odd = min(set(item) ^ set(points[0]))
            yield Fault(place, f"{odd!r} is given for some points only; give it for all or none")


def _scalar(value: Any, path: str) -> Iterator[Fault]:
    if isinstance(value, bool) or not isinstance(value, (int, float, str)):
        yield Fault(path, "is not a number or text")


def _weighty(table: Table) -> Table:
    """Return the rows that count: all but those of weight 0."""
    if "weight" not in table.columns or not len(table):
        return table
    weights = table.numbers("weight")
    table.refuse(weights < 0, lambda row: f"weight {weights[row]:g} is negative")
    _refuse_beyond(table, weights, "weight {:g}")
    return table.rows(np.flatnonzero(weights > 0))


def _only_camera(table: Table) -> str:
    """Return what the column `camera` names, an empty text without one."""
    names = sorted(set(table.columns.get("camera", ())))
    if len(names) > 1:
        raise InvalidInput(f"holds points of several cameras ({', '.join(names)}): give --rig", where=table.path)
    return names[0] if names else ""


def _cameras(table: Table, sizes: Mapping[str, Size]) -> Sequence[str]:
    """Return the camera of every row."""
    if "camera" not in table.columns:
        if len(sizes) > 1:
            raise InvalidInput(f"points of a rig need a column camera: {', '.join(sizes)}", where=table.path)
        return [*sizes] * len(table)
    names = table.columns["camera"]
    unknown = np.array([name not in sizes for name in names])
    table.refuse(unknown, lambda row: f"camera {names[row]!r} is unknown; the rig has {', '.join(sizes)}")
    return names


def _by_image(table: Table, name: str, cameras: Sequence[str]) -> dict[tuple[str, str], Array]:
    """Return the rows of every image and camera, in the order in which they first stand."""
    images = table.columns.get("image", [name] * len(table))
    rows: dict[tuple[str, str], list[int]] = {}
    for row, key in enumerate(zip(images, cameras, strict=True)):
        rows.setdefault(key, []).append(row)
    return {key: np.array(chosen) for key, chosen in rows.items()}


def _covariance(table: Table) -> Array | None:
    """Return the covariances (N, 2, 2) in px², or up to a factor from weights; None without any such column."""
    ways = [way for way in (("sigma",), COVARIANCE, ("weight",)) if set(way) & set(table.columns)]
    if not ways:
        return None
    if len(ways) > 1:
        given = " and ".join(",".join(way) for way in ways)
        raise InvalidInput(f"columns {given} are redundant; keep one of them", where=table.path)
    if ways[0] == COVARIANCE:
        return _full_covariance(table)
    if ways[0] == ("weight",):
        return np.asarray(np.eye(2) / table.numbers("weight")[:, None, None])
    sigma = table.numbers("sigma")
    table.refuse(sigma <= 0, lambda row: f"sigma {sigma[row]:g} px is not positive")
    _refuse_beyond(table, sigma, "sigma {:g} px")
    return np.asarray(np.eye(2) * sigma[:, None, None] ** 2)


def _full_covariance(table: Table) -> Array:
    missing = [name for name in COVARIANCE if name not in table.columns]
    if missing:
        raise InvalidInput(f"column {missing[0]!r} is missing; {','.join(COVARIANCE)} go together", where=table.path)
    for name in ("suu", "svv"):
        _refuse_beyond(table, table.numbers(name), f"{name} {{:g}} px²")
    return pixel_covariances(table)


def _refuse_beyond(table: Table, values: Array, named: str) -> None:
    """Refuse sizes (N,) that are not 0 and so large or small that nothing can be computed with them."""
    sizes = np.abs(values)
    beyond = (sizes > 0) & ((sizes > BEYOND) | (sizes < 1 / BEYOND))
    table.refuse(beyond, lambda row: f"{named.format(values[row])} is implausible")


def _refuse_outside(table: Table, pixels: Array, sizes: Array) -> None:
    table.refuse(
        far_outside(pixels, sizes),
        lambda row: (
            f"({pixels[row, 0]:g}, {pixels[row, 1]:g}) is far outside the camera's image of "
            f"{sizes[row, 0]} x {sizes[row, 1]}; check the order of u and v, the image size and the camera"
        ),
    )


def _refuse_repeats(table: Table, image: str, points: Array, ids: Array | None) -> None:
    """Refuse a point that occurs twice in one image, by its id or by its coordinates."""
    if ids is not None:
        table.refuse(_repeated(ids[:, None]), lambda row: f"image {image!r}: id {ids[row]} occurs twice")
    named = "({:g}, {:g}, {:g})"
    table.refuse(_repeated(points), lambda row: f"image {image!r}: the point {named.format(*points[row])} occurs twice")


def _repeated(values: Array) -> Array:
    """Return the mask (N,) of rows (N, D) that are equal to an earlier one."""
    first = np.unique(values, axis=0, return_index=True)[1]
    return ~np.isin(np.arange(len(values)), first)


@dataclass(frozen=True, eq=False)
class PointTable:
    """Points (N, 3), their normals (N, 3) and covariances (N, 3, 3) or None, in the unit of the table and its square.

    NaN where a cell is empty. table: all columns as they stand in the file.
    """

    table: Table
    points: Array
    normals: Array | None = None
    covariances: Array | None = None


def read_point_table(path: Path) -> PointTable:
    """Return the points of a CSV whose first row names its columns; lines that begin with # are left out.

    Raises FileError, InvalidInput with file and line for a missing column, what is no number or infinite, and a
    variance below zero.
    """
    lines = [(number, line) for number, line in numbered_lines(path) if not line.startswith("#")]
    rows = csv_rows(str(path), lines)
    names = [name.strip() for name in rows[0]] if rows else []
    lower = [name.lower() for name in names]
    if any(lower.count(name) != 1 for name in POSITION):
        raise InvalidInput(f"the first row names the columns, x, y, z once among them; found {names}", where=str(path))
    if len(set(lower)) < len(lower):
        raise InvalidInput(f"column {max(lower, key=lower.count)!r} occurs twice", where=str(path))
    table = Table.of_rows(str(path), names, rows[1:], [number for number, _ in lines[1:]])
    covariances = _columns(table, SPACE_COVARIANCE)
    points = _columns(table, POSITION)
    assert points is not None  # the columns are there
    return PointTable(table, points, _columns(table, NORMAL), None if covariances is None else _full(covariances))


def write_point_table(path: Path, points: PointTable) -> None:
    """Write the table with these points, normals and covariances in the place of its own, numbers with 12 digits."""
    columns = dict(points.table.columns)
    for names, values in (
        (POSITION, points.points),
        (NORMAL, points.normals),
        (SPACE_COVARIANCE, None if points.covariances is None else points.covariances[:, *_UPPER]),
    ):
        for name, column in zip(names, () if values is None else values.T, strict=values is not None):
            columns[_find_column(columns, name)] = [
                "" if np.isnan(value) else f"{value + 0.0:.12g}" for value in column
            ]
    rows = [list(columns), *zip(*columns.values(), strict=True)]
    files.write_text(path, "".join(",".join(map(cell, row)) + "\n" for row in rows))


def _find_column(columns: Iterable[str], name: str) -> str:
    """Return how the table writes a column's name, or the name if it has none such."""
    return next((known for known in columns if known.lower() == name), name)


def _columns(table: Table, names: Sequence[str]) -> Array | None:
    """Return columns of numbers (N, len(names)), None if the table has none of them; raises InvalidInput for some."""
    known = [_find_column(table.columns, name) for name in names]
    missing = [name for name in known if name not in table.columns]
    if len(missing) == len(names):
        return None
    if missing:
        raise InvalidInput(f"column {missing[0]!r} is missing; needed with {', '.join(names)}", where=table.path)
    columns = [table.numbers_or_empty(name) for name in known]
    for name, column in zip(known, columns, strict=True):
        if name.lower() in _VARIANCES:
            _refuse_negative(table, name, column)
    return np.column_stack(columns)


def _refuse_negative(table: Table, name: str, column: Array) -> None:
    table.refuse(column < 0, lambda row: f"{name}: {table.columns[name][row]} is not a variance")


def _full(upper: Array) -> Array:
    """Return matrices (N, 3, 3) of their upper triangles (N, 6)."""
    result = np.empty((len(upper), 3, 3))
    result[:, *_UPPER] = upper
    result[:, _UPPER[1], _UPPER[0]] = upper
    return result
