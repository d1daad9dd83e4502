"""docs/messages.md as the code describes its messages.

generated_pages.py writes it.
"""

from collections.abc import Iterable, Mapping
from pathlib import Path

from camcal.messages import CODES
from camcal.quality.criteria import CRITERIA, Criterion

PAGE = Path(__file__).parents[1] / "docs" / "messages.md"
_START = "<!-- codes -->\n"


def with_codes(page: str, areas: Mapping[str, Mapping[str, str]], criteria: Iterable[Criterion]) -> str:
    """Return the page with a table for every area, and that of the criteria of a calibration."""
    parts = [page.partition(_START)[0] + _START.rstrip()]
    for area, codes in areas.items():
        rows = [f"| `{code}` | {meaning} |" for code, meaning in codes.items()]
        parts += ["", f"## {area}", "", "| code | meaning |", "|---|---|", *rows]
    rows = [
        f"| `{one.code}` | {'failure' if one.failure else 'warning'} | {one.means} | {one.limit:g} {one.unit} |"
        for one in criteria
    ]
    parts += ["", "## Calibration verdict", "", "| code | kind | criterion | limit |", "|---|---|---|---|", *rows]
    return "\n".join(parts) + "\n"


def generated() -> dict[Path, str | None]:
    """Return the text of the page."""
    return {PAGE: with_codes(PAGE.read_text(encoding="utf-8"), CODES, CRITERIA.values())}
