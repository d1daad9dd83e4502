"""Errors of trajectories against a reference."""

import numpy as np
import pytest

from camcal.errors import InsufficientData, InvalidInput
from camcal.estimate.trajectory_error import ErrorOptions, align, associate, pairs, trajectory_error
from camcal.formats import trajectories
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Trajectory

# Computed with evo 1.38.1 (nearest stamps within 0.01 s; RPE of consecutive pairs, or of all): ATE, RPE in m and deg.
EVO = [
    (
        "fr2_desk_ORB",
        "fr2_desk_groundtruth",
        "se3",
        10,
        "frames",
        True,
        (2174, 2164, 0.008118977562045396, 0.9890356583679113, 0.005841796673881318, 0.395901770227406),
    ),
    (
        "fr2_desk_ORB",
        "fr2_desk_groundtruth",
        "sim3",
        0.5,
        "m",
        False,
        (2174, 36, 0.006123163030157291, 0.9890356583679113, 0.009446121683277691, 0.6071347107060898),
    ),
    (
        "freiburg1_xyz-rgbdslam_drift",
        "freiburg1_xyz-groundtruth",
        "none",
        1,
        "frames",
        False,
        (785, 784, 0.1341854204892675, 36.17789705156791, 0.005764378833030764, 0.3536135361731566),
    ),
    (
        "freiburg1_xyz-rgbdslam_drift",
        "freiburg1_xyz-groundtruth",
        "se3",
        0.5,
        "m",
        True,
        (785, 697, 0.013470118951368277, 2.0577024866830285, 0.024811031853934976, 1.0482789021727665),
    ),
]


@pytest.fixture
def rng():
    return np.random.default_rng(2)


def wandering(rng, count=200):
    steps = np.cumsum(rng.normal(size=(count, 6)) * 0.05, axis=0)
    return Trajectory("world_T_camera", np.arange(count) * 0.1, so3.exp(steps[:, 3:]), steps[:, :3])


@pytest.mark.parametrize(("estimate", "reference", "alignment", "delta", "unit", "every", "expected"), EVO)
def test_errors_of_real_trajectories_are_those_of_evo(
    real_data, estimate, reference, alignment, delta, unit, every, expected
):
    folder = real_data / "pnp" / "evo-trajectories"
    truth, _ = trajectories.read_reference(folder / f"{reference}.txt")
    found = trajectory_error(
        trajectories.read(folder / f"{estimate}.txt"), truth, ErrorOptions(alignment, delta, unit, every)
    )
    figures = (found.translation, found.rotation, found.relative_translation, found.relative_rotation)
    numbers = [each.rmse * (1 if index % 2 == 0 else np.degrees(1)) for index, each in enumerate(figures)]
    assert (found.poses, found.pairs) == expected[:2]
    np.testing.assert_allclose(numbers, expected[2:], rtol=1e-12)


@pytest.mark.parametrize("alignment", ["none", "se3", "sim3"])
def test_errors_are_those_of_evo_where_it_is_installed(rng, alignment):
    pytest.importorskip("evo")
    from evo.core import metrics, sync
    from evo.core.trajectory import PoseTrajectory3D

    reference = wandering(rng)
    estimate = Trajectory(
        "a_T_b",
        reference.stamps[3:] + 0.004,
        so3.exp(0.01 * rng.normal(size=(197, 3))) @ reference.rotations[3:],
        1.1 * reference.translations[3:] + 0.02 * rng.normal(size=(197, 3)),
    )
    theirs = [
        PoseTrajectory3D(each.translations, so3.to_quaternion(each.rotations), each.stamps)
        for each in (reference, estimate)
    ]
    truth, other = sync.associate_trajectories(*theirs)
    if alignment != "none":
        other.align(truth, correct_scale=alignment == "sim3")
    found = trajectory_error(estimate, reference, ErrorOptions(alignment, 5))
    for metric, figures in (
        (metrics.APE(metrics.PoseRelation.translation_part), found.translation),
        (metrics.RPE(metrics.PoseRelation.translation_part, 5, metrics.Unit.frames), found.relative_translation),
        (metrics.RPE(metrics.PoseRelation.rotation_angle_rad, 5, metrics.Unit.frames), found.relative_rotation),
    ):
        metric.process_data((truth, other))
        assert figures.rmse == pytest.approx(metric.get_statistic(metrics.StatisticsType.rmse), abs=1e-9)
        assert figures.max == pytest.approx(metric.get_statistic(metrics.StatisticsType.max), abs=1e-9)


@pytest.mark.parametrize("kind", ["se3", "sim3", "yaw"])
def test_an_alignment_undoes_what_moved_a_trajectory(rng, kind):
    truth = wandering(rng)
    turn = so3.about_z(2.0) if kind == "yaw" else so3.exp(rng.normal(size=3))
    scale = 0.4 if kind == "sim3" else 1.0
    moved = Trajectory("a_T_b", truth.stamps, turn @ truth.rotations, scale * truth.translations @ turn.T + [1, 2, 3])
    found = trajectory_error(moved, truth, ErrorOptions(kind))
    assert found.translation.max < 1e-12  # rounding
    assert found.rotation.max < 1e-12
    assert found.alignment.scale == pytest.approx(1 / scale, rel=1e-12)


def test_an_alignment_never_mirrors():
    flat = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]])
    found = align(flat, flat * [1, -1, 1], "se3")
    assert np.linalg.det(found.rotation) == pytest.approx(1, abs=1e-12)


def test_positions_on_a_line_do_not_determine_a_rotation():
    line = np.outer(np.arange(5.0), [1, 2, 3])
    with pytest.raises(InsufficientData, match="on a line"):
        align(line, line, "se3")
    assert align(line, line, "yaw").scale == 1.0


def test_stamps_are_paired_with_the_nearest_within_the_limit():
    first, second = associate(np.array([0.0, 1.0, 2.0]), np.array([0.004, 0.99, 1.003, 1.6, 2.02]), 0.01)
    np.testing.assert_array_equal(first, [0, 1])
    np.testing.assert_array_equal(second, [0, 2])
    second, first = associate(np.array([0.004, 0.99, 1.003, 1.6, 2.02]), np.array([0.0, 1.0, 2.0]), 0.01)
    np.testing.assert_array_equal(first, [0, 1])
    np.testing.assert_array_equal(second, [0, 2])


def test_two_clocks_are_told_from_one(rng):
    truth = wandering(rng)
    with pytest.raises(InsufficientData, match="0 stamps agree within"):
        trajectory_error(truth, Trajectory("a_T_b", truth.stamps + 1e9, truth.rotations, truth.translations))


def test_motions_over_seconds_begin_where_the_one_before_ended(rng):
    first, second = pairs(wandering(rng, 31), 1.0, "s", all_pairs=False)
    np.testing.assert_array_equal(first, [0, 10, 20])
    np.testing.assert_array_equal(second, [10, 20, 30])


@pytest.mark.parametrize(("delta", "unit"), [(0, "frames"), (1.5, "frames"), (1, "km"), (-1, "m"), (float("nan"), "s")])
def test_motions_over_what_is_no_distance_are_refused(rng, delta, unit):
    with pytest.raises(InvalidInput, match=r"positive number|whole number"):
        pairs(wandering(rng, 5), delta, unit, all_pairs=True)
    with pytest.raises(InvalidInput, match=r"positive number|whole number"):
        ErrorOptions(delta=delta, unit=unit)


def test_an_unknown_alignment_is_refused():
    with pytest.raises(InvalidInput, match="none, se3, sim3, yaw"):
        ErrorOptions("se2")
    with pytest.raises(InvalidInput, match="none, se3, sim3, yaw"):
        align(np.eye(3), np.eye(3), "se2")
