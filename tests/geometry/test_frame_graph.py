"""Ways between named frames, loops, and frames that are not joined."""

from dataclasses import replace

import numpy as np
import pytest

from camcal.errors import InvalidInput
from camcal.geometry.frame_graph import FrameGraph
from camcal.geometry.pose import NamedTransform, Pose

VECTORS = np.random.default_rng(4).normal(size=(5, 2, 3))
WORLD = {
    frame: Pose.from_vector(*vectors)
    for frame, vectors in zip(("base", "arm", "cam", "tag", "tool"), VECTORS, strict=True)
}


def between(target, source, covariance=None):
    """Return target_T_source, exact, of frames at known places."""
    return NamedTransform(target, source, WORLD[target].inverse() @ WORLD[source], covariance)


TREE = [between("base", "arm"), between("cam", "arm"), between("tag", "cam"), between("arm", "tool")]


def test_a_way_goes_through_transforms_in_either_direction():
    graph = FrameGraph(TREE)
    links = graph.path("base", "tag")
    assert [graph.name_of(link) for link in links] == ["base_T_arm", "inv(cam_T_arm)", "inv(tag_T_cam)"]
    np.testing.assert_allclose(graph.along(links).pose.matrix(), between("base", "tag").pose.matrix(), atol=1e-14)


def test_a_frame_reaches_itself_without_a_transform():
    graph = FrameGraph(TREE)
    assert graph.path("arm", "arm") == ()
    np.testing.assert_array_equal(graph.along(()).pose.matrix(), np.eye(4))


def test_the_way_with_the_fewest_transforms_is_taken():
    graph = FrameGraph([*TREE, between("base", "tag")])
    assert [graph.name_of(link) for link in graph.path("base", "tag")] == ["base_T_tag"]


def test_frames_that_are_not_joined_are_named_with_what_they_are_joined_to():
    graph = FrameGraph([between("base", "arm"), between("cam", "tag")])
    with pytest.raises(InvalidInput, match="one is with base, arm, the other with tag, cam"):
        graph.path("base", "tag")


def test_names_that_look_alike_on_both_sides_are_asked_about():
    graph = FrameGraph([between("base", "arm"), NamedTransform("arm1", "tag", Pose.identity())])
    with pytest.raises(InvalidInput, match=r"Are 'arm' and 'arm1' the same frame\?"):
        graph.path("base", "tag")


def test_an_unknown_frame_is_refused_with_the_nearest_one():
    with pytest.raises(InvalidInput, match=r"no frame 'bsae'. Did you mean 'base'\?"):
        FrameGraph(TREE).path("bsae", "tag")


def test_a_tree_has_no_loops():
    assert FrameGraph(TREE).loops("base") == []


def test_a_loop_is_as_long_as_it_must_be_and_says_what_is_left_over():
    off = NamedTransform("base", "tag", between("base", "tag").pose.retract(np.array([0.001, 0, 0, 0, 0, 0.002])))
    (loop,) = FrameGraph([between("tool", "base"), *TREE[:3], off]).loops("tool")
    assert sorted(name.removeprefix("inv(").removesuffix(")") for name in loop.names) == [
        "base_T_arm", "base_T_tag", "cam_T_arm", "tag_T_cam"
    ]  # fmt: skip
    assert loop.angle == pytest.approx(0.002)
    assert loop.covariance is None
    assert loop.chi_square is None


def test_two_transforms_between_two_frames_are_a_loop():
    first, second = between("base", "cam"), between("cam", "base")
    (loop,) = FrameGraph([first, second]).loops("base")
    assert loop.offset == pytest.approx(0, abs=1e-15)
    assert loop.angle == pytest.approx(0, abs=1e-15)


def test_a_loop_is_measured_in_standard_deviations_where_all_have_a_covariance():
    sigma = 1e-3
    own = np.diag([sigma**2] * 3 + [1e-12] * 3)
    moved = NamedTransform("base", "cam", between("base", "cam").pose.retract(sigma * np.eye(6)[0]), own)
    (loop,) = FrameGraph([between("base", "cam", own), moved]).loops("base")
    # one standard deviation apart, where both have it: 1² / (1² + 1²)
    assert loop.chi_square == pytest.approx(0.5, rel=1e-3)  # rotations add 1e-6 of it


def test_what_is_said_to_be_exact_and_is_not_does_not_close():
    own = np.diag([1e-4] * 3 + [0.0] * 3)
    turned = NamedTransform("base", "cam", between("base", "cam").pose.retract(0.01 * np.eye(6)[5]), own)
    (loop,) = FrameGraph([between("base", "cam", own), turned]).loops("base")
    assert loop.chi_square > 1e6
    (closed,) = FrameGraph([between("base", "cam", own), between("base", "cam", own)]).loops("base")
    assert closed.chi_square < 1e-6


def test_chi_square_of_loops_is_that_of_chance():
    rng, own = np.random.default_rng(5), np.diag([1e-4, 1e-4, 1e-4, 1e-6, 1e-6, 1e-6])
    names = [("base", "arm"), ("cam", "arm"), ("tag", "cam"), ("base", "tag")]
    found = []
    for _ in range(60):
        noisy = [
            NamedTransform(a, b, between(a, b).pose.retract(rng.multivariate_normal(np.zeros(6), own)), own)
            for a, b in names
        ]
        (loop,) = FrameGraph(noisy).loops("base")
        found.append(loop.chi_square)
    # the mean of 60 values of 6 degrees of freedom is 6 ± √(12/60); four of these
    assert np.mean(found) == pytest.approx(6, abs=1.8)


def test_transforms_of_one_name_are_told_apart_by_where_they_stand():
    first, second = (replace(between("base", "tag"), where=f"poses.yaml#{image}") for image in ("a.png", "b.png"))
    (loop,) = FrameGraph([first, second]).loops("base")
    assert loop.names == ("base_T_tag of poses.yaml#b.png", "inv(base_T_tag of poses.yaml#a.png)")


def test_a_way_may_be_long():
    steps = [NamedTransform(f"f{index}", f"f{index + 1}", Pose.identity()) for index in range(3000)]
    assert len(FrameGraph(steps).path("f0", "f3000")) == 3000
