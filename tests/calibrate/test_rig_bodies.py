"""Rigs that see several boards: what links cameras and boards, what motions leave open, and what is known beforehand.

The truth is that of tests/body_scenes.py, which is made without camcal. What is not shown here: that the stated
uncertainty is true, see benchmarks/several_boards.py.
"""

from dataclasses import replace

import numpy as np
import pytest
from body_scenes import BodyScene, captures_of, cube, transform, two_sides

from camcal.calibrate.fit import ShapeOptions
from camcal.calibrate.rigs.calibrate import calibrate_rig
from camcal.calibrate.rigs.links import CameraPoses, Placed
from camcal.calibrate.rigs.measured import (
    BoardPoses,
    KnownDistance,
    KnownRelation,
    Measured,
    measured_blocks,
    require_measured,
)
from camcal.calibrate.rigs.placement import PlacedRig, Rows, place_rig
from camcal.calibrate.rigs.record import RigOptions
from camcal.cameras.catalogue import model_named
from camcal.errors import InsufficientData
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose, inverse_jacobian
from camcal.solve.steps import Block, Jacobian
from camcal.targets.board import basis, terms_of

MODEL = model_named("opencv5")
FLAT = ShapeOptions(smooth=False, offsets=False)


def calibrated(scene: BodyScene, seed=0, shows=None, **options):
    captures = captures_of(scene, seed=seed, **({} if shows is None else {"shows": shows}))
    given = RigOptions(dict.fromkeys(captures.cameras, MODEL), **{"shape": FLAT, **options})
    return calibrate_rig(captures, scene.together, given)


def off(found: Pose, truth: np.ndarray, covariance: np.ndarray) -> float:
    """Return the error of a transform, normalised by its covariance, per number."""
    step = np.concatenate([found.translation - truth[:3, 3], so3.log(found.rotation @ truth[:3, :3].T)])
    return float(np.sqrt(step @ np.linalg.solve(covariance, step) / 6))


def on_body(scene: BodyScene, name: str) -> np.ndarray:
    target, source = name.split("_T_")
    return np.linalg.inv(scene.on_body[target]) @ scene.on_body[source]


def require_true(calibration, scene: BodyScene, most: float = 2.2) -> None:
    # χ² of six numbers exceeds 6 · 2.2² in one of 20 000 cases
    for name, pose in calibration.poses.items():
        if name != calibration.first:
            assert off(pose, scene.relative(name), calibration.pose_covariance(name)) < most, name
    for name, pose in calibration.boards.items():
        assert off(pose, on_body(scene, name), calibration.transform_covariance(name)) < most, name


@pytest.fixture(scope="module")
def panel() -> BodyScene:
    """A camera on each side of a panel with two boards."""
    return two_sides(1, 20, per_side=1)


@pytest.fixture(scope="module")
def by_motion(panel):
    return calibrated(panel)


def test_cameras_that_see_boards_of_their_own_only_are_linked_by_the_motion_of_the_body(panel, by_motion):
    assert list(by_motion.poses) == ["north0", "south0"]
    assert list(by_motion.boards) == ["a_T_b"]
    assert by_motion.warnings == ()
    require_true(by_motion, panel)


def test_the_link_of_two_cameras_names_their_boards_and_counts_their_common_captures(by_motion):
    [link] = by_motion.links
    assert (link.cameras, link.boards) == (("north0", "south0"), ("a", "b"))
    views = [by_motion.calibrations[name].views for name in link.cameras]
    moments = [{view.image.split("_")[1] for view in own if view.used} for own in views]
    assert link.captures == len(moments[0] & moments[1])
    covariance, back = by_motion.pose_covariance("south0"), inverse_jacobian(by_motion.poses["south0"])
    both = covariance + back @ covariance @ back.T
    # a measure to compare links by: errors of lenses, which all views share, do not count
    assert 0.3 < link.std / np.sqrt(np.trace(both[:3, :3]) / 6) < 1.2


def test_a_cube_of_boards_is_one_body():
    scene = cube(1, 16, 3)
    found = calibrated(scene)
    assert list(found.boards) == [f"f0_T_f{face}" for face in range(1, 6)]
    require_true(found, scene)


def placed_by_truth(scene: BodyScene, moments=None) -> PlacedRig:
    """Return where true poses of views place cameras and boards; cameras of a side see its board alone."""
    names, boards = list(scene.boards), scene.together
    count = len(scene.motions[names[0]])
    rows = Rows(np.repeat([0, 1], count), np.tile(np.arange(count), 2), boards.names, (0, 0))
    cameras = []
    for name in scene.cameras:
        side = int(name.startswith("south"))
        poses = np.stack([scene.pose_of(name, names[side], moment) for moment in moments or range(count)])
        captures = side * count + np.arange(count)[: len(poses)]
        cameras.append(CameraPoses(captures, poses[:, :3, :3], poses[:, :3, 3]))
    linked = [Placed({camera: np.eye(3)}, {camera: np.zeros(3)}) for camera in range(len(cameras))]
    return place_rig(cameras, linked, rows, tuple(scene.cameras))


@pytest.mark.parametrize(("turns", "words"), [((0.5, 0.0, 0.0), "about one axis"), ((0.0, 0.0, 0.0), "hardly turn")])
def test_a_motion_that_leaves_something_open_is_named(turns, words):
    scene = two_sides(1, 12, turns=turns, per_side=1)
    with pytest.raises(InsufficientData, match=words) as caught:
        placed_by_truth(scene)
    assert [failure.code for failure in caught.value.failures] == ["undetermined_motion"]
    assert "north0 and south0" in str(caught.value)


def test_the_axis_that_all_turn_about_is_told_in_the_frame_of_the_camera_that_is_named():
    scene = two_sides(2, 12, turns=(0.0, 0.5, 0.0), per_side=1)
    with pytest.raises(InsufficientData, match="about one axis") as caught:
        calibrated(scene)
    told = np.array([float(word) for word in str(caught.value).split("(")[1].split(")")[0].split(",")])
    axis = scene.cameras["north0"][:3, :3] @ [0, 1.0, 0]  # the panel turns about the vertical
    assert abs(told @ axis) > 0.995


@pytest.mark.parametrize(("moments", "links"), [(4, True), (3, False)])
def test_a_motion_links_cameras_from_four_captures_on(panel, moments, links):
    # the limit is a whole number: one fewer is too few
    placed = placed_by_truth(panel, range(moments))
    assert (len(placed.cameras.rotations) == 2) == links
    if links:
        found = Pose(placed.cameras.rotations[1], placed.cameras.translations[1])
        np.testing.assert_allclose(found.matrix(), panel.relative("south0"), atol=1e-9)
    else:
        assert [message.code for message in placed.messages] == []


@pytest.mark.parametrize(("share", "joined"), [(0.08, True), (0.16, False)])
def test_a_motion_that_is_not_that_of_one_body_is_named(panel, share, joined):
    # the limit is a tenth of what the body moves by, RMS; of which the closed form leaves nine tenths
    places = np.array([np.linalg.inv(panel.pose_of("north0", "a", moment))[:3, 3] for moment in range(20)])
    reach = np.sqrt(np.mean(np.sum((places - places.mean(axis=0)) ** 2, axis=1)))
    moving = apart(panel, share * reach, 0.0)
    if joined:
        assert len(placed_by_truth(moving).cameras.rotations) == 2
        return
    with pytest.raises(InsufficientData, match="boards a and b that are joined: they move against each other"):
        placed_by_truth(moving)


def apart(scene: BodyScene, shift: float, angle: float) -> BodyScene:
    """Return a scene in which board b moves against board a from moment to moment, by so much in the median."""
    rng = np.random.default_rng(4)
    moved = []
    for index, pose in enumerate(scene.motions["b"]):
        axis, turn = rng.normal(size=3), rng.normal(size=3)
        sign = 1 if index % 2 else -1
        step = transform(sign * angle * turn / np.linalg.norm(turn), sign * shift * axis / np.linalg.norm(axis))
        moved.append(pose @ scene.on_body["b"] @ step @ np.linalg.inv(scene.on_body["b"]))
    return replace(scene, motions={"a": scene.motions["a"], "b": moved})


def facing(seed: int) -> BodyScene:
    """Return a panel whose boards are side by side, so that every camera sees both."""
    scene = two_sides(seed, 10, turns=(0.4, 0.4, 0.3), per_side=2)
    names = [name for name in scene.cameras if name.startswith("north")]
    beside = transform([0.02, 0.03, 0.01], [-0.45, 0.01, 0.0])
    return replace(
        scene,
        cameras={name: transform([0, 0, 0], [0, 0, 0.4]) @ scene.cameras[name] for name in names},
        lenses={name: scene.lenses[name] for name in names},
        on_body={"a": np.eye(4), "b": beside},
    )


@pytest.mark.parametrize(("shift", "angle"), [(0.035, 0.0), (0.0, 3.5), (0.075, 0.0), (0.0, 7.5)])
def test_boards_that_move_against_each_other_are_not_joined(shift, angle):
    # shift: of the distance of the boards; the limits are 0.05 of it and 5°
    scene = facing(3)
    far = np.median([np.linalg.norm(scene.pose_of("north0", "a", moment)[:3, 3]) for moment in range(10)])
    moving = apart(scene, shift * far, np.radians(angle))
    if shift < 0.05 and angle < 5:
        assert list(calibrated(moving).boards) == ["a_T_b"]
        return
    with pytest.raises(InsufficientData, match="boards a and b move against each other") as caught:
        calibrated(moving)
    assert [failure.code for failure in caught.value.failures] == ["boards_not_joined"]
    assert "--joined none" in str(caught.value)


def test_boards_that_each_move_by_themselves_link_cameras_as_one_board_does():
    scene = apart(facing(3), 0.3, 0.5)
    found = calibrated(scene, bodies=())
    assert (list(found.boards), found.warnings) == ([], ())
    require_true(found, scene)


def test_boards_that_nothing_links_are_named_and_the_larger_group_is_kept():
    scene = two_sides(1, 12, per_side=2)
    # in each moment one side is seen only: no capture shows both
    found = calibrated(scene, shows=lambda camera, _, moment: camera.startswith("north") == (moment % 2 == 0))
    assert list(found.poses) == ["north0", "north1"]
    assert set(found.unlinked) == {"south0", "south1"}
    assert "unlinked_camera" in [warning.code for warning in found.warnings]


def known(scene: BodyScene, name: str, shift=(0.0, 0.0, 0.0), std=1e-4) -> Measured:
    names = list(scene.boards)
    target, source = name.split("_T_")
    truth = on_body(scene, name)
    truth = Pose(truth[:3, :3], truth[:3, 3] + shift)
    covariance = np.diag([std**2] * 3 + [(std / 0.3) ** 2] * 3)
    return Measured((KnownRelation(names.index(target), names.index(source), truth, covariance),))


def test_a_known_relation_counts_with_its_covariance(panel, by_motion):
    found = calibrated(panel, measured=known(panel, "a_T_b", std=1e-6))
    stated, before = (np.sqrt(np.diag(own.transform_covariance("a_T_b"))) for own in (found, by_motion))
    assert (stated[:3] < 1.01e-6).all()
    assert (before[:3] > 1e-5).all()
    require_true(found, panel)
    inverse = calibrated(panel, measured=known(panel, "b_T_a", std=1e-6))
    np.testing.assert_allclose(inverse.boards["a_T_b"].translation, found.boards["a_T_b"].translation, atol=5e-6)


def test_a_known_relation_links_cameras_where_the_motion_does_not():
    scene = two_sides(1, 14, turns=(0.5, 0.0, 0.0), per_side=1)
    found = calibrated(scene, measured=known(scene, "a_T_b"))
    assert list(found.poses) == ["north0", "south0"]
    require_true(found, scene)


@pytest.mark.parametrize("shift", [0.02, 1.5e-3])
def test_a_wrong_relation_is_named(panel, shift):
    with pytest.raises(InsufficientData, match="given a_T_b contradicts the captures") as caught:
        calibrated(panel, measured=known(panel, "a_T_b", (shift, 0, 0)))
    [failure] = caught.value.failures
    assert failure.code == "relation_contradicted"
    assert failure.values["m"] == pytest.approx(shift, rel=0.5)


def length(scene: BodyScene, ends, wrong: float = 0.0, std: float = 1e-4) -> KnownDistance:
    (one, first), (other, second) = ends
    names = list(scene.boards)
    starts = {"a": 0, "b": scene.boards["a"].count}
    places = [
        scene.on_body[board][:3, :3] @ scene.points(board)[point] + scene.on_body[board][:3, 3] for board, point in ends
    ]
    return KnownDistance(
        (starts[one] + first, starts[other] + second),
        (names.index(one), names.index(other)),
        float(np.linalg.norm(places[0] - places[1])) + wrong,
        std,
        f"{one}.{first}:{other}.{second}",
    )


ENDS = [(("a", 0), ("a", 53)), (("b", 0), ("b", 39)), (("a", 0), ("b", 39))]


def test_distances_set_the_scale_of_boards_that_are_printed_wrongly(panel):
    printed = replace(panel, printed={"a": 1.004, "b": 0.997})
    measured = Measured(distances=tuple(length(printed, ends) for ends in ENDS))
    found = calibrated(printed, measured=measured)
    for name, size in printed.printed.items():
        scale, std = found.scales[name]
        assert abs(scale - size) < 4 * std < 2e-3
    require_true(found, printed)
    assert calibrated(printed).scales == {}


@pytest.mark.parametrize("which", range(3))
def test_a_wrong_distance_is_the_one_that_is_named(panel, which):
    distances = [length(panel, ends) for ends in ENDS]
    distances[which] = length(panel, ENDS[which], wrong=2e-3)
    with pytest.raises(InsufficientData) as caught:
        calibrated(panel, measured=Measured(distances=tuple(distances)))
    [failure] = caught.value.failures
    assert failure.code == "distance_contradicted"
    assert f"--distance {distances[which].words}: " in failure.text
    assert failure.values["m"] == pytest.approx(distances[which].metres - 2e-3, abs=1e-3)


def blocks_of(measured: Measured, boards: BoardPoses, together, shape: np.ndarray, terms) -> np.ndarray:
    by_terms = basis(together, terms)
    points = together.points() + by_terms @ shape
    return measured_blocks(measured, boards, {1: 0}, points, by_terms, 6)


def test_derivatives_of_known_relations_and_distances(panel):
    together = panel.together
    terms = terms_of(together)
    shape = 1e-3 * np.random.default_rng(1).normal(size=len(terms))
    poses = [np.eye(4), on_body(panel, "a_T_b") @ transform([0.02, -0.03, 0.01], [0.003, 0.001, -0.002])]
    boards = BoardPoses(np.stack([own[:3, :3] for own in poses]), np.stack([own[:3, 3] for own in poses]))
    measured = Measured(
        known(panel, "a_T_b").relations + known(panel, "b_T_a").relations,
        tuple(length(panel, ends) for ends in ENDS),
    )

    def residuals(step: np.ndarray) -> np.ndarray:
        moved = boards.moved((1,), step[:6])
        return np.concatenate(
            [own.residuals[0] for own in blocks_of(measured, moved, together, shape + step[6:], terms)]
        )

    blocks = blocks_of(measured, boards, together, shape, terms)
    count = 6 + len(terms)
    found = []
    for block in blocks:
        rows = np.zeros((block.residuals.shape[1], count))
        for each in block.shared:
            rows[:, each.columns] += each.values[0]
        found.append(rows)
    steps = 1e-6 * np.eye(count)
    wanted = np.stack([(residuals(step) - residuals(-step)) / 2e-6 for step in steps], axis=1)
    # of central differences at 1e-6 in residuals of some 1e2
    np.testing.assert_allclose(np.concatenate(found), wanted, atol=1e-6 * np.abs(wanted).max())


def judged(residual: float, left: float, *, distance: bool, inflation: float = 1.0) -> str | None:
    """Return the code for something known whose residual is given, where other things leave a share of its variance."""
    blocks = [Block(np.array([[residual]]), (Jacobian(np.ones((1, 1, 1)), np.array([1])),))]
    covariance = np.diag([1.0, 1 - left])
    known = Measured(
        () if distance else (KnownRelation(0, 1, Pose.identity(), np.eye(1)),),
        (KnownDistance((0, 1), (0, 1), 1.0, 1e-3, "0:1"),) if distance else (),
    )
    try:
        require_measured(known, blocks, covariance, inflation, ("a", "b"))
    except InsufficientData as error:
        return error.failures[0].code
    return None


@pytest.mark.parametrize("left", [0.9, 0.5, 1e-3])
def test_what_is_known_is_judged_by_what_everything_else_says(left):
    # the residual that is left of a difference e is e · left, the variance of e is 1 / left
    def code(sigmas: float, **options) -> str | None:
        return judged(sigmas * np.sqrt(1 / left) * left, left, **options)

    # the limit of a distance is 4.5 standard deviations, that of a relation a χ² of 30
    assert code(3.0, distance=True) is None
    assert code(6.5, distance=True) == "distance_contradicted"
    assert code(np.sqrt(20.0), distance=False) is None
    assert code(np.sqrt(45.0), distance=False) == "relation_contradicted"


def test_what_captures_say_counts_with_their_scatter():
    assert judged(6.5 * np.sqrt(2) / 2, 0.5, distance=True, inflation=1.0) == "distance_contradicted"
    assert judged(6.5 * np.sqrt(2) / 2, 0.5, distance=True, inflation=4.0) is None


@pytest.mark.parametrize(("left", "code"), [(0.7e-6, None), (1.5e-6, "distance_contradicted")])
def test_what_nothing_else_says_anything_of_is_not_judged(left, code):
    assert judged(100 * np.sqrt(left), left, distance=True) == code
