"""The table of lens models in docs/formats.md, as the models describe themselves.

Run as a script, this writes it anew.
"""

from collections.abc import Iterable
from pathlib import Path

from camcal.cameras.catalogue import MODELS
from camcal.cameras.model import CameraModel
from camcal.formats.native_entry import CORE

PAGE = Path(__file__).parents[1] / "docs" / "formats.md"
_START, _END = "<!-- lens models -->\n", "<!-- end -->"


def row(model: CameraModel) -> str:
    """Return a model's row of the table."""
    others = ", ".join(f"`{alias}`" for alias in model.aliases)
    parameters = " ".join(name for name in model.parameter_names if name not in CORE)
    return f"| `{model.name}` | {parameters or 'none'} | {model.summary} | {others} |"


def with_models(page: str, models: Iterable[CameraModel]) -> str:
    """Return the page with a row for every model."""
    before, _, rest = page.partition(_START)
    table = "\n".join(["| model | `distortion` | | other names |", "|---|---|---|---|", *map(row, models), ""])
    return before + _START + table + _END + rest.partition(_END)[2]


if __name__ == "__main__":
    PAGE.write_text(with_models(PAGE.read_text(encoding="utf-8"), MODELS.values()), encoding="utf-8")
