"""The report page as HTML: valid, complete, without the network, with everything escaped that comes from files."""

import re
from dataclasses import replace
from itertools import pairwise

import html5lib
import pytest
from report_scenes import SCENES, detections_of

from camcal.errors import InsufficientData
from camcal.formats import detections
from camcal.report.page.record import DataBlock, Figure, Page, PageVerdict, Section, ShownMessage, Table, rendered
from camcal.tasks.calibration.calibrate import calibrate
from camcal.tasks.calibration.options import CalibrateOptions

HOSTILE = "<img src=x onerror=alert(1)>\"'&{{7*7}}</script>"
QUICK = {"model": "opencv4", "flat_board": True, "free_corners": False}


def hostile(name):
    return f"{HOSTILE}{name}"


def written(folder, scene, rename, **how):
    found = detections_of(scene, 12)
    found = replace(found, views=tuple(replace(view, image=rename(view.image)) for view in found.views))
    table, page = folder / "corners.csv", folder / "report.html"
    detections.write(table, found)
    try:
        calibrate(CalibrateOptions((str(table),), report=page, **how))
    except InsufficientData as error:
        assert error.failures  # noqa: PT017 - the page of a refusal is written all the same
    return page.read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    return written(tmp_path_factory.mktemp("good"), SCENES["good"], hostile, **QUICK)


@pytest.fixture(scope="module")
def refused(tmp_path_factory):
    return written(tmp_path_factory.mktemp("refused"), SCENES["wrong-board"], hostile, model="opencv5", name=HOSTILE)


@pytest.fixture(params=["good", "refused"])
def page(request):
    return request.getfixturevalue(request.param)


def tree_of(text):
    return html5lib.HTMLParser(strict=True, namespaceHTMLElements=False).parse(text)


def test_the_page_is_valid_html(page):
    with pytest.raises(html5lib.html5parser.ParseError):
        tree_of(page.replace("</main>", "</header>"))
    assert tree_of(page).find("body") is not None


def test_names_of_files_never_become_markup(page):
    assert HOSTILE not in page
    assert "{{7*7}}" in page, "a name is no template"
    images = [element.get("src") for element in tree_of(page).iter("img")]
    assert all(source.startswith("data:image/") for source in images)
    assert not [name for element in tree_of(page).iter() for name in element.attrib if str(name).startswith("on")]


def test_the_page_holds_nothing_that_runs_and_asks_for_nothing(page):
    tree = tree_of(page)
    policy = next(each.get("content") for each in tree.iter("meta") if each.get("http-equiv"))
    assert policy.startswith("default-src 'none'; img-src data:; style-src 'unsafe-inline'")
    assert {element.get("type") for element in tree.iter("script")} == {"application/json", "text/plain"}
    addresses = [value for element in tree.iter() for name, value in element.attrib.items() if name in ("src", "href")]
    assert all(address.startswith(("data:image/", "#")) for address in addresses)
    assert "url(" not in page
    assert "@import" not in page


def test_headings_are_in_order_and_ids_are_unique(page):
    tree = tree_of(page)
    levels = [int(element.tag[1]) for element in tree.iter() if re.fullmatch(r"h\d", str(element.tag))]
    assert levels[0] == 1
    assert all(after <= before + 1 for before, after in pairwise(levels))
    ids = [element.get("id") for element in tree.iter() if element.get("id")]
    assert len(ids) == len(set(ids))
    targets = {element.get("href")[1:] for element in tree.iter("a")}
    assert targets <= set(ids)


def test_tables_have_scopes_and_pictures_have_texts(good):
    tree = tree_of(good)
    assert all(element.get("scope") in ("row", "col") for element in tree.iter("th"))
    pictures = list(tree.iter("img"))
    assert len(pictures) == 2 * 9
    assert all(len(element.get("alt")) > 20 for element in pictures)


def test_the_verdict_comes_first_with_its_reason_and_what_to_do(good, refused):
    assert (
        good.index("Trustworthy</h2>") < good.index("Key figures") < good.index("Projection uncertainty and coverage")
    )
    assert refused.index("No calibration</h2>") < refused.index("What to do:</b> Check columns, rows") < 20_000


def test_failures_come_before_the_key_figures_and_warnings_after_them():
    failure, warning = (ShownMessage(level, "", f"This is a {level}.") for level in ("failure", "warning"))
    page = bare(figures=(Figure("Views", "3"),), messages=(failure, warning))
    html = rendered(page)
    assert html.index("This is a failure.") < html.index("Key figures") < html.index("This is a warning.")
    assert html.count("This is a ") == 2


@pytest.mark.parametrize(("count", "folded"), [(2, 0), (3, 0), (4, 1), (7, 4)])
def test_three_warnings_are_shown_and_the_others_folded(count, folded):
    messages = tuple(ShownMessage("warning", "", f"Number {index}.") for index in range(count))
    html = rendered(bare(messages=messages))
    assert (f"<summary>{folded} more</summary>" in html) == bool(folded)
    inside = html[html.index("<details>") : html.index("</details>")] if folded else ""
    assert [f"Number {index}." in inside for index in range(count)] == [False] * min(count, 3) + [True] * folded


def test_sections_come_in_the_order_in_which_they_are_read(good):
    titles = re.findall(r"<h2 id=\"[\w-]+\">(?:<svg.*?</svg>)?([^<]+)</h2>", good, flags=re.DOTALL)
    assert [title.strip() for title in titles] == [
        "Trustworthy",
        "Key figures",
        "Projection uncertainty and coverage",
        "Residuals",
        "Board shape",
        "Poses",
        "Images",
        "Parameters",
        "Checks",
        "Provenance",
        "How to repeat it",
    ]


def bare(**changes):
    page = Page("T", "S", PageVerdict("good", "H", "W"), (), (), (Section("s", "S"),), "camcal 0")
    return replace(page, **changes)


def test_a_data_block_with_markup_is_refused():
    assert "x-data" in rendered(bare(blocks=(DataBlock("x-data", "text/plain", "abc"),)))
    with pytest.raises(ValueError, match="markup in a data block"):
        rendered(bare(blocks=(DataBlock("x-data", "text/plain", "</script>"),)))


def test_a_table_without_rows_is_its_caption():
    table = Table.of("No correlation is beyond ± 0.9", ("parameters", "correlation"), [], folded=True)
    text = rendered(bare(sections=(Section("s", "S", tables=(table,)),)))
    assert "<p>No correlation is beyond ± 0.9.</p>" in text
    assert "<table" not in text
    tree_of(text)


def test_columns_of_numbers_are_told_from_names():
    table = Table.of("c", ("name", "value", "std"), [["left", "1.5", "0.1"], ["2nd", "3e-05", "fixed"], ["r", "2", ""]])
    assert table.numeric == [False, True, False]
