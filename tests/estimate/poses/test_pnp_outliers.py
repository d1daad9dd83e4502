"""Poses where points are wrong: against the fit to the right ones alone, on the same trials."""

from dataclasses import fields as dataclass_fields
from dataclasses import replace
from math import comb

import numpy as np
import pytest
from scipy.stats import chi2

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.errors import InsufficientData
from camcal.estimate.pnp import estimate_poses
from camcal.estimate.poses import fits, inliers, pose_quality, samples
from camcal.estimate.poses import states as se3
from camcal.estimate.poses.inliers import likeliest_threshold
from camcal.estimate.poses.packed_correspondences import Group, PackedCorrespondences
from camcal.estimate.poses.pose_quality import region_quantile
from camcal.estimate.poses.problem import PoseProblems
from camcal.estimate.poses.records import Correspondences, PoseOptions
from camcal.geometry.pose import Pose

PINHOLE = Camera(model_named("pinhole"), (1280, 960), [800.0, 805.0, 640.0, 480.0])
FISHEYE = Camera(model_named("kannala_brandt4"), (1400, 1400), [320.0, 320.0, 700.0, 700.0, 0.01, -0.004, 1e-3, -1e-4])
BOARD = np.array([[x - 4, y - 2.5, 0.0] for y in range(6) for x in range(9)]) * 0.03
WIDTH = 3.4391  # standard deviations: the default threshold


def spoilt(camera, rng, points, share, noise_px=1.0, distance=(1.5, 3.0)):
    """Return a view with a share of its pixels anywhere in the image, the mask of the right ones, and the pose."""
    while True:
        place = np.append(rng.normal(0, 0.15, 2), rng.uniform(*distance))
        truth = Pose.from_vector(rng.normal(0, 0.5, 3), place)
        projection = camera.project(truth.apply(points))
        if projection.valid.all():
            break
    right = np.arange(len(points)) >= round(share * len(points))
    pixels = projection.pixels + noise_px * rng.standard_normal((len(points), 2))
    pixels[~right] = rng.uniform(0, np.array(camera.image_size) - 1.0, (np.count_nonzero(~right), 2))
    return Correspondences("view", points, pixels), right, truth


def error_of(found, truth):
    return np.concatenate([found.translation - truth.translation, (found @ truth.inverse()).vector()])


def estimate(camera, view, **options):
    outcome = estimate_poses(camera, [view], PoseOptions(**options))[0]
    assert outcome.error is None, outcome.error
    return outcome.value


@pytest.mark.parametrize("flat", [False, True], ids=["solid", "plane"])
@pytest.mark.parametrize("share", [0.0, 0.5, 0.8])
def test_random_samples_come_to_the_fit_of_the_right_points(flat, share):
    rng = np.random.default_rng(1)
    errors, references = [], []
    for _ in range(6):
        points = rng.uniform(-0.5, 0.5, (100, 3)) * [1, 1, 0 if flat else 1]
        view, right, truth = spoilt(PINHOLE, rng, points, share)
        found = estimate(PINHOLE, view, noise_px=1.0, outliers="many")
        best = estimate(PINHOLE, view.take(right), noise_px=1.0)
        errors.append(error_of(found.transform, truth))
        references.append(error_of(best.transform, truth))
        assert np.count_nonzero(found.inliers & ~right) <= 1
        assert np.count_nonzero(right & ~found.inliers) <= 4  # 0.3 % of 100 are expected beyond the threshold
    ratio = np.sqrt(np.mean(np.square(errors), axis=0) / np.mean(np.square(references), axis=0))
    assert np.exp(np.log(ratio).mean()) < 1.1  # six paired trials; the benchmark has the figures


@pytest.mark.parametrize(("outliers", "shares"), [("few", (0.04, 0.1)), ("many", (0.1, 0.4))])
def test_the_inliers_are_those_of_the_pose_returned(outliers, shares):
    rng = np.random.default_rng(2)
    for share in shares:
        view, _, _ = spoilt(PINHOLE, rng, BOARD, share, 0.5, (0.5, 1.0))
        found = estimate(PINHOLE, view, noise_px=0.5, outliers=outliers)
        within = np.linalg.norm(found.residuals, axis=1) <= 0.5 * WIDTH
        np.testing.assert_array_equal(found.inliers, within)
        assert found.used == np.count_nonzero(within)
        assert np.isfinite(found.residuals).all()  # those of the outliers are told as well


def test_a_few_wrong_corners_of_a_board_are_left_out_without_being_told_the_noise():
    rng = np.random.default_rng(3)
    seen = [spoilt(PINHOLE, rng, BOARD, 0.06, 0.2, (0.5, 1.0)) for _ in range(10)]
    outcomes = estimate_poses(PINHOLE, [view for view, _, _ in seen], PoseOptions(outliers="few"))
    for outcome, (_, right, truth) in zip(outcomes, seen, strict=True):
        assert not np.any(outcome.value.inliers & ~right)
        error = error_of(outcome.value.transform, truth)
        assert error @ np.linalg.solve(outcome.value.covariance, error) < 30  # χ² with 6: 4e-5 beyond
    # 10 × 51 points tell the noise to 3 %, their rejection at most another
    assert outcomes[0].value.sigma_px == pytest.approx(0.2, rel=0.1)


def test_a_clean_view_loses_no_more_than_the_threshold_says():
    rng = np.random.default_rng(4)
    views = [spoilt(PINHOLE, rng, BOARD, 0.0, 0.3, (0.5, 1.0))[0] for _ in range(40)]
    plain = estimate_poses(PINHOLE, views)
    few = estimate_poses(PINHOLE, views, PoseOptions(outliers="few"))
    lost = sum(np.count_nonzero(~outcome.value.inliers) for outcome in few)
    assert lost <= 16  # 0.27 % of 2160 points are 6 ± 2.4
    assert few[0].value.sigma_px == pytest.approx(plain[0].value.sigma_px, rel=0.02)


def test_clean_boards_have_no_gross_errors():
    rng = np.random.default_rng(5)
    for _ in range(8):
        view, _, truth = spoilt(PINHOLE, rng, BOARD, 0.0, 0.3, (0.5, 1.5))
        found = estimate(PINHOLE, view, noise_px=0.3, outliers="many")
        assert np.linalg.norm(error_of(found.transform, truth)[3:]) < np.radians(5)


def test_samples_work_beyond_ninety_degrees():
    rng = np.random.default_rng(6)
    theta, phi = rng.uniform(0, np.radians(110), 60), rng.uniform(0, 2 * np.pi, 60)
    points = np.column_stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])
    points *= rng.uniform(1, 2, (60, 1))
    view, right, truth = spoilt(FISHEYE, rng, points, 0.4, 0.5, (0.0, 0.2))
    assert np.any(truth.apply(points)[right][:, 2] < 0)
    found = estimate(FISHEYE, view, noise_px=0.5, outliers="many")
    assert np.linalg.norm(error_of(found.transform, truth)) < 0.02  # 0.5 px over 320 px, 36 points


def test_the_same_seed_gives_the_same_pose_in_any_company():
    rng = np.random.default_rng(7)
    views = [spoilt(PINHOLE, rng, rng.uniform(-0.5, 0.5, (40, 3)), 0.75)[0] for _ in range(3)]
    options = PoseOptions(noise_px=1.0, outliers="many", seed=4)
    together = estimate_poses(PINHOLE, views, options)
    for view, outcome in zip(views, together, strict=True):
        alone = estimate_poses(PINHOLE, [view], options)[0].value
        np.testing.assert_allclose(error_of(alone.transform, outcome.value.transform), 0, atol=1e-9)
        np.testing.assert_array_equal(alone.inliers, outcome.value.inliers)


PINHOLE_TYPE = type(PINHOLE.model)


class CountingPinhole(PINHOLE_TYPE):
    """A pinhole that notes how many points it projects."""

    projected = 0

    def project(self, parameters, points):
        CountingPinhole.projected += len(points)
        return super().project(parameters, points)


def test_samples_are_scored_without_projecting_every_point_by_every_pose():
    rng, points = np.random.default_rng(41), 100
    model = CountingPinhole(
        **{each.name: getattr(PINHOLE.model, each.name) for each in dataclass_fields(PINHOLE.model)}
    )
    camera = replace(PINHOLE, model=model)
    view, right, truth = spoilt(camera, rng, rng.uniform(-0.5, 0.5, (points, 3)), 0.8)
    CountingPinhole.projected = 0
    found = estimate(camera, view, noise_px=1.0, outliers="many")
    assert found.inliers[right].all()
    assert np.linalg.norm(error_of(found.transform, truth)) < 0.05
    assert CountingPinhole.projected < 200 * points  # about 1000 triplets are drawn, each of which has two poses


def test_scores_of_samples_are_the_truncated_errors_through_the_lens():
    rng, criterion = np.random.default_rng(42), inliers.InlierCriterion(WIDTH, 4)
    frame = Pose.from_vector(np.array([0.1, -0.2, 0.3]), np.array([0.2, -0.1, 0.05]))
    view, _, truth = spoilt(FISHEYE, rng, rng.uniform(-0.5, 0.5, (60, 3)), 0.5)
    view = replace(view, covariance=np.tile([[0.5, 0.2], [0.2, 1.5]], (60, 1, 1)))
    problems = PoseProblems.of((PackedCorrespondences.of(FISHEYE, [view], frame),))
    states = se3.retract(np.repeat(se3.of_poses([frame.inverse() @ truth]), 30, axis=0), rng.normal(0, 2e-3, (30, 6)))
    search = samples._Search.of(problems, 0, criterion, seed=0)
    exact = 2 * inliers.truncated_cost(problems, states, np.zeros(30, int), criterion)
    np.testing.assert_allclose(search.scores(states), exact, rtol=0.01)  # first order in residuals of 3 px


def test_points_and_pixels_that_do_not_belong_together_are_refused_or_weak():
    rng = np.random.default_rng(8)
    for count in (8, 20):
        points = rng.uniform(-0.5, 0.5, (count, 3))
        view = Correspondences("mixed", points, rng.uniform(0, 900, (count, 2)))
        outcome = estimate_poses(PINHOLE, [view], PoseOptions(noise_px=0.5, outliers="many"))[0]
        if outcome.error is None:
            assert outcome.value.status.split(":")[0] in ("weak", "ambiguous")
        else:
            assert isinstance(outcome.error, InsufficientData)
            assert "check that points and pixels correspond" in str(outcome.error)


@pytest.mark.parametrize("outliers", ["few", "many"])
def test_right_points_that_are_off_by_a_little_more_than_most_are_kept(outliers):
    rng = np.random.default_rng(12)
    for _ in range(10):
        view, _, truth = spoilt(PINHOLE, rng, rng.uniform(-0.5, 0.5, (30, 3)), 0.0, noise_px=0.0)
        pixels = view.pixels + 0.3 * rng.standard_normal((30, 2))
        pixels[0] = view.pixels[0] + 0.3 * np.array([4.2, 0.0])  # standard deviations; one of 7000 points is as far off
        pixels[1] = view.pixels[1] + 0.3 * np.array([0.0, 12.0])
        found = estimate(PINHOLE, replace(view, pixels=pixels), noise_px=0.3, outliers=outliers)
        np.testing.assert_array_equal(np.flatnonzero(~found.inliers), [1])
        assert np.linalg.norm(error_of(found.transform, truth)) < 0.05


def test_the_likeliest_threshold_is_where_right_and_wrong_are_equally_likely():
    rng = np.random.default_rng(13)
    view, right, _ = spoilt(PINHOLE, rng, rng.uniform(-0.5, 0.5, (40, 3)), 0.25)
    known = replace(view, covariance=np.tile(0.25 * np.eye(2), (40, 1, 1)))
    problems = PoseProblems.of((PackedCorrespondences.of(PINHOLE, [known], Pose.identity()),))
    sigma, area = 1.6, 1e6
    (threshold,) = likeliest_threshold(problems, (right[None],), np.array([area]), sigma)
    share, variance = 10.5 / 41, 0.25 * sigma**2
    density = (1 - share) / (2 * np.pi * variance) * np.exp(-0.5 * (threshold / sigma) ** 2)
    assert density == pytest.approx(share / area, rel=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("flat", [False, True])
@pytest.mark.parametrize(("count", "share"), [(12, 0.3), (30, 0.0), (30, 0.5), (30, 0.8)])
def test_regions_hold_what_they_claim_among_wrong_points(flat, count, share):
    rng = np.random.default_rng(14)
    made = [spoilt(PINHOLE, rng, rng.uniform(-0.5, 0.5, (count, 3)) * [1, 1, not flat], share) for _ in range(400)]
    views, truths = [view for view, _, _ in made], [truth for _, _, truth in made]
    outcomes = estimate_poses(PINHOLE, views, PoseOptions(noise_px=1.0, outliers="many"))
    # six right points in a plane may have two poses, or too few that agree: their status says so
    sound = [(own.value, truth) for own, truth in zip(outcomes, truths, strict=True) if own.value.status == "ok"]
    assert len(sound) > 380
    errors = [error_of(found.transform, truth) for found, truth in sound]
    squares = [e @ np.linalg.solve(found.covariance, e) for e, (found, _) in zip(errors, sound, strict=True)]
    assert 0.92 < np.mean(np.array(squares) < region_quantile(0.95, None)) < 0.98  # 2.8 standard deviations of 400


def test_a_threshold_is_in_pixels_whatever_the_pixels_come_with():
    rng = np.random.default_rng(9)
    view, _, _ = spoilt(PINHOLE, rng, rng.uniform(-0.5, 0.5, (80, 3)), 0.4)
    known = replace(view, covariance=np.tile(0.01 * np.eye(2), (80, 1, 1)))
    for outliers in ("few", "many"):
        found = estimate(PINHOLE, known, noise_scale=10.0, outliers=outliers, threshold_px=2.0)
        lengths = np.linalg.norm(found.residuals, axis=1)
        assert lengths[found.inliers].max() < 2.0 < lengths[~found.inliers].min()


def test_covariances_scale_the_threshold():
    rng = np.random.default_rng(9)
    view, right, truth = spoilt(PINHOLE, rng, rng.uniform(-0.5, 0.5, (80, 3)), 0.4)
    weighted = replace(view, covariance=np.tile(4.0 * np.eye(2), (80, 1, 1)))
    found = estimate(PINHOLE, weighted, noise_scale=0.5, outliers="many")
    np.testing.assert_array_equal(found.inliers, estimate(PINHOLE, view, noise_px=1.0, outliers="many").inliers)
    assert np.linalg.norm(error_of(found.transform, truth)) < 0.05
    assert np.mean(found.inliers == right) > 0.95


def test_the_variance_that_a_cut_leaves_is_that_of_normal_coordinates():
    """Of the density s e^(-s/2) / 4 of χ² with four degrees of freedom: see the mean of s = d² below a cut."""
    assert chi2.cdf(inliers.WIDTH**2, 2) == pytest.approx(0.9973, abs=1e-5)
    assert pytest.approx(chi2.cdf(WIDTH**2, 4) / chi2.cdf(WIDTH**2, 2), abs=2e-5) == inliers.KEPT_VARIANCE
    assert chi2.median(2) == pytest.approx(inliers.MEDIAN, abs=1e-5)


def test_triplets_have_three_different_points_and_all_are_as_likely():
    found = samples._triplets(np.arange(10, 15), 30_000, np.random.default_rng(3))
    triplets, counts = np.unique(found, axis=0, return_counts=True)
    assert len(triplets) == 5 * 4 * 3
    assert all(len(set(triplet)) == 3 for triplet in triplets.tolist())
    assert counts == pytest.approx(500, abs=5 * np.sqrt(500))


@pytest.mark.parametrize("points", [6, 10])
def test_the_noise_by_the_median_is_the_true_one_for_few_points_too(points):
    """Six parameters follow the residuals of each view: of six points, half of the variance is left."""
    rng = np.random.default_rng(34)
    views = [spoilt(PINHOLE, rng, rng.uniform(-0.4, 0.4, (points, 3)), 0.0, noise_px=0.5)[0] for _ in range(300)]
    group = Group.of([PINHOLE], [Pose.identity()], [[view] for view in views], np.arange(300))
    fit = fits._plain(group, PoseOptions())
    assert fits._robust_noise([fit]) == pytest.approx(0.5, rel=0.1)


@pytest.mark.parametrize("points", [4, 5])
@pytest.mark.parametrize("wrong", [0, 8])
def test_views_of_few_points_that_hold_a_wrong_one_do_not_raise_the_noise_of_the_others(points, wrong):
    rng = np.random.default_rng(35)
    tag = np.array([[-1, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0], [0, 0, 0]])[:points] * 0.2
    views = [spoilt(PINHOLE, rng, tag, 0.0, noise_px=0.3)[0] for _ in range(100)]
    off = np.zeros((points, 2))
    off[0] = 20.0
    views[:wrong] = [replace(view, pixels=view.pixels + off) for view in views[:wrong]]
    found = [outcome.value for outcome in estimate_poses(PINHOLE, views, PoseOptions(outliers="few"))]
    assert found[-1].noise_scale == pytest.approx(0.3, rel=0.12)  # of 184 residuals: 3 times 1 / sqrt(2 * 184)


def test_the_noise_of_videos_of_tags_whose_corners_jump_is_that_of_the_right_ones():
    """16 videos of tags of 25 to 100 px; of 3 % of the corners the pixels are off by 5 to 60 px."""
    tag, found = np.array([[-1, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0]]), []
    for seed in range(16):
        rng = np.random.default_rng([36, seed])
        side = rng.uniform(0.05, 0.2)
        views = [spoilt(PINHOLE, rng, tag * side / 2, 0.0, noise_px=0.3)[0] for _ in range(120)]
        for index, view in enumerate(views):
            turn, length = rng.uniform(0, 2 * np.pi, 4), rng.uniform(5.0, 60.0, 4) * (rng.random(4) < 0.03)
            off = length[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=1)
            views[index] = replace(view, pixels=view.pixels + off)
        outcomes = estimate_poses(PINHOLE, views, PoseOptions(outliers="few"))
        found.append(next(each.value.noise_scale for each in outcomes if each.value))
    np.testing.assert_allclose(found, 0.3, rtol=0.15)  # of some 210 residuals: 3 times 1 / sqrt(2 * 210)
    assert np.mean(found) == pytest.approx(0.3, rel=0.04)


def test_the_noise_leaves_out_one_right_view_of_few_points_in_a_hundred_thousand():
    """Squares as those of 400 views of four points are on average, and one more that is near the limit."""
    squares = 2.25 * chi2.ppf((np.arange(400) + 0.5) / 400, 2)
    limit = chi2.isf(1e-5, 2)
    share = chi2.cdf(limit, 4) / chi2.cdf(limit, 2)
    variance = squares.sum() / (800 * share)
    for times, kept in ((0.97, True), (1.03, False)):
        every = np.append(squares, times * limit * variance)
        ones = np.ones(len(every))
        counts, shares = fits._sound_views(every, 2 * ones, ones, ones > 0)
        assert (bool(counts[-1]), bool(counts[:-1].all())) == (kept, True)
        assert shares == pytest.approx(share)


def test_of_less_than_six_views_none_is_told_to_be_wrong_by_the_others():
    for count, kept in ((5, True), (6, False)):
        squares, ones = np.append(np.ones(count - 1), 1e3), np.ones(count)
        assert fits._sound_views(squares, 2 * ones, ones, ones > 0)[0][-1] == kept


@pytest.mark.parametrize(("moved", "rival"), [(4, True), (6, False)])
def test_a_mirrored_pose_is_followed_that_half_of_the_points_are_near_to(moved, rival):
    rng = np.random.default_rng(35)
    view, _, truth = spoilt(PINHOLE, rng, BOARD[:10], 0.0, noise_px=0.0)
    pixels = view.pixels.copy()
    pixels[:moved] += 10.0
    view = replace(view, pixels=pixels)
    problems = PoseProblems.of((PackedCorrespondences.of(PINHOLE, [view], Pose.identity()),))
    state, which = se3.of_poses([truth]), np.zeros(1, int)
    best = inliers.RefitPoses(state, which, (np.ones((1, 10), bool),), np.zeros(1))
    assert inliers._supported(problems, state, best, inliers.InlierCriterion(WIDTH, 4)).tolist() == [rival]


def test_the_poses_that_chance_gives_are_those_of_all_sets_of_inliers_and_of_three_points_in_them():
    """(n - 3) C(n, k) C(k, 3) α^(k - 3): three points have a pose in any case, the others agree by chance."""
    assert pose_quality._chance(20, 7, 0.1) == pytest.approx(17 * comb(20, 7) * comb(7, 3) * 0.1**4, rel=1e-9)
    assert pose_quality._chance(4, 3, 0.5) == pytest.approx(1 * 4 * 1, rel=1e-9)
