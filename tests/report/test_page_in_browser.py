"""Report pages in Chromium: at three widths, in both themes and on paper, without a complaint or a request."""

import base64

import numpy as np
import pypdfium2
import pytest
from chromium import running
from report_scenes import SCENES, detections_of

from camcal.formats import detections
from camcal.tasks.calibration.calibrate import calibrate
from camcal.tasks.calibration.options import CalibrateOptions

pytestmark = pytest.mark.slow
WIDTHS = (400, 800, 1400)
LEAST_CONTRAST = 4.5  # WCAG 2.2, 1.4.3

# Every text with its colour and that of the nearest background behind it.
TEXTS = """[...document.querySelectorAll("body *")].filter((element) => element.offsetParent !== null
    && [...element.childNodes].some((node) => node.nodeType === 3 && node.data.trim())).map((element) => {
  let behind = element;
  const clear = (each) => getComputedStyle(each).backgroundColor === "rgba(0, 0, 0, 0)";
  while (behind.parentElement && clear(behind)) behind = behind.parentElement;
  const numbers = (text) => text.match(/[\\d.]+/g).map(Number).slice(0, 3);
  return [element.textContent.trim().slice(0, 30), numbers(getComputedStyle(element).color),
    numbers(getComputedStyle(behind).backgroundColor)];
})"""


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    folder = tmp_path_factory.mktemp("report")
    detections.write(folder / "corners.csv", detections_of(SCENES["moving-shutter"], 14))
    calibrate(CalibrateOptions((str(folder / "corners.csv"),), model="opencv5", report=folder / "report.html"))
    return folder / "report.html"


@pytest.fixture(scope="module")
def browser():
    with running((800, 900)) as chromium:
        yield chromium


@pytest.fixture(params=["light", "dark"])
def theme(request, browser):
    preference = {"name": "prefers-color-scheme", "value": request.param}
    browser.call("Emulation.setEmulatedMedia", media="", features=[preference])
    return request.param


def luminance(colour):
    share = np.array(colour) / 255
    linear = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    return float(linear @ [0.2126, 0.7152, 0.0722])


def contrast(one, other):
    low, high = sorted((luminance(one), luminance(other)))
    return (high + 0.05) / (low + 0.05)


@pytest.mark.parametrize("width", WIDTHS)
def test_the_page_fits_its_width_and_complains_of_nothing(browser, page, theme, width):
    browser.resize(width, 900)
    browser.open(page)
    assert browser.complaints == []
    assert browser.evaluate("document.documentElement.scrollWidth") == width
    drawn = "[...document.images].every((image) => image.complete && image.naturalWidth > 0)"
    assert browser.evaluate(drawn)
    corner = browser.screenshot()[-5, 5]
    assert (corner.min() > 200) == (theme == "light")


def test_what_is_said_can_be_read(browser, page, theme):
    browser.open(page)
    texts = browser.evaluate(TEXTS)
    assert len(texts) > 100
    assert contrast((255, 255, 255), (200, 200, 200)) < LEAST_CONTRAST, "the measure can fail"
    assert [text for text, ink, paper in texts if contrast(ink, paper) < LEAST_CONTRAST] == [], theme


def test_plots_follow_the_theme(browser, page, theme):
    browser.open(page)
    shown = "[...document.images].filter((image) => image.offsetParent !== null).map((image) => image.className)"
    kinds = browser.evaluate(shown)
    assert len(kinds) >= 8
    assert set(kinds) == {theme}


def test_a_verdict_is_said_by_words_and_a_sign_beside_its_colour(browser, page):
    browser.open(page)
    assert browser.evaluate("document.querySelector('.verdict h2').innerText.trim()") == "Trustworthy, with 1 warning"
    assert browser.evaluate("document.querySelector('.verdict h2 svg').getBoundingClientRect().width") > 15
    warnings = browser.evaluate("document.querySelector('[aria-labelledby=warnings]').innerText")
    assert "Hold camera and board still" in warnings


def test_the_page_prints_on_white_paper_without_cut_figures(browser, page, theme):
    browser.open(page)
    content = base64.b64decode(browser.call("Page.printToPDF", printBackground=True)["data"])
    document = pypdfium2.PdfDocument(content)
    assert 4 <= len(document) <= 20, theme
    printed = [document[index].render(scale=0.5).to_numpy() for index in range(3)]
    assert all((each[2, 2] > 250).all() for each in printed)
    assert all(np.mean(each < 60) < 0.15 for each in printed), "plots are those of the light theme"
    words = document[0].get_textpage().get_text_range()
    assert "Trustworthy" in words
    assert "Contents" not in words
    names = "figure h3"
    titles = browser.evaluate(f"[...document.querySelectorAll('{names}')].map((each) => each.innerText)")
    pages = [document[index].get_textpage().get_text_range() for index in range(len(document))]
    captions = browser.evaluate("[...document.querySelectorAll('.pictures figcaption')].map((each) => each.innerText)")
    for title, caption in zip(titles, captions, strict=False):
        at = [index for index, text in enumerate(pages) if title in text and caption.split()[0] in text]
        assert at, title
