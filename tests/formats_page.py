"""The tables of lens models and camera formats in docs/formats.md, as models and formats describe themselves.

generated_pages.py writes them.
"""

from collections.abc import Iterable
from pathlib import Path

from camcal.cameras.catalogue import MODELS
from camcal.cameras.lens import CameraModel
from camcal.formats.cameras import FORMATS
from camcal.formats.cameras.record import CameraFormat
from camcal.formats.native_entry import CORE

PAGE = Path(__file__).parents[1] / "docs" / "formats.md"
_LENSES, _FORMATS, _END = "<!-- lens models -->\n", "<!-- camera formats -->\n", "<!-- end -->"


def row(model: CameraModel) -> str:
    """Return a model's row of the table."""
    others = ", ".join(f"`{alias}`" for alias in model.aliases)
    parameters = " ".join(name for name in model.parameter_names if name not in CORE)
    return f"| `{model.name}` | {parameters or 'none'} | {model.summary} | {others} |"


def with_models(page: str, models: Iterable[CameraModel]) -> str:
    """Return the page with a row for every model."""
    return _with_table(
        page, _LENSES, ["| model | `distortion` | | other names |", "|---|---|---|---|", *map(row, models)]
    )


def format_row(form: CameraFormat) -> str:
    """Return a camera format's row of the table."""
    suffixes = " ".join(f"`{suffix}`" for suffix in form.suffixes)
    lenses = "all" if set(form.models) == set(MODELS) else " ".join(f"`{name}`" for name in form.models)
    cameras = "any number" if form.most_cameras is None else f"up to {form.most_cameras}"
    return f"| {form.title} | `{form.name}` | {suffixes} | {cameras} | {lenses} |"


def with_formats(page: str, forms: Iterable[CameraFormat]) -> str:
    """Return the page with a row for every camera format."""
    head = ["| format | `--to` | written as | cameras | lens models written |", "|---|---|---|---|---|"]
    return _with_table(page, _FORMATS, [*head, *map(format_row, forms)])


def _with_table(page: str, start: str, lines: Iterable[str]) -> str:
    before, _, rest = page.partition(start)
    return before + start + "\n".join([*lines, ""]) + _END + rest.partition(_END)[2]


def generated() -> dict[Path, str | None]:
    """Return the text of the page."""
    return {PAGE: with_formats(with_models(PAGE.read_text(encoding="utf-8"), MODELS.values()), FORMATS.values())}
