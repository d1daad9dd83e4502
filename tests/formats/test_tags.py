import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from camcal.errors import CamcalError, InvalidInput
from camcal.formats import tags
from camcal.geometry.pose import Pose
from camcal.targets.markers import APRILTAG, OPENCV, TagObjects, tag_corners

CUBE = """\
family: tag36h11
size_mm: 40.0
sizes:
  - {id: 7, size_cm: 8.0}
bundles:
  cube:
    - {id: 20, corners_mm: [[-20.0, 20.0, 30.0], [20.0, 20.0, 30.0], [20.0, -20.0, 30.0], [-20.0, -20.0, 30.0]]}
    - id: 21
      translation_mm: [30.0, 0.0, 0.0]
      rotation_vector: [0.0, 1.5707963267949, 0.0]
"""


@pytest.fixture
def load(tmp_path):
    def load(text):
        path = tmp_path / "tags.yaml"
        path.write_text(text)
        return tags.load_tags(str(path))

    return load


def test_opencv_frame_is_the_one_of_its_square_solver():
    """The four points that cv2.SOLVEPNP_IPPE_SQUARE demands; x right, y up, z out of the tag, to the camera."""
    half = 0.5 * np.array([[-1, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0]])
    assert np.array_equal(tag_corners(1.0, OPENCV), half)
    upright = Pose.from_vector(np.array([0.4, 0.0, 0.0]), np.zeros(3)).rotation @ np.diag([1.0, -1, -1])
    x, y, z = (tag_corners(1.0, OPENCV) @ upright.T + [0, 0, 8]).T
    seen = np.stack([500 * x / z + 150, 500 * y / z + 150], axis=1)
    assert (seen[0] < seen[2]).all()  # the first corner is the top-left in the image
    matrix = np.array([[500.0, 0, 150], [0, 500, 150], [0, 0, 1]])
    _, rotation, _ = cv2.solvePnP(tag_corners(1.0, OPENCV), seen, matrix, None, flags=cv2.SOLVEPNP_IPPE_SQUARE)
    assert np.allclose(cv2.Rodrigues(rotation)[0], upright, atol=1e-6)  # exact data


def test_apriltag_frame_looks_into_the_tag():
    """An upright tag seen from the front has the camera's own axes: x right, y down, z away."""
    opencv_T_apriltag = Pose(np.diag([1.0, -1, -1]), np.zeros(3))
    assert np.allclose(opencv_T_apriltag.apply(tag_corners(0.1, APRILTAG)), tag_corners(0.1, OPENCV))
    assert np.array_equal(np.sign(tag_corners(0.1, APRILTAG)[0]), [-1, -1, 0])


def test_a_short_form_makes_every_id_an_object_of_its_own():
    found = tags.load_tags("tag36h11:53mm")
    name, corners = found.find(586)
    assert name == "tag_586"
    assert np.allclose(corners, tag_corners(0.053))


def test_a_short_form_may_name_the_ids_that_count():
    found = tags.load_tags("DICT_4X4_50:4cm:0,1,5")
    assert found.size == pytest.approx(0.04)
    assert [tag for tag in range(8) if found.find(tag)] == [0, 1, 5]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("tag36h11", "expected FAMILY:SIZE"),
        ("tag36h11:53", "has no unit; write 53mm"),
        ("tag36h11:0.053", "'0.053' has no unit; write 0.053m or 53mm if it is in metres"),
        ("tag36h11:0mm", "must be positive"),
        ("tag36h12:53mm", "did you mean tag36h11"),
        ("tag16h5:53mm:30", "ids are 0 to 29"),
        ("tag36h11:53mm:1,,2", "not a list of ids"),
        ("tag36h11:53mm:1,1", "listed twice"),
        ("tag36h11:53mm:1:2", "expected FAMILY:SIZE"),
    ],
)
def test_a_wrong_short_form_says_which_part(text, message):
    with pytest.raises(InvalidInput, match=message):
        tags.load_tags(text)


def test_a_bundle_may_be_given_by_corners_or_by_where_its_tags_are(load):
    found = load(CUBE)
    name, corners = found.find(21)
    assert name == "cube"
    # Turned by 90° about y, the tag's x is -z of the cube: its right side is at the back
    assert np.allclose(corners, [[0.03, 0.02, 0.02], [0.03, 0.02, -0.02], [0.03, -0.02, -0.02], [0.03, -0.02, 0.02]])
    assert found.find(20)[0] == "cube"
    assert np.allclose(found.find(7)[1], tag_corners(0.08))
    assert found.find(3)[0] == "tag_3"


def test_a_quaternion_says_the_same_as_a_rotation_vector(load):
    other = CUBE.replace("rotation_vector: [0.0, 1.5707963267949, 0.0]", "quaternion: {w: 1.0, x: 0.0, y: 1.0, z: 0.0}")
    assert np.allclose(load(CUBE).find(21)[1], load(other).find(21)[1])


def test_tags_written_are_read_again(load, tmp_path):
    before = load(CUBE)
    tags.write(tmp_path / "again.yaml", before)
    after = tags.read(tmp_path / "again.yaml")
    assert (after.family, after.size, after.ids, after.tag_frame) == (before.family, before.size, None, OPENCV)
    assert after.sizes == before.sizes
    for tag, corners in before.bundles["cube"].items():
        assert np.allclose(after.bundles["cube"][tag], corners, rtol=0, atol=1e-13)  # 12 digits of 0.03


NO_ROTATION = """\
family: tag16h5
size_m: 1.0
bundles:
  a:
    - {id: 1, translation_m: [0, 0, 0], quaternion: {w: 0, x: 0, y: 0, z: 0}}
"""
SQUARE = "[[-1, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0]]"


@pytest.mark.parametrize(
    ("text", "line", "message"),
    [
        ("size_mm: 5\n", 1, "missing key 'family'"),
        ("family: tag36h11\nsise_mm: 5.0\n", 2, "Did you mean 'size_mm'"),
        ("family: tag36h21\nsize_mm: 5.0\n", 1, "did you mean tag36h11"),
        ("family: tag36h11\nsize_mm: 5.0\nsize_cm: 1.0\n", 1, "size_mm and size_cm: give one of them"),
        ("family: tag36h11\nsize_mm: -5.0\n", 2, "must be > 0"),
        ("family: tag16h5\nsize_mm: 5.0\nids: [0, 30]\n", 3, "ids are 0 to 29"),
        ("family: tag16h5\nsize_mm: 5.0\nids: [0, 0]\n", 3, "listed twice"),
        ("family: tag16h5\n", 1, "tags need a size"),
        ("family: tag16h5\nids: [1]\nsizes: [{id: 2, size_m: 1.0}]\n", 1, "ids need the size of the tags"),
        ("family: tag16h5\nsizes:\n  - {id: 1}\n", 3, "missing key 'size_mm'"),
        ("family: tag16h5\nsizes:\n  - {id: 1, size_mm: 5.0}\n  - {id: 1, size_mm: 6.0}\n", 4, "given already"),
        ("family: tag16h5\nsize_mm: 5.0\ntag_frame: ros\n", 3, "unknown tag frame"),
        (f"family: tag16h5\nbundles:\n  a:\n    - {{id: 31, corners_m: {SQUARE}}}\n", 4, "ids are 0 to 29"),
        (f"family: tag16h5\nbundles:\n  tag_3:\n    - {{id: 1, corners_m: {SQUARE}}}\n", 1, "name of a single tag"),
        ("family: tag16h5\nbundles:\n  a: []\n", 1, "has no tag"),
        ("family: tag16h5\nbundles:\n  a:\n    - {id: 1}\n", 4, "needs corners_mm, or translation_mm"),
        ("family: tag16h5\nbundles:\n  a:\n    - {id: 1, translation_m: [0, 0, 0]}\n", 4, "needs its side"),
        (
            f"family: tag16h5\nbundles:\n  a:\n    - {{id: 1, corners_m: {SQUARE}, size_m: 1.0}}\n",
            4,
            "redundant with the corners; give one of them",
        ),
        (
            "family: tag16h5\nbundles:\n  a:\n    - {id: 1, corners_m: [[0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0]]}\n",
            4,
            "the corners are not a convex quadrangle in order: clockwise from top-left",
        ),
        (
            "family: tag16h5\nbundles:\n  a:\n    - {id: 1, corners_m: [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]]}\n",
            4,
            "the corners are not a convex quadrangle in order: clockwise from top-left",
        ),
        (
            "family: tag16h5\nbundles:\n  a:\n    - {id: 1, corners_m: [[0, 0, 0], [0, 0, 0], [1, 1, 0], [1, 1, 0]]}\n",
            4,
            "the same",
        ),
        (
            "family: tag16h5\nbundles:\n  a:\n    - {id: 1, corners_m: [[0, 1, 1], [1, 1, 0], [1, 0, 1], [0, 0, 0]]}\n",
            4,
            "not in one plane",
        ),
        (NO_ROTATION, 5, "not a rotation"),
    ],
)
def test_a_fault_of_a_tag_file_has_its_line(load, text, line, message):
    with pytest.raises(InvalidInput, match=message) as caught:
        load(text)
    assert f"tags.yaml:{line}" in str(caught.value)


def test_an_id_on_two_objects_is_refused():
    square = tag_corners(0.1)
    with pytest.raises(InvalidInput, match="id 1 is on a and on b"):
        TagObjects("tag16h5", bundles={"a": {1: square}, "b": {1: square + 1}})


def test_corners_of_a_bundle_cannot_be_changed():
    found = TagObjects("tag16h5", bundles={"a": {1: tag_corners(0.1)}})
    with pytest.raises(ValueError, match="read-only"):
        found.bundles["a"][1][0, 0] = 7.0


@given(st.text(alphabet="tag36h11DICT_4X50:mc., \n{}[]", max_size=40))
def test_any_text_is_tags_or_an_error_in_words(text):
    try:
        found = tags.parse_tags(text)
    except CamcalError:
        return  # any other exception would be a bug, and fails here
    assert found.size > 0


@given(
    st.floats(1e-4, 10.0),
    st.lists(st.floats(-3, 3), min_size=3, max_size=3),
    st.lists(st.floats(-10, 10), min_size=3, max_size=3),
    st.sampled_from([OPENCV, APRILTAG]),
)
def test_a_tag_placed_by_its_pose_is_where_the_pose_puts_it(size, vector, translation, frame):
    tag = {"id": 1, "size_m": size, "translation_m": translation, "rotation_vector": vector}
    data = {"family": "tag16h5", "tag_frame": frame, "bundles": {"a": [tag]}}
    assert list(tags.check(data, "")) == []
    expected = Pose.from_vector(np.array(vector), np.array(translation)).apply(tag_corners(size, frame))
    assert np.array_equal(tags.from_block(data).find(1)[1], expected)
