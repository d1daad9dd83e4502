"""Figures of rigs, tracks, trajectories, fits, disparities and files: what they draw, and that they can be read."""

from dataclasses import replace
from functools import cache

import motion
import numpy as np
import pytest
from drawn_figures import require_readable
from matplotlib.collections import LineCollection
from moving_objects import glances
from rig_scenes import Errors, SimulatedRig, Transform, narrow_lens, observed, scene

from camcal.calibrate.fit import ShapeOptions
from camcal.calibrate.rigs.calibrate import calibrate_rig
from camcal.calibrate.rigs.record import RigOptions
from camcal.cameras.catalogue import model_named
from camcal.errors import InsufficientData
from camcal.estimate.curves.curve import Curve, Data
from camcal.estimate.curves.fit import fit_curve
from camcal.estimate.tracking.process_noise import ProcessNoise
from camcal.estimate.tracking.track import TrackOptions, track_poses
from camcal.formats.poses.record import PixelNoise, PoseKey, PoseRecord, Poses
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose, Trajectory
from camcal.quality.projection_uncertainty import projection_uncertainty
from camcal.report.figures.curves import fitted_curve, parameter_errors
from camcal.report.figures.disparity_errors import DisparityErrors, disparity_error_plots, disparity_map
from camcal.report.figures.figure import drawn
from camcal.report.figures.over_time import Panel, over_time, track_over_time, track_plots
from camcal.report.figures.rig import pose_plots, rig_plots
from camcal.report.figures.trajectories import path_of, trajectory_plots
from camcal.targets.board import Board

GATE = 22.0

# rigs


@cache
def rig_figures():
    rng = np.random.default_rng(1)
    lenses = tuple(narrow_lens(rng, (640, 480), focal) for focal in (600.0, 610.0))
    poses = (Transform.of([0, 0, 0], [0, 0, 0]), Transform.of([0.01, -0.03, 0.005], [-0.12, 0.002, 0.004]))
    rig = SimulatedRig(lenses, poses, Board("chessboard", 8, 5, 0.04))
    captures = observed(scene(rig, 8, 1), Errors(motion=2e-3), 1)
    models = {name: model_named(lens.model) for name, lens in zip(rig.cameras, rig.lenses, strict=True)}
    flat = ShapeOptions(smooth=False, offsets=False)
    found = calibrate_rig(captures, rig.board, RigOptions(models, shape=flat, motion=True))
    uncertainties = {
        name: projection_uncertainty(own.camera, observed=own.pixels) for name, own in found.calibrations.items()
    }
    return found, {plot.name: plot for plot in rig_plots(found, uncertainties, {})}


@pytest.mark.slow
def test_a_rig_has_its_own_figures_and_those_of_each_camera():
    names = list(rig_figures()[1])
    assert names[:4] == ["rig", "epipolar_errors", "exposure_motion", "covariance_right_T_left"]
    own = {name.removeprefix("left_") for name in names if name.startswith("left_")}
    assert own == {name.removeprefix("right_") for name in names if name.startswith("right_")} >= {"coverage", "poses"}


@pytest.mark.slow
def test_the_figures_of_a_rig_are_readable():
    for name in ("rig", "epipolar_errors", "exposure_motion", "covariance_right_T_left", "left_projection_uncertainty"):
        require_readable(rig_figures()[1][name])


@pytest.mark.slow
def test_the_epipolar_errors_of_captures_add_up_to_that_of_all():
    found, plots = rig_figures()
    assert len(found.epipolar_by_capture) == len(found.captures)
    # nearly all captures show the whole board to both cameras
    assert np.sqrt(np.mean(found.epipolar_by_capture**2)) == pytest.approx(found.epipolar_rms_px, rel=0.05)
    bars = [bar.get_width() for bar in drawn(plots["epipolar_errors"]).axes[0].patches]
    assert bars == pytest.approx(sorted(found.epipolar_by_capture, reverse=True))


@pytest.mark.slow
def test_the_motion_of_every_capture_is_drawn_in_millimetres():
    found, plots = rig_figures()
    bars = [bar.get_width() for bar in drawn(plots["exposure_motion"]).axes[0].patches]
    assert bars[0] == pytest.approx(1e3 * found.motion.largest)
    assert 1 < np.median(bars) < 10  # 2 mm along each axis


# tracks and trajectories


@cache
def followed():
    rng = np.random.default_rng(1)
    middle = Pose(so3.about_x(2.6), np.array([0.0, 0.0, 1.0]))
    truth = motion.drifting(np.arange(60) / 30, middle, (0.02, 0.5), rng)
    good, bad = glances(truth, rng), glances(truth, rng, outliers=1.0)
    poses = [*good[:30], bad[30], *good[31:]]
    track = track_poses(truth.stamps, poses, TrackOptions(ProcessNoise(0.02, 0.5)))
    return truth, track, [None if each is None else each.transform for each in poses]


def test_the_figures_of_a_track_are_readable_and_count_its_states():
    _, track, single = followed()
    plots = track_plots(track, single, GATE)
    assert [plot.name for plot in plots] == ["position", "rotation", "innovations"]
    for plot in plots:
        require_readable(plot)
    assert f"{track.count('rejected')} rejected (crosses)" in plots[0].caption
    assert track.count("rejected") == 1


def test_the_positions_of_a_track_are_drawn_in_millimetres():
    _, track, single = followed()
    axes = drawn(track_plots(track, single, GATE)[0]).axes[2]
    line = next(line for line in axes.lines if line.get_label() == "track")
    assert line.get_ydata() == pytest.approx(1e3 * track.translations[track.posed, 2])


def test_the_one_figure_of_a_track_holds_the_three():
    _, track, single = followed()
    assert len(drawn(track_over_time(track, single, "camera_T_board", GATE)).axes) == 7


def spiral(count=80, rise=0.5):
    time = np.linspace(0, 8, count)
    places = np.stack([np.cos(time), np.sin(time), rise * time / 8], axis=1)
    return Trajectory("world_T_camera", time, np.broadcast_to(np.eye(3), (count, 3, 3)), places)


def test_a_trajectory_is_readable_with_equal_lengths_along_all_axes():
    planes, space = trajectory_plots(path_of(spiral()))
    figure = require_readable(planes)
    for axes in figure.axes[:3]:
        assert axes.get_aspect() == 1
    require_readable(space)
    assert "80 poses" in planes.caption


def test_the_path_is_drawn_through_its_places_between_start_and_end():
    path = path_of(spiral())
    axes = drawn(trajectory_plots(path)[0]).axes[0]
    line = next(each for each in axes.collections if isinstance(each, LineCollection))
    assert len(line.get_segments()) == 79
    ends = {line.get_label(): line.get_xydata()[0] for line in axes.lines}
    assert ends["start"] == pytest.approx(path.places[0, :2])
    assert ends["end"] == pytest.approx(path.places[-1, :2])


def test_no_line_leads_from_one_segment_to_the_next():
    halves = replace(spiral(), segments=np.repeat([0, 1], 40))
    axes = drawn(trajectory_plots(path_of(halves))[0]).axes[0]
    line = next(each for each in axes.collections if isinstance(each, LineCollection))
    assert len(line.get_segments()) == 78


def test_with_a_reference_the_colours_are_errors_after_alignment():
    truth = spiral()
    moved = replace(truth, translations=truth.translations + np.array([5.0, 0, 0]))
    noisy = replace(moved, translations=moved.translations + 0.01 * np.sin(9 * truth.stamps)[:, None])
    path = path_of(noisy, truth)
    assert path.label == "error, mm"
    assert np.sqrt(np.mean(path.colours**2)) == pytest.approx(10 * np.sqrt(3 / 2), rel=0.1)
    plots = trajectory_plots(path)
    assert [plot.name for plot in plots] == ["trajectory_planes", "trajectory_space", "trajectory_error"]
    for plot in plots:
        require_readable(plot)


def test_a_flat_or_short_trajectory_is_drawn_too():
    require_readable(trajectory_plots(path_of(spiral(rise=0.0)))[0])
    require_readable(trajectory_plots(path_of(spiral(count=2)))[0])


def test_a_path_along_a_line_leaves_room_for_the_numbers_of_its_axes():
    time = np.linspace(0, 1, 20)
    places = np.stack([0.1 * time, 0.005 * time, 0.3 - 0.12 * time], axis=1)
    straight = Trajectory("camera_T_object", time, np.broadcast_to(np.eye(3), (20, 3, 3)), places)
    for plot in trajectory_plots(path_of(straight)):
        require_readable(plot)


def test_poses_without_an_order_are_points_without_a_line():
    rng = np.random.default_rng(4)
    keys = [PoseKey(f"{number}.png") for number in range(6)]
    records = [
        PoseRecord(Pose(np.eye(3), rng.normal(0, 0.1, 3)), np.eye(6), np.eye(6), "ok", 0.1 * (1 + n), 0.5, 20, 20)
        for n in range(6)
    ]
    plots = pose_plots(Poses("camera_T_object", "m", PixelNoise(0.1), dict(zip(keys, records, strict=True))))
    figure = require_readable(plots[0])
    assert not any(isinstance(each, LineCollection) for each in figure.axes[0].collections)
    places = np.asarray(figure.axes[0].collections[0].get_offsets())
    assert places == pytest.approx(1e3 * np.array([record.transform.translation[:2] for record in records]))
    drawn(plots[1])
    with pytest.raises(InsufficientData):
        pose_plots(Poses("camera_T_object", "m", PixelNoise(0.1), {}))


# series, fits


def test_a_series_shows_its_band_and_its_outliers():
    time = np.arange(50) / 10
    values = np.sin(time)
    outliers = np.zeros(50, bool)
    outliers[[7, 20]] = True
    panels = [
        Panel(name, (time, values, np.full(50, 0.1)), (time, values + 0.05), outliers) for name in ("x, m", "y, m")
    ]
    plot = over_time(panels)
    figure = require_readable(plot)
    assert "(crosses, 4)" in plot.caption
    band = figure.axes[0].collections[0].get_paths()[0].get_extents()
    assert (band.y0, band.y1) == pytest.approx((values.min() - 0.2, values.max() + 0.2), abs=0.01)


def line_fit():
    x = np.linspace(0, 10, 30)
    rng = np.random.default_rng(2)
    data = Data({"x": x}, 2 * x + 1 + rng.normal(0, 0.1, 30))
    return fit_curve(Curve.of("line", ["a*x + b"], ["a", "b"]), data, {"a": 1.0, "b": 0.0})


def test_a_fitted_curve_goes_through_the_data():
    plot = fitted_curve(line_fit())
    axes = drawn(plot).axes[0]
    curve = axes.lines[-1].get_xydata()
    assert curve[:, 1] == pytest.approx(2 * curve[:, 0] + 1, abs=0.15)
    assert "0.0" in plot.caption
    assert "30 rows" in plot.caption


def test_standard_errors_are_shares_of_the_values():
    plot = parameter_errors(["a", "b"], np.array([2.0, -10.0]), np.array([0.1, 0.1]))
    points = require_readable(plot).axes[0].lines[0].get_xdata()
    assert points == pytest.approx([5.0, 1.0])


# disparities


def errors_of_a_map():
    rng = np.random.default_rng(3)
    errors = rng.normal(0, 0.3, (60, 90))
    errors[:10] = 5.0
    errors[10:15] = np.nan
    known = np.ones(errors.shape, bool)
    known[-5:] = False
    visible = np.ones(errors.shape, bool)
    visible[:, :9] = False
    return DisparityErrors(errors, known, visible)


def test_the_figures_of_disparity_errors_are_readable():
    for plot in disparity_error_plots(errors_of_a_map()):
        require_readable(plot)
    require_readable(disparity_map(errors_of_a_map().errors + 20))


def test_a_map_without_a_match_is_drawn_too():
    nothing = np.full((20, 30), np.nan)
    everywhere = np.ones(nothing.shape, bool)
    for plot in (disparity_map(nothing), *disparity_error_plots(DisparityErrors(nothing, everywhere, everywhere))):
        assert drawn(plot).axes
        assert "nan" not in plot.caption


def test_bad_pixels_are_those_beyond_the_threshold_and_those_without_a_disparity():
    found = errors_of_a_map()
    assert found.bad_percent(2.0) == pytest.approx(100 * 15 / 55, abs=0.5)
    plot = disparity_error_plots(found)[2]
    assert f"{found.bad_percent(2.0):.2f} %" in plot.caption
    kinds = drawn(plot).axes[0].images[0].get_array()
    assert [int((kinds == kind).sum()) for kind in (1, 2, 3, 4)] == [10 * 81, 5 * 81, 55 * 9, 5 * 90]


def test_the_error_map_leaves_out_what_has_no_truth():
    image = drawn(disparity_error_plots(errors_of_a_map())[1]).axes[0].images[0].get_array()
    assert np.ma.count_masked(np.ma.masked_invalid(image)) == 10 * 90
