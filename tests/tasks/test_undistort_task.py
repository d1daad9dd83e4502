"""Undistorting whole sets: what is written, what is kept, and what becomes of images that cannot be."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image as Pillow

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.cameras.validity import ImageCircle
from camcal.errors import FileError, InvalidInput
from camcal.formats import cameras, native
from camcal.formats.camera_file import CameraEntry, CameraFile, ValidRegion
from camcal.images.files import load, save
from camcal.images.image import Image
from camcal.images.options import ViewOptions
from camcal.images.remap import build_maps
from camcal.images.views import make_view
from camcal.tasks.calibration.drawing_options import UndistortOptions
from camcal.tasks.calibration.undistort import undistort

SIZE = (120, 80)
LENS = Camera(model_named("opencv5"), SIZE, np.array([90.0, 91, 61, 39, -0.25, 0.06, 1e-3, -1e-3, 0]))
CIRCLE = ImageCircle(SIZE, (60.0, 40.0), 27.0)
FISHEYE = Camera(model_named("kannala_brandt4"), SIZE, np.array([30.0, 30, 60, 40, 0, 0, 0, 0]))


def picture(seed=0, size=SIZE, channels=3, dtype=np.uint8):
    noise = np.random.default_rng(seed).random((*size[::-1], channels), np.float32)
    smooth = cv2.GaussianBlur(noise, (0, 0), 3).reshape(*size[::-1], channels)
    pixels = (smooth - smooth.min()) / np.ptp(smooth)
    pixels = pixels if dtype == np.float32 else (pixels * 250).astype(dtype)
    return pixels[:, :, 0] if channels == 1 else pixels


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder with camera.yaml and photos/1.png … 3.png, where the work is done."""
    monkeypatch.chdir(tmp_path)
    native.write(tmp_path / "lens.yaml", CameraFile({"left": CameraEntry(LENS), "fish": CameraEntry(FISHEYE)}))
    for number in (1, 2, 3):
        save(tmp_path / "photos" / f"{number}.png", picture(number))
    return tmp_path


def run(folder, *inputs, camera="lens.yaml#left", output="out", **options):
    given = [folder / name for name in inputs] or [folder / "photos"]
    return undistort(UndistortOptions(camera, folder / output, given, **options))


class Listener:
    """A progress that keeps the warnings."""

    def __init__(self):
        self.warnings = []

    def start(self, what, total):
        pass

    def advance(self, count=1):
        pass

    def finish(self):
        pass

    def warn(self, message):
        self.warnings.append(message)


def test_images_are_drawn_through_the_maps_of_the_view(folder):
    report = run(folder, view=ViewOptions(alpha=1))
    view = make_view(LENS, ViewOptions(alpha=1))
    maps = build_maps(LENS, view)
    for number in (1, 2, 3):
        np.testing.assert_array_equal(load(folder / "out" / f"{number}.png").pixels, maps.apply(picture(number)))
    assert report.valid == pytest.approx(maps.valid().mean())
    assert report.failed == ()


def test_the_camera_file_beside_them_is_the_camera_of_the_images(folder):
    report = run(folder)
    file = native.read(folder / "out" / "camera.yaml")
    camera = file.cameras["left"].camera
    assert camera.model.name == "pinhole"
    np.testing.assert_allclose(camera.parameters, report.view.parameters, rtol=1e-11)  # 12 digits
    assert file.provenance["command"].startswith("camcal undistort 'lens.yaml#left'")
    assert file.provenance["camera"]["name"] == "left"


def test_a_straight_line_of_the_world_is_straight_in_the_image(folder):
    depth = np.linspace(-0.5, 0.5, 400)
    line = LENS.project(np.column_stack([depth, 0.3 + 0.1 * depth, np.ones(400)])).pixels
    image = np.zeros((800, 1200), np.uint8)  # ten times finer, to draw it where it is
    cv2.polylines(image, [np.rint(10 * line + 4.5).astype(np.int32)], isClosed=False, color=255, thickness=10)
    save(folder / "line.png", cv2.resize(image, SIZE, interpolation=cv2.INTER_AREA))
    run(folder, "line.png")
    drawn = load(folder / "out" / "line.png").pixels.astype(float)
    columns = np.flatnonzero(drawn.sum(axis=0) > 100)
    rows = (drawn * np.arange(80)[:, None]).sum(axis=0)[columns] / drawn.sum(axis=0)[columns]
    slope = np.polyfit(columns[5:-5], rows[5:-5], 1)
    # drawing at a tenth of a pixel; the distorted line bends by more than a pixel
    np.testing.assert_allclose(rows[5:-5], np.polyval(slope, columns[5:-5]), atol=0.2)


@pytest.mark.parametrize(
    ("name", "dtype", "channels"),
    [("a.png", np.uint8, 4), ("a.png", np.uint16, 1), ("a.tiff", np.float32, 1), ("a.tiff", np.uint16, 3),
     ("a.npy", np.float32, 3), ("a.jpg", np.uint8, 1), ("a.bmp", np.uint8, 3), ("a.JPG", np.uint8, 3)],
)  # fmt: skip
def test_type_depth_and_channels_are_kept(folder, name, dtype, channels):
    save(folder / name, picture(4, channels=channels, dtype=dtype))
    report = run(folder, name)
    drawn = load(report.outcomes[0].value.output)
    assert report.outcomes[0].value.output.name == name
    assert (drawn.pixels.dtype, drawn.channels) == (dtype, channels)


@pytest.mark.parametrize(("name", "expected"), [("a.pgm", "a.pgm"), ("a.webp", "a.png"), ("a.pfm", "a.tiff")])
def test_types_that_are_not_written_become_one_that_is(folder, name, expected):
    cv2.imwrite(str(folder / name), picture(channels=1, dtype=np.float32 if name == "a.pfm" else np.uint8))
    assert run(folder, name).outcomes[0].value.output.name == expected


@pytest.mark.parametrize("suffix", [".jpg", ".png", ".tiff"])
def test_the_orientation_is_kept_once_and_never_applied(folder, suffix):
    save(folder / f"a{suffix}", Image(picture(5), 6))
    run(folder, f"a{suffix}")
    drawn = load(folder / "out" / f"a{suffix}")
    assert (drawn.orientation, drawn.size) == (6, SIZE)
    with Pillow.open(folder / "out" / f"a{suffix}") as found:
        assert found.getexif()[0x0112] == 6


def test_outputs_do_not_depend_on_the_number_of_jobs(folder):
    for number in range(4, 12):
        save(folder / "photos" / f"{number}.jpg", picture(number))
    run(folder, output="one", jobs=1)
    run(folder, output="four", jobs=4)
    names = [path.name for path in (folder / "one").iterdir()]
    assert len(names) == 13
    for name in names:
        assert (folder / "one" / name).read_bytes() == (folder / "four" / name).read_bytes()


def test_one_unreadable_image_is_listed_and_the_rest_is_written(folder):
    content = (folder / "photos" / "2.png").read_bytes()
    (folder / "photos" / "2.png").write_bytes(content[: len(content) // 2])
    (folder / "photos" / "notes.png").write_text("Dear diary")
    report = run(folder)
    assert [outcome.item.name for outcome in report.failed] == ["2.png", "notes.png"]
    assert all(isinstance(outcome.error, FileError) for outcome in report.failed)
    written = sorted(path.name for path in (folder / "out").iterdir())
    assert written == [".camcal-output", "1.png", "3.png", "camera.yaml"]


def test_when_no_image_can_be_drawn_the_first_reason_is_raised_and_nothing_is_written(folder):
    for number in (1, 2, 3):
        (folder / "photos" / f"{number}.png").write_text("Dear diary")
    with pytest.raises(FileError, match=r"1\.png: unknown image format.*3 images failed, none written"):
        run(folder)
    assert not (folder / "out").exists()


def test_an_image_of_another_size_is_refused_with_what_to_do(folder):
    save(folder / "photos" / "half.png", picture(size=(60, 40)))
    save(folder / "photos" / "crop.png", picture(size=(100, 80)))
    half, crop = (outcome.error for outcome in sorted(run(folder).failed, key=lambda outcome: -len(str(outcome.error))))
    assert "is 60x40, the camera 120x80: if it was resized, not cropped, give --scale-intrinsics" in str(half)
    assert str(crop).endswith("is 100x80, the camera 120x80")


def test_resized_images_are_undistorted_by_the_rescaled_camera(folder):
    save(folder / "large.png", picture(size=(240, 160)))
    report = run(folder, "large.png", scale_intrinsics=True)
    large = Camera(LENS.model, (240, 160), LENS.model.rescale(LENS.parameters, (2, 2), (0, 0)))
    np.testing.assert_allclose(report.view.parameters, make_view(large, ViewOptions()).parameters, rtol=1e-6)
    assert load(folder / "out" / "large.png").size == (240, 160)


def test_cropped_images_are_not_rescaled(folder):
    save(folder / "crop.png", picture(size=(100, 80)))
    with pytest.raises(InvalidInput, match="100x80 are not resized images of 120x80"):
        run(folder, "crop.png", scale_intrinsics=True)


def test_a_mask_says_which_pixels_have_a_source(folder):
    report = run(folder, view=ViewOptions(alpha=1), mask=True, border=(9.0,))
    mask = load(report.mask_file).pixels
    assert set(np.unique(mask)) == {0, 255}
    assert (load(folder / "out" / "1.png").pixels[mask == 0] == 9).all()


def test_a_second_run_does_not_read_what_the_first_wrote(folder):
    run(folder, output="photos/out", mask=True)
    report = undistort(UndistortOptions("lens.yaml#left", folder / "again", (str(folder / "photos"),), recursive=True))
    assert len(report.outcomes) == 3


@pytest.mark.parametrize("output", ["photos", "photos/../photos"])
def test_an_input_is_never_overwritten(folder, output):
    before = (folder / "photos" / "1.png").read_bytes()
    with pytest.raises(InvalidInput, match=r"1\.png: is an input and is not overwritten"):
        run(folder, output=output)
    assert (folder / "photos" / "1.png").read_bytes() == before


def test_the_camera_it_reads_is_not_overwritten(folder):
    (folder / "lens.yaml").rename(folder / "camera.yaml")
    with pytest.raises(InvalidInput, match=r"camera\.yaml: is an input"):
        run(folder, camera="camera.yaml#left", output=".")


def test_a_camera_file_of_somebody_else_is_kept(folder):
    (folder / "out").mkdir()
    for content in ((folder / "lens.yaml").read_text(), "shopping list"):
        (folder / "out" / "camera.yaml").write_text(content)
        with pytest.raises(InvalidInput, match="exists and was not written by camcal"):
            run(folder)
        assert (folder / "out" / "camera.yaml").read_text() == content


def test_what_lies_outside_of_the_image_circle_is_masked(folder):
    entry = CameraEntry(FISHEYE, valid=ValidRegion(image_circle=CIRCLE))
    native.write(folder / "circle.yaml", CameraFile({"fish": entry}))
    view = ViewOptions(projection="stereographic", fov_deg=170.0)
    report = run(folder, "photos/1.png", camera="circle.yaml", view=view, mask=True, border=(200.0,))
    x, y = np.meshgrid(np.arange(SIZE[0]), np.arange(SIZE[1]))
    rays = report.view.unproject(np.column_stack([x.ravel(), y.ravel()])).directions
    apart = np.hypot(*(FISHEYE.project(rays).pixels - CIRCLE.centre).T).reshape(SIZE[::-1])
    clear = np.abs(apart - CIRCLE.radius) > 0.01  # the maps are good to 1e-3 px
    mask = load(folder / "out" / "valid_mask.png").pixels
    np.testing.assert_array_equal(mask[clear] == 255, apart[clear] < CIRCLE.radius)
    assert 0.3 < report.valid < 0.7
    assert (load(folder / "out" / "1.png").pixels[mask == 0] == 200).all()


def test_the_crop_and_the_field_of_view_end_at_the_image_circle(folder):
    entry = CameraEntry(FISHEYE, valid=ValidRegion(image_circle=CIRCLE))
    native.write(folder / "circle.yaml", CameraFile({"fish": entry}))
    cropped = run(folder, camera="circle.yaml")
    assert cropped.valid == 1
    assert cropped.view.value("fx") > run(folder, camera="lens.yaml#fish", output="other").view.value("fx")
    spanning = run(folder, camera="circle.yaml", output="wide", view=ViewOptions(projection="cylinder"))
    assert SIZE[0] / spanning.view.value("fx") == pytest.approx(2 * 27 / 30, rel=0.01)  # of an equidistant lens


def test_a_resized_camera_has_its_image_circle_resized(folder):
    save(folder / "large.png", picture(1, (240, 160)))
    entry = CameraEntry(FISHEYE, valid=ValidRegion(image_circle=CIRCLE))
    native.write(folder / "circle.yaml", CameraFile({"fish": entry}))
    view = ViewOptions(projection="stereographic", fov_deg=170.0)
    usual = run(folder, "photos/1.png", camera="circle.yaml", view=view)
    large = run(folder, "large.png", camera="circle.yaml", output="large", view=view, scale_intrinsics=True)
    assert large.valid == pytest.approx(usual.valid, abs=0.01)  # by the pixels along the circle


def test_another_view_into_the_same_folder_is_warned_of_and_the_same_view_is_not(folder):
    listener = Listener()
    for alpha in (0.0, 0.0, 1.0):
        options = UndistortOptions(
            "lens.yaml#left", folder / "out", (str(folder / "photos"),), view=ViewOptions(alpha=alpha)
        )
        undistort(options, listener)
    assert sum(warning.code == "replaced_view" for warning in listener.warnings) == 1


def test_a_pinhole_that_shrinks_the_middle_is_warned_of(folder):
    listener = Listener()
    view = ViewOptions(fov_deg=170)
    undistort(UndistortOptions("lens.yaml#fish", folder / "out", (str(folder / "photos"),), view=view), listener)
    assert listener.warnings[-1].code == "reduced_scale"


def test_a_fisheye_becomes_a_panorama_that_other_commands_can_read(folder):
    view = ViewOptions(projection="equirectangular", size=(300, 150), fov_deg=360)
    run(folder, camera="lens.yaml#fish", view=view)
    camera = cameras.read_camera(folder / "out" / "camera.yaml")
    assert (camera.model.name, camera.image_size) == ("equirectangular", (300, 150))
    assert load(folder / "out" / "1.png").size == (300, 150)
    again = undistort(UndistortOptions("out/camera.yaml", folder / "back", ("out",), view=ViewOptions(fov_deg=60)))
    assert again.valid == 1


def test_two_images_of_one_name_are_refused(folder):
    save(folder / "other" / "1.png", picture())
    with pytest.raises(InvalidInput, match="would both be written to it"):
        run(folder, "photos", "other")


def test_a_camera_must_be_named_where_there_are_two(folder):
    with pytest.raises(InvalidInput, match="holds 2 cameras"):
        run(folder, camera="lens.yaml")
    assert run(folder, camera="lens.yaml", camera_name="left").failed == ()


@pytest.fixture
def video(folder):
    path = folder / "video.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 25, SIZE)
    if not writer.isOpened():
        pytest.skip("this OpenCV writes no video")
    for _ in range(12):
        writer.write(picture(1))
    writer.release()
    return path


def test_a_video_becomes_numbered_images(video, folder):
    report = run(folder, "video.avi", format="png")
    names = [outcome.value.output.name for outcome in report.outcomes]
    assert names == [f"video_{number:06d}.png" for number in range(12)]
    assert [outcome.value.frame for outcome in report.outcomes] == list(range(12))
    first, last = load(folder / "out" / names[0]).pixels, load(folder / "out" / names[-1]).pixels
    np.testing.assert_array_equal(first, last)


def test_a_video_of_another_size_is_one_failure_not_one_for_each_frame(video, folder):
    native.write(folder / "other.yaml", CameraFile({"a": CameraEntry(Camera(LENS.model, (64, 48), LENS.parameters))}))
    save(folder / "small.png", picture(size=(64, 48)))
    report = run(folder, "video.avi", "small.png", camera="other.yaml")
    assert [outcome.item.name for outcome in report.failed] == ["video.avi"]


@pytest.mark.parametrize(
    ("options", "words"), [({"format": "gif"}, "is not one of jpg"), ({"quality": 0}, "0 is less than 1")]
)
def test_options_that_make_no_sense_are_refused(options, words):
    with pytest.raises(InvalidInput, match=words):
        UndistortOptions("lens.yaml", Path("out"), ("a.png",), **options)
