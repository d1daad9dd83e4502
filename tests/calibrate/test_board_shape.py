"""Boards that are not what the drawing says, and boards that look the same from two ends."""

import numpy as np
import pytest
from observed import make_scene, turned

from camcal.calibrate.fit import ShapeOptions
from camcal.calibrate.intrinsics import Options, calibrate
from camcal.simulate import render
from camcal.simulate.scene import project_all
from camcal.targets.board import CLASSES, Board, basis
from camcal.targets.detection import BoardDetection

BOARD = Board("chessboard", 14, 9, 0.030)


@pytest.fixture(scope="module")
def large_scene():
    return make_scene(board=BOARD, count=30)


def calibrated(scene, seed=1, shape=render.FLAT, noise=0.15, options=None, **how):
    seen = scene.observe(seed, noise_px=noise, shape=shape, **how)
    return calibrate(seen, scene.board, options or Options(scene.camera.model))


def focal_error(calibration, scene):
    return abs(calibration.camera.value("fx") - scene.camera.value("fx")) / calibration.camera.std("fx")


@pytest.mark.parametrize(
    ("shape", "tier", "deflection"),
    [
        (render.bow(1e-3, 5e-4), "bow", 1.5e-3),
        (render.twist(5e-4), "twist", 1e-3),
        (render.cubic(5e-4), "cubic", None),
        (render.stretch(0.003), "stretch", None),
    ],
    ids=["bow", "twist", "cubic", "stretch"],
)
def test_a_deformed_board_does_not_bend_the_camera(large_scene, shape, tier, deflection):
    calibration = calibrated(large_scene, shape=shape)
    assert seen_classes(calibration.surface) == {tier}
    assert focal_error(calibration, large_scene) < 4
    if deflection:
        found, std = calibration.surface.deflection, calibration.surface.deflection_std
        assert abs(found - deflection) < 4 * std
        assert std < 0.05 * deflection
    flat = calibrated(
        large_scene, shape=shape, options=Options(large_scene.camera.model, shape=ShapeOptions(smooth=False))
    )
    assert flat.surface.terms == ()
    assert flat.surface.offsets is None
    assert flat.rms_px > calibration.rms_px


def test_stretch_is_reported_with_its_correlation_to_the_focal_lengths(large_scene):
    calibration = calibrated(large_scene, shape=render.stretch(0.003))
    index = calibration.surface.terms.index("x/y scale")
    found, std = calibration.surface.coefficients[index], calibration.surface.coefficients_std()[index]
    assert abs(found - 0.003) < 4 * std
    assert {("x/y scale", "fx"), ("x/y scale", "fy")} <= set(calibration.correlations)


def seen_classes(surface):
    """The classes with a coefficient that is beyond 4.5 standard deviations."""
    sizes = dict(zip(surface.terms, np.abs(surface.coefficients) / surface.coefficients_std(), strict=True))
    return {name for name, own in CLASSES.items() if any(sizes[term] > 4.5 for term in own.terms)}


def test_a_flat_board_stays_flat(large_scene):
    surfaces = [calibrated(large_scene, seed=seed).surface for seed in range(4)]
    assert [seen_classes(surface) for surface in surfaces] == [set()] * 4
    # 30 views of 126 corners tell a height to about a hundredth of a millimetre
    assert max(surface.deflection for surface in surfaces) < 1e-4
    assert max(surface.classes["corners in plane"][0] for surface in surfaces) < 5e-5


def test_outliers_are_listed_and_do_no_harm(large_scene):
    calibration = calibrated(large_scene, shape=render.bow(1e-3, 5e-4), outliers=0.01)
    assert focal_error(calibration, large_scene) < 4
    clean = large_scene.observe(1, noise_px=0.15, shape=render.bow(1e-3, 5e-4))
    exact = {(view.image, int(i)): pixel for view in clean for i, pixel in zip(view.ids, view.pixels, strict=True)}
    moved = [np.linalg.norm(corner.pixel - exact[corner.image, corner.id]) > 1 for corner in calibration.rejected]
    share = len(calibration.rejected) / sum(len(view.ids) for view in clean)
    assert 0.006 < share < 0.015
    assert np.mean(moved) > 0.95


def test_single_lifted_corners_are_freed_where_they_were_seen_often(large_scene):
    rng = np.random.default_rng(0)
    offsets = 2e-4 * rng.normal(size=(BOARD.count, 3))
    seen = observe_with(large_scene, offsets)
    free = calibrate(seen, BOARD, Options(large_scene.camera.model))
    assert free.surface.offsets is not None
    assert focal_error(free, large_scene) < 4
    held = calibrate(seen, BOARD, Options(large_scene.camera.model, shape=ShapeOptions(offsets=False)))
    assert held.surface.offsets is None
    assert free.rms_px < 0.8 * held.rms_px


def observe_with(scene, offsets):
    rng = np.random.default_rng(6)
    rotations, translations = (
        np.stack(part) for part in zip(*((p.rotation, p.translation) for p in scene.poses), strict=True)
    )
    pixels, valid = project_all(scene.camera, BOARD.points() + offsets, rotations, translations)
    assert valid.all()
    noise = 0.15 * rng.normal(size=pixels.shape)
    ids = np.arange(BOARD.count)
    return [BoardDetection(f"{i}.png", scene.camera.image_size, ids, view) for i, view in enumerate(pixels + noise)]


@pytest.mark.parametrize("seed", [1, 2])
def test_views_numbered_from_either_end_give_the_same_camera(even_scene, seed):
    shape = render.bow(5e-4, 3e-4) + render.cubic(6e-4)
    seen = even_scene.observe(seed, noise_px=0.1, shape=shape)
    straight = calibrate(seen, even_scene.board, Options(even_scene.camera.model))
    flips = np.random.default_rng(seed).integers(0, 2, len(seen))
    mixed = [turned(view, even_scene.board, flip) for view, flip in zip(seen, flips, strict=True)]
    sorted_out = calibrate(mixed, even_scene.board, Options(even_scene.camera.model))
    spread = np.sqrt(np.diag(straight.camera.covariance))
    difference = (sorted_out.camera.parameters - straight.camera.parameters) / spread
    assert np.abs(difference).max() < 0.1  # the same corners, so the same minimum
    assert sorted_out.surface.deflection == pytest.approx(straight.surface.deflection, rel=0.01)
    turns = np.array([view.symmetry for view in sorted_out.views])
    assert np.array_equal(turns, flips) or np.array_equal(turns, 1 - flips)


@pytest.mark.parametrize("seed", [2, 3])
def test_ends_that_no_view_tells_by_itself_are_told_by_all_views_together(seed):
    """Half of the views are numbered from the other end, and turning one of them lowers χ² by less than 9."""
    scene = make_scene(board=Board("chessboard", 10, 8, 0.030), count=12)
    seen = scene.observe(seed, noise_px=0.1, shape=render.bow(5e-4, 3e-4) + render.cubic(2e-4))
    seen = [turned(view, scene.board, index % 2) for index, view in enumerate(seen)]
    turns = np.array([view.symmetry for view in calibrate(seen, scene.board, Options(scene.camera.model)).views])
    assert (turns != np.roll(turns, 1)).all()


def test_square_boards_are_sorted_out_by_quarter_turns():
    scene = make_scene(board=Board("chessboard", 9, 9, 0.030), count=20)
    shape = render.bow(1e-3, 2e-4) + render.cubic(5e-4)
    seen = scene.observe(3, noise_px=0.1, shape=shape)
    straight = calibrate(seen, scene.board, Options(scene.camera.model))
    mixed = [turned(view, scene.board, index % 4 if index in (3, 6, 13) else 0) for index, view in enumerate(seen)]
    sorted_out = calibrate(mixed, scene.board, Options(scene.camera.model))
    spread = np.sqrt(np.diag(straight.camera.covariance))
    assert np.abs((sorted_out.camera.parameters - straight.camera.parameters) / spread).max() < 0.1


def test_the_basis_holds_nothing_that_a_pose_could_take():
    terms = tuple(term for name in ("twist", "bow", "cubic", "quartic") for term in CLASSES[name].terms)
    heights = basis(Board("chessboard", 201, 201, 1.0), terms)[:, 2]
    grid = Board("chessboard", 201, 201, 1.0).points()[:, :2] / 100 - 1
    plane = np.column_stack([np.ones(len(grid)), grid])
    # Legendre terms are orthogonal to the plane on a fine grid, up to its spacing
    overlap = plane.T @ heights / len(grid)
    assert np.abs(overlap).max() < 0.02
