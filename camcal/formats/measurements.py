"""Tables of numbers under names of the user's choice: what curves are fitted to, and numbers over time."""

from pathlib import Path

from camcal.errors import FileError, InvalidInput
from camcal.formats.tables import Table, csv_rows, numbered_lines
from camcal.parsing import is_number

COMMENT = "#"
_OTHERS = {";": "semicolons", "\t": "tabs", " ": "blanks"}


def read(path: Path) -> Table:
    """Return the table of a CSV file whose first row names the columns; lines that begin with # are left out.

    Raises FileError if the file cannot be read or has no rows, InvalidInput for rows of other lengths, for names that
    are numbers or stand twice, and for columns that are not separated by commas.
    """
    lines = [(number, line) for number, line in numbered_lines(path) if not line.lstrip().startswith(COMMENT)]
    rows = csv_rows(str(path), lines)
    if len(rows) < 2:
        raise FileError("no rows of numbers below a row of column names", where=str(path))
    names = [name.strip() for name in rows[0]]
    _check_names(f"{path}:{lines[0][0]}", names)
    return Table.of_rows(str(path), names, rows[1:], [number for number, _ in lines[1:]])


def _check_names(where: str, names: list[str]) -> None:
    if all(map(is_number, names)):
        raise InvalidInput("no column names; the first row is to name the columns, such as x,y", where=where)
    used = next((letter for letter in _OTHERS if len(names) == 1 and letter in names[0]), None)
    if used is not None:
        raise InvalidInput(
            f"one column, {names[0]!r}: columns are separated by commas, not {_OTHERS[used]}", where=where
        )
    if not all(names):
        raise InvalidInput(f"column {names.index('') + 1} has no name", where=where)
    if len(set(names)) < len(names):
        raise InvalidInput(f"column {max(names, key=names.count)!r} stands twice", where=where)
