"""XYZ: a row of text per vertex, x y z and what else there is, with blanks between.

Files of x y z, with red green blue 0 … 255 and with intensity 0 … 1 behind them, in metres, are rows alone, as other
programs expect. Whatever rows alone would not tell stands in front of them: "# columns: …", "# unit: mm".
"""

from typing import BinaryIO

import numpy as np

from camcal.arrays import Array
from camcal.errors import FileError
from camcal.formats.pointclouds.record import PointCloudFile, blocks_of, from_comments, numbers_in, text_rows
from camcal.stereo.points.frames import COLOUR, INTENSITY, METRES, NORMAL, POSITION, VertexStream

_PLAIN: dict[int, tuple[str, ...]] = {
    3: POSITION,
    4: (*POSITION, INTENSITY),
    6: (*POSITION, *COLOUR),
    7: (*POSITION, *COLOUR, INTENSITY),
}
_WITH_NORMALS = (*POSITION, *NORMAL)
_COMMENT_MARKS = ("#", "//")


def write(file: BinaryIO, stream: VertexStream) -> None:
    """Write a cloud, block by block."""
    names = stream.type.names or ()
    if names not in _PLAIN.values() or not stream.count:
        file.write(f"# columns: {' '.join(names)}\n".encode())
    if stream.unit != METRES:
        file.write(f"# unit: {stream.unit}\n".encode())
    file.writelines(text_rows(blocks_of(stream)))


def read(content: bytes) -> PointCloudFile:
    """Return the vertices of rows of text with blanks, commas or semicolons between the numbers.

    Without a line "# columns: …" 3 numbers are x y z, 4 have the intensity, 6 the colour (normals, unless these three
    are whole numbers from 0 to 255), 7 colour and intensity; with another count all but x y z is left out.
    Raises FileError if the rows are no table of numbers.
    """
    lines = [line.strip() for line in content.decode("utf-8", "replace").splitlines()]
    remarks = [line.lstrip("#/ ") for line in lines if line.startswith(_COMMENT_MARKS)]
    rows = [line.replace(",", " ").replace(";", " ") for line in lines if not line.startswith(_COMMENT_MARKS)]
    numbers = numbers_in([row for row in rows if row.strip()])
    names = next((remark.split()[1:] for remark in remarks if remark.startswith("columns:")), None)
    columns = _columns(numbers, names) if len(numbers) else dict.fromkeys(names or POSITION, np.empty(0))
    remarks = [remark for remark in remarks if not remark.startswith("columns:")]
    return from_comments(columns, remarks)


def _columns(numbers: Array, names: list[str] | None) -> dict[str, Array]:
    count = numbers.shape[1]
    if names is not None and len(names) != count:
        raise FileError(f"the file names {len(names)} columns, its rows have {count}")
    if count < len(POSITION):
        raise FileError(f"a row has {count} numbers (minimum 3)")
    return dict(zip(names or _guessed(numbers), numbers.T, strict=False))


def _guessed(numbers: Array) -> tuple[str, ...]:
    names = _PLAIN.get(numbers.shape[1], POSITION)
    if set(COLOUR) <= set(names):
        colours = numbers[:, 3:6]
        if not np.all((colours >= 0) & (colours <= 255) & (colours == np.rint(colours))):
            return _WITH_NORMALS
    return names
