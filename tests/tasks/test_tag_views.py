"""Images and videos of tags to correspondences, in this process: the fan-out over processes has its own tests."""

import cv2
import numpy as np
import pytest
from tagged import facing, photograph, pinhole, true_corners

from camcal.errors import FileError, InvalidInput
from camcal.formats.tags import load_tags
from camcal.geometry.pose import Pose
from camcal.images.video import frame_name
from camcal.targets.markers import TagObjects, tag_corners
from camcal.tasks.poses.tag_views import tag_views

CAMERA = pinhole((320, 240), 400.0)
TWO = [(1, facing(-0.05, 0.0, 0.5, (0.3, 0.2, 0.1))), (2, facing(0.06, 0.01, 0.5, (-0.2, 0.3, 0.0)))]
TAGS = load_tags("tag36h11:50mm")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("tags")
    cv2.imwrite(str(folder / "a1.png"), photograph(CAMERA, TWO))
    cv2.imwrite(str(folder / "a2.png"), photograph(CAMERA, []))
    cv2.imwrite(str(folder / "a10.png"), photograph(CAMERA, TWO[:1]))
    return folder


def views_of(inputs, tags=TAGS, **options):
    return tag_views([str(one) for one in inputs], tags, jobs=1, **options)


def test_every_tag_of_every_image_is_a_view_of_its_own(folder):
    found = views_of([folder])
    names = [(folder / name).as_posix() for name in ("a1.png", "a2.png", "a10.png")]
    assert found.images == tuple(names)
    seen = [(view.image, view.object) for view in found.views]
    assert seen == [(names[0], "tag_1"), (names[0], "tag_2"), (names[2], "tag_1")]
    assert found.nothing == {names[1]: "no tag of tag36h11 found"}
    assert found.failed == ()


def test_points_and_pixels_of_a_view_belong_together(folder):
    view = views_of([folder / "a1.png"]).views[0]
    assert np.array_equal(view.points, tag_corners(0.05))
    assert np.abs(view.pixels - true_corners(CAMERA, TWO[0][1])).max() < 0.1  # 40 px tags: 0.02 px is usual
    assert view.covariance.shape == (4, 2, 2)


def test_repeated_tags_are_kept_under_names_of_their_own(tmp_path):
    twice = [(1, facing(-0.06, 0.0, 0.5)), (1, facing(0.06, -0.03, 0.5)), (2, facing(0.0, 0.08, 0.5))]
    cv2.imwrite(str(tmp_path / "a.png"), photograph(CAMERA, twice))
    assert [view.object for view in views_of([tmp_path]).views] == ["tag_2"]
    kept = views_of([tmp_path], keep_repeated=True)
    assert [view.object for view in kept.views] == ["tag_1", "tag_1_2", "tag_2"]
    first, second, _ = kept.views
    assert first.pixels[:, 1].mean() < second.pixels[:, 1].mean()
    plate = TagObjects(
        "tag36h11", bundles={"plate": {1: tag_corners(0.05), 2: tag_corners(0.05) + np.array([0, 0.1, 0])}}
    )
    (view,) = views_of([tmp_path], plate, keep_repeated=True).views
    assert len(view.points) == 4  # which of both is the plate's nobody knows


def test_all_tags_of_a_bundle_are_one_view(folder):
    object_T_tag = {tag: TWO[0][1].inverse() @ pose for tag, pose in TWO}  # the object's frame is that of tag 1
    bundle = {tag: pose.apply(tag_corners(0.05)) for tag, pose in object_T_tag.items()}
    found = views_of([folder / "a1.png"], TagObjects("tag36h11", bundles={"plate": bundle}))
    (view,) = found.views
    assert view.object == "plate"
    expected = CAMERA.project(TWO[0][1].apply(view.points)).pixels
    assert np.abs(view.pixels - expected).max() < 0.1  # both tags under one pose


def test_tags_without_an_object_are_named_in_the_reason(folder):
    found = views_of([folder / "a1.png"], load_tags("tag36h11:50mm:7"))
    assert list(found.nothing.values()) == ["ids 1, 2 of tag36h11 detected, none of a known object"]


def test_an_image_of_another_size_than_the_camera_is_left_out_with_the_reason(folder):
    found = views_of([folder / "a10.png"], image_size=(640, 480))
    assert found.views == ()
    assert list(found.nothing.values()) == ["the image has 320 x 240 pixels, the camera file is for 640 x 480"]


def test_a_repeated_id_is_noted_with_its_image(tmp_path):
    twice = [(3, facing(-0.05, 0, 0.5)), (3, facing(0.05, 0, 0.5))]
    cv2.imwrite(str(tmp_path / "b.png"), photograph(CAMERA, twice))
    found = views_of([tmp_path])
    (warning,) = found.warnings
    assert str(warning) == f"{tmp_path.as_posix()}/b.png: {next(iter(found.nothing.values()))}"
    assert (warning.code, dict(warning.values)) == ("repeated_tag_id", {"id": 3, "count": 2})


def test_an_unreadable_image_fails_and_the_others_do_not(folder, tmp_path):
    broken = tmp_path / "broken.png"
    broken.write_bytes((folder / "a1.png").read_bytes()[:200])
    found = views_of([folder / "a10.png", broken])
    assert len(found.views) == 1
    assert len(found.failed) == 1
    assert "broken.png" in found.failed[0]
    with pytest.raises(FileError, match="broken"):
        views_of([broken])


def test_frames_of_a_video_are_named_by_their_number(tmp_path):
    path = tmp_path / "clip.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 10, CAMERA.image_size, isColor=False)
    assert writer.isOpened()
    for tags in (TWO, [], TWO[1:]):
        writer.write(photograph(CAMERA, tags))
    writer.release()
    found = views_of([path])
    names = [frame_name(path, number) for number in range(3)]
    assert names[2] == (tmp_path / "clip_000002").as_posix()
    assert found.images == tuple(names)
    assert [(view.image, view.object) for view in found.views] == [
        (names[0], "tag_1"),
        (names[0], "tag_2"),
        (names[2], "tag_2"),
    ]


def test_nothing_to_look_at_is_an_error(tmp_path):
    with pytest.raises(FileError, match="no such file"):
        views_of([tmp_path / "missing.png"])
    with pytest.raises(InvalidInput, match="no images given"):
        views_of([])


def test_the_pose_of_the_tags_is_the_one_they_were_drawn_with(folder):
    """The chain from file to pose, held by one number: the frames of tags, corners and camera agree."""
    from camcal.estimate.pnp import estimate_poses

    (outcome, *_) = estimate_poses(CAMERA, views_of([folder / "a1.png"]).views)
    camera_T_tag: Pose = TWO[0][1]
    turned = outcome.value.transform.rotation.T @ camera_T_tag.rotation
    assert np.degrees(np.arccos((np.trace(turned) - 1) / 2)) < 1.0  # a tag of 40 px tells tilt to 0.2°
    assert np.abs(outcome.value.transform.translation - camera_T_tag.translation).max() < 2e-3
