"""The page of a cloud: its bytes, and what a browser makes of them.

Chromium draws with software here; that other browsers and graphics cards agree is not tested.
"""

import json
import re
import zlib
from base64 import b64encode
from hashlib import sha256

import numpy as np
import pytest
from chromium import running
from clouds import BLUE, RED, ROS, in_ros, middle_of, scene_of, stream_of, two_squares

from camcal.report.cloud_scene import gather
from camcal.report.cloud_view import Start, pack, page

SIZE = (640, 480)
MIDDLE = (320, 240)
IN_RED = 40 * 80 + 40
FIRST_OF_BLUE = 80 * 80


def facts_of(text):
    return json.loads(re.search(r'id="facts">(.*?)</script>', text)[1])


def part_of(text, name):
    return re.search(rf'id="{name}">(.*?)</script>', text)[1]


def test_the_same_cloud_gives_the_same_bytes():
    one, two = (page(scene_of(*two_squares()), "two", Start("image")) for _ in range(2))
    assert one == two


def test_the_page_names_no_other_file():
    text = page(scene_of(*two_squares()), "two", Start("image"))
    assert not re.search(r"https?://|src=|href=|@import|url\(", text)


def test_the_page_allows_its_own_script_and_style_and_no_other():
    text = page(scene_of(*two_squares()), "two", Start("image"))
    policy = re.search(r'Content-Security-Policy" content="(.*?)"', text)[1]
    allowed = re.findall(r"(script|style)-src 'sha256-(.*?)'", policy)
    elements = re.findall(r'<(script|style)(?: type="module")?>(.*?)</', text, re.DOTALL)
    hashes = [(name, b64encode(sha256(content.encode()).digest()).decode()) for name, content in elements]
    assert sorted(allowed) == sorted(hashes)
    assert len(hashes) == 2
    assert "unsafe" not in policy


def test_a_title_is_text_whatever_it_holds():
    text = page(scene_of(*two_squares()), "</title><script>alert(1)</script>", Start("image"))
    assert "<script>alert" not in text


def test_a_frame_in_words_cannot_end_the_element_it_stands_in():
    text = page(scene_of(*two_squares(), frame="</script><b>"), "two", Start("image"))
    assert facts_of(text)["statistics"].endswith("frame: </script><b>")


@pytest.mark.parametrize("in_order", [True, False])
def test_400_000_points_fit_into_4_mb(in_order):
    rng = np.random.default_rng(5)
    v, u = np.mgrid[:500, :800]
    depth = 2 + np.sin(u / 90) * np.cos(v / 70) + rng.normal(0, 0.01, u.shape)
    points = np.stack([(u - 400) / 500 * depth, (v - 250) / 500 * depth, depth], axis=-1).reshape(-1, 3)
    order = np.arange(len(points)) if in_order else rng.permutation(len(points))
    colours = rng.integers(0, 40, (len(points), 3)) + np.array([90, 80, 60])
    text = page(scene_of(points[order], colours[order], 0.01 * points[order, 2] ** 2), "full", Start("image"))
    assert facts_of(text)["packed"]["count"] == 400_000
    assert len(text.encode()) <= 4e6


def test_what_is_thinned_and_what_is_exact_is_said():
    points, *_ = two_squares()
    text = page(gather(stream_of(points), most=1000), "two", Start("depth"))
    assert facts_of(text)["statistics"].startswith(
        "1 000 of 12 800 points, taken evenly".replace(" 000", "\u202f000").replace(" 800", "\u202f800")
    )
    assert re.search(r"stored to ±\S+ m \(resolution of this page, not accuracy\)", facts_of(text)["statistics"])


def test_planes_hold_differences_of_steps():
    points, colours, _ = two_squares()
    packed = pack(scene_of(points, colours))
    planes = np.frombuffer(zlib.decompress(packed.content), np.uint8).reshape(9, -1)
    x = np.cumsum(planes[0] + 256 * planes[1].astype(np.int64)) % 65536
    np.testing.assert_allclose(packed.origin[0] + packed.step[0] * x, points[:, 0], atol=packed.step[0])
    np.testing.assert_array_equal(np.cumsum(planes[6]) % 256, colours[:, 1])


def test_sigma_is_kept_to_its_share():
    sigma = np.geomspace(0.001, 0.3, 12800)
    sigma[5] = np.nan
    packed = pack(scene_of(two_squares()[0], sigma=sigma))
    codes = np.frombuffer(zlib.decompress(packed.content), np.uint8)[-12800:].astype(int)
    assert codes[5] == 0
    low, ratio = packed.sigma
    known = np.isfinite(sigma)
    # 254 equal ratios over a factor of 300: half a step is 1.1 %.
    np.testing.assert_allclose(low * ratio ** (codes[known] - 1.0), sigma[known], rtol=0.0115)


@pytest.fixture(scope="module")
def browser():
    with running(SIZE) as chromium:
        yield chromium


@pytest.fixture
def opened(browser, tmp_path):
    """A function that opens the page of a cloud and gives the browser when all is drawn."""

    def show(scene, start=None):
        path = tmp_path / "cloud.html"
        path.write_text(
            page(scene, "cloud.ply", start or Start("image" if scene.colours is not None else "depth")),
            encoding="utf-8",
        )
        browser.call("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": "light"}])
        browser.open(path)
        assert browser.evaluate("camcalView.ready") == len(scene.points)
        return browser

    return show


@pytest.fixture
def squares(opened):
    return opened(scene_of(*two_squares()))


def project(browser, index):
    x, y, _ = browser.evaluate(f"camcalView.project({index})")
    return x, y


def test_a_page_opens_from_disk_and_complains_of_nothing(squares):
    squares.wait_until_drawn()
    assert squares.complaints == []
    assert squares.evaluate("document.getElementById('failure').hidden")
    assert squares.evaluate("document.title") == "cloud.ply"


def test_colours_are_where_the_points_are(squares):
    squares.evaluate("document.querySelectorAll('.panel, #drawing').forEach((part) => part.style.display = 'none')")
    pixels = squares.screenshot()
    for colour, first in ((RED, 0), (BLUE, FIRST_OF_BLUE)):
        x, y, count = middle_of(pixels, colour, tolerance=10)
        corners = [project(squares, first), project(squares, first + 80 * 80 - 1)]
        assert (x, y) == pytest.approx(np.mean(corners, axis=0), abs=3)  # seen at a slight angle
        # The square is closed: as many pixels as its corners enclose.
        width, height = np.abs(np.subtract(*corners))
        assert count == pytest.approx(width * height, rel=0.05)


def test_points_arrive_as_exactly_as_the_page_says(squares):
    points, *_ = two_squares()
    step = facts_of(page(scene_of(*two_squares()), "", Start("image")))["packed"]["step"]
    chosen = list(range(0, len(points), 97))
    found = squares.evaluate(f"Promise.all({chosen}.map((i) => camcalView.point(i)))")
    assert np.all(np.abs(np.array(found) - points[chosen]) <= np.multiply(0.501, step))


def test_two_clicks_measure_the_true_distance(squares):
    points, *_ = two_squares()
    first, second = IN_RED, FIRST_OF_BLUE + 40 * 80 + 10
    for index in (first, second):
        squares.click(*project(squares, index))
    assert squares.evaluate("camcalView.chosen()") == [first, second]
    measured = squares.evaluate(f"camcalView.measure({first}, {second})")
    true = np.linalg.norm(points[first] - points[second])
    assert abs(measured["distance"] - true) <= measured["error"] < 1e-4
    said = squares.evaluate("document.getElementById('measured').textContent")
    assert float(re.match(r"[\d.]+", said)[0]) == pytest.approx(true, abs=measured["sigma"] / 10)
    assert re.match(r"[\d.]+ ± [\d.]+ m ", said)
    squares.key("Escape")
    assert squares.evaluate("document.getElementById('measured').hidden")


@pytest.mark.slow
def test_the_sigma_of_a_distance_is_that_of_both_points_along_it(squares):
    points, _, sigma = two_squares()
    first, second = 3000, 9000
    along = (points[second] - points[first]) / np.linalg.norm(points[second] - points[first])
    moves = [along @ points[index] / points[index, 2] * sigma[index] for index in (first, second)]
    measured = squares.evaluate(f"camcalView.measure({first}, {second})")
    assert measured["sigma"] == pytest.approx(np.hypot(*moves), rel=0.02)  # sigma has 8 bits in the page


def test_points_that_are_hidden_are_not_picked(opened):
    near, far = two_squares()[0][:6400] * [1, 1, 1], two_squares()[0][:6400] * [1.5, 1.5, 1.5]
    browser = opened(scene_of(np.concatenate([far, near])))
    browser.click(*project(browser, 6400 + 3000))
    assert browser.evaluate("camcalView.chosen()") == [6400 + 3000]


def test_colouring_by_depth_changes_the_points_and_shows_a_legend(squares):
    before = squares.screenshot()
    assert squares.evaluate("document.getElementById('legend').hidden")
    squares.evaluate("camcalView.colourBy('depth')")
    after = squares.screenshot()
    assert middle_of(after, RED, tolerance=10)[2] < 0.01 * middle_of(before, RED, tolerance=10)[2]
    assert not squares.evaluate("document.getElementById('legend').hidden")
    near, far = ([round(part) for part in project(squares, index)] for index in (IN_RED, FIRST_OF_BLUE + IN_RED))
    assert after[near[1], near[0]].tolist() == [48, 18, 59]  # the two ends of turbo
    assert after[far[1], far[0]].tolist() == [122, 4, 3]


def test_the_legend_covers_the_status_line_at_no_width(squares):
    squares.evaluate("camcalView.colourBy('sigma')")
    box = (
        "(({{left, right, top, bottom}}) => [left, right, top, bottom])"
        "(document.querySelector('{}').getBoundingClientRect())"
    )
    try:
        for width in (400, 700, 1000):
            squares.resize(width, 480)
            legend, footer = (squares.evaluate(box.format(part)) for part in ("#legend", "footer"))
            assert footer[1] <= legend[0], (width, footer, legend)
            assert legend[1] <= width
    finally:
        squares.resize(*SIZE)


def test_colouring_by_sigma_and_gray(squares):
    place = [round(part) for part in project(squares, IN_RED)]
    squares.evaluate("camcalView.colourBy('sigma')")
    assert squares.screenshot()[place[1], place[0]].tolist() == [48, 18, 59]
    squares.evaluate("camcalView.colourBy('gray')")
    assert np.ptp(squares.screenshot()[place[1], place[0]].astype(int)) == 0


def test_a_cloud_without_colours_offers_none(opened):
    browser = opened(scene_of(two_squares()[0]))
    offered = browser.evaluate("[...document.getElementById('colour').options].map((option) => option.value)")
    assert offered == ["depth", "gray"]


def test_dragging_turns_the_wheel_zooms_and_a_key_brings_it_back(squares):
    before = squares.screenshot()
    start = np.array([project(squares, index) for index in (0, FIRST_OF_BLUE)])
    squares.drag(MIDDLE, (220, 240))
    turned = np.array([project(squares, index) for index in (0, FIRST_OF_BLUE)])
    # The viewer goes to the right: what is near moves to the left of what is far.
    assert (turned[0] - turned[1])[0] < (start[0] - start[1])[0] - 20
    assert (squares.screenshot() != before).any()
    squares.key("r")
    squares.mouse("mouseWheel", *MIDDLE, deltaX=0, deltaY=-200)
    squares.wait_until_drawn()
    closer = np.array([project(squares, index) for index in (0, 79)])
    assert np.linalg.norm(np.diff(closer, axis=0)) > 1.1 * np.linalg.norm(
        np.subtract(start[0], project_at_start(squares, 79))
    )
    squares.key("r")
    np.testing.assert_array_equal(squares.screenshot(), before)


def project_at_start(browser, index):
    browser.key("r")
    return project(browser, index)


@pytest.mark.slow
def test_two_fingers_zoom(squares):
    def touch(kind, half):
        points = (
            []
            if kind == "touchEnd"
            else [{"x": 320 + side * half, "y": 240, "id": i} for i, side in enumerate((-1, 1))]
        )
        squares.call("Input.dispatchTouchEvent", type=kind, touchPoints=points)

    before = np.linalg.norm(np.subtract(project(squares, 0), project(squares, 79)))
    touch("touchStart", 50)
    for half in (60, 80, 100):
        touch("touchMove", half)
    touch("touchEnd", 0)
    squares.wait_until_drawn()
    after = np.linalg.norm(np.subtract(project(squares, 0), project(squares, 79)))
    assert after > 1.5 * before


@pytest.mark.parametrize(("key", "axes"), [("f", (0, 1)), ("t", (0, 2)), ("s", (2, 1))])
def test_keys_look_from_front_top_and_side(squares, key, axes):
    squares.key(key)
    points, *_ = two_squares()
    first, last = 0, len(points) - 1
    right, down = np.subtract(project(squares, last), project(squares, first))
    moved = points[last] - points[first]
    scale = right / moved[axes[0]]
    assert scale > 0
    assert down == pytest.approx(scale * moved[axes[1]] * (-1 if key == "t" else 1), abs=0.1)


def test_a_dark_desktop_has_a_dark_page(squares):
    light = squares.screenshot()[240, 5].astype(int).sum()
    squares.call("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": "dark"}])
    dark = squares.screenshot()[240, 5].astype(int).sum()
    assert (light > 600, dark < 150) == (True, True)


@pytest.mark.slow
def test_a_cloud_in_another_frame_looks_the_same(opened):
    points, colours, sigma = two_squares()
    optical = opened(scene_of(points, colours, sigma)).screenshot()
    browser = opened(scene_of(in_ros(points), colours, sigma, frame=ROS))
    ros = browser.screenshot()
    for colour in (RED, BLUE):
        assert middle_of(ros, colour, 10) == pytest.approx(middle_of(optical, colour, 10), abs=3, rel=0.01)
    assert browser.evaluate("camcalView.point(0)") == pytest.approx(in_ros(points)[0].tolist(), abs=1e-4)


def test_a_cloud_around_the_origin_is_seen_from_outside(opened):
    ball = np.random.default_rng(2).normal(size=(20_000, 3))
    ball /= np.linalg.norm(ball, axis=1)[:, None]
    browser = opened(scene_of(ball, RED))
    x, y, count = middle_of(browser.screenshot(), RED, tolerance=10)
    assert (x, y) == pytest.approx(MIDDLE, abs=6)
    assert count > 30_000  # a disc with a diameter of some 200 pixels is closed


def test_a_single_point_is_shown(opened):
    browser = opened(scene_of([(0.5, 0.2, 3.0)], RED))
    assert middle_of(browser.screenshot(), RED, tolerance=10)[2] > 0
    assert browser.complaints == []


def test_a_page_may_begin_with_another_view_and_larger_points(opened):
    browser = opened(scene_of(*two_squares()), Start("depth", "top", 2.0))
    assert browser.evaluate("document.getElementById('parallel').getAttribute('aria-pressed')") == "true"
    assert browser.evaluate("document.getElementById('size').value") == "1"
    assert browser.evaluate("document.getElementById('colour').value") == "depth"


def test_a_browser_without_webgl_says_so(browser, tmp_path):
    path = tmp_path / "cloud.html"
    path.write_text(page(scene_of(*two_squares()), "two", Start("image")), encoding="utf-8")
    script = "HTMLCanvasElement.prototype.getContext = () => null"
    added = browser.call("Page.addScriptToEvaluateOnNewDocument", source=script)["identifier"]
    browser.open(path)
    browser.evaluate("camcalView.ready.catch(() => 0)")
    browser.call("Page.removeScriptToEvaluateOnNewDocument", identifier=added)
    assert "WebGL" in browser.evaluate("document.getElementById('failure').textContent")
