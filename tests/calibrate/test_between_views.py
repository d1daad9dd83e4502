"""What is not the same in all views is found with its place and size; errors within views are not taken for it."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from observed import make_scene
from scipy.stats import norm

from camcal.calibrate import between_views
from camcal.calibrate.between_views import BetweenViews
from camcal.calibrate.fit import ShapeOptions
from camcal.calibrate.intrinsics import Options, calibrate
from camcal.calibrate.single_views import ViewOffsets
from camcal.targets.board import normalised

COUNT = 16
NOISE = 0.05
CLEAR = 3.6  # standard deviations: the highest limit of the verdict


@pytest.fixture(scope="module")
def scene():
    return make_scene(count=COUNT)


@pytest.fixture(scope="module")
def seen(scene):
    return scene.observe(1, noise_px=NOISE)


def compared(scene, views, offsets=False):
    shape = ShapeOptions(offsets=offsets)
    return calibrate(views, scene.board, Options(scene.camera.model, shape=shape)).between_views


def zoomed(scene, views, ratios):
    centre = np.array([scene.camera.value("cx"), scene.camera.value("cy")])
    return [
        replace(view, pixels=centre + (1 + ratio) * (view.pixels - centre))
        for view, ratio in zip(views, ratios, strict=True)
    ]


def moved(scene, views, shifts, chosen):
    """The views, chosen ones with the corners moved in the image as points (C, 2) m of the board are."""
    result = list(views)
    for index in chosen:
        pose, view = scene.poses[index], views[index]
        points = scene.board.points()[view.ids]
        there = scene.camera.project(pose.apply(points + np.pad(shifts[view.ids], ((0, 0), (0, 1))))).pixels
        result[index] = replace(view, pixels=view.pixels + there - scene.camera.project(pose.apply(points)).pixels)
    return result


def images(views, chosen):
    return tuple(views[index].image for index in chosen)


@pytest.mark.parametrize("seed", range(2, 6))
def test_nothing_is_clear_in_views_that_differ_by_noise(scene, seed):
    found = compared(scene, scene.observe(seed, noise_px=NOISE))
    assert max(found.step.clear, found.drift.clear, found.outlying.clear, found.unordered.clear) < CLEAR
    assert max(found.proportions.clear, found.boards.clear) < CLEAR
    assert found.blurred == ()


def test_a_step_of_the_focal_length_is_found_where_it_is_with_its_size(scene, seen):
    first = 6
    found = compared(scene, zoomed(scene, seen, np.where(np.arange(COUNT) < first, 0, 0.005)))
    assert found.step.clear > CLEAR
    assert found.step.clear > found.drift.clear
    assert abs(len(found.step.images) - (COUNT - first)) <= 1  # one view more or less may be as likely
    assert found.step.images == found.images[-len(found.step.images) :]
    assert found.step.share == pytest.approx(0.005, abs=0.001)
    assert found.images == images(seen, range(COUNT))


def test_a_drift_of_the_focal_length_is_clearer_than_a_step(scene, seen):
    found = compared(scene, zoomed(scene, seen, np.linspace(0, -0.006, COUNT)))
    assert found.drift.clear > max(CLEAR, found.step.clear)
    assert found.drift.share == pytest.approx(-0.006, abs=0.0015)
    assert found.drift.images == images(seen, range(COUNT))


def test_single_views_of_another_focal_length_are_named(scene, seen):
    ratios = np.zeros(COUNT)
    ratios[[3, 9]] = 0.02
    found = compared(scene, zoomed(scene, seen, ratios))
    assert found.outlying.clear > CLEAR
    assert found.outlying.images == images(seen, (3, 9))
    assert found.outlying.share == pytest.approx(0.02, abs=0.005)


def test_a_focal_length_that_varies_without_order_is_no_step(scene, seen):
    ratios = 0.006 * np.tile([1, -1, -1, 1], COUNT // 4)
    found = compared(scene, zoomed(scene, seen, ratios))
    assert found.unordered.clear > CLEAR
    assert found.unordered.share == pytest.approx(0.006, rel=0.4)
    assert max(found.step.clear, found.drift.clear, found.outlying.clear) < CLEAR


def test_a_board_of_other_proportions_is_found_where_it_comes_in(scene, seen):
    first = 9
    shifts = 0.004 * scene.board.points()[:, :2] * [1, 0]
    found = compared(scene, moved(scene, seen, shifts, range(first, COUNT)))
    assert found.proportions.clear > CLEAR
    assert found.proportions.images == images(seen, range(first, COUNT))
    assert abs(found.proportions.share) == pytest.approx(0.004, abs=0.001)
    assert found.proportions.clear > 1.5 * max(found.step.clear, found.drift.clear)


def test_a_board_printed_otherwise_is_found_where_it_comes_in_with_the_distance_of_its_corners(scene, seen):
    first = 5
    shifts = np.random.default_rng(4).normal(0, 0.004, (scene.board.count, 2)) * scene.board.spacing
    changed = moved(scene, seen, shifts, range(first, COUNT))
    found = compared(scene, changed, offsets=True)
    apart = [np.mean(np.sum((new.pixels - old.pixels) ** 2, axis=1)) for new, old in zip(changed, seen, strict=True)]
    assert found.boards.clear > CLEAR
    assert found.boards.images == images(seen, range(first, COUNT))
    assert found.boards.px == pytest.approx(np.sqrt(np.mean(apart[first:])), rel=0.25)


def test_a_board_printed_otherwise_is_found_in_views_of_any_order(scene, seen):
    shifts = np.random.default_rng(4).normal(0, 0.006, (scene.board.count, 2)) * scene.board.spacing
    chosen = (1, 2, 6, 9, 11, 14)
    found = compared(scene, moved(scene, seen, shifts, chosen), offsets=True)
    assert found.boards.clear > CLEAR
    assert found.boards.images == images(seen, chosen)


def test_fields_of_their_own_in_every_view_are_no_change_between_views(scene, seen):
    rng = np.random.default_rng(5)
    x, y = normalised(scene.board).T
    modes = np.stack([x**2 - 1 / 3, x * y, y**2 - 1 / 3, x**3 - 0.6 * x])
    fields = np.einsum("vkm,mp->vpk", rng.normal(0, 0.3, (COUNT, 2, 4)), modes)
    views = [replace(view, pixels=view.pixels + own[view.ids]) for view, own in zip(seen, fields, strict=True)]
    found = compared(scene, views)
    assert max(found.step.clear, found.drift.clear, found.outlying.clear, found.unordered.clear) < CLEAR
    assert max(found.proportions.clear, found.boards.clear) < CLEAR


def test_views_whose_corners_scatter_in_one_direction_are_listed_the_most_first(scene, seen):
    rng, views = np.random.default_rng(6), list(seen)
    for index, std in ((4, 0.4), (11, 0.8)):
        along = std * rng.normal(size=(len(views[index].ids), 1)) * [0.6, 0.8]
        views[index] = replace(views[index], pixels=views[index].pixels + along)
    found = compared(scene, views)
    assert [view.image for view in found.blurred] == list(images(seen, (11, 4)))
    assert found.blurred[0].px == pytest.approx(0.8, rel=0.3)
    assert found.blurred[0].ratio > found.blurred[1].ratio > 4


def test_a_view_that_is_noisier_in_all_directions_is_not_blurred(scene, seen):
    views = list(seen)
    noisier = views[4].pixels + np.random.default_rng(7).normal(0, 0.5, (len(views[4].ids), 2))
    views[4] = replace(views[4], pixels=noisier)
    assert compared(scene, views).blurred == ()


def test_of_many_views_some_are_compared_and_all_after_a_change_are_named(scene, seen, monkeypatch):
    monkeypatch.setattr(between_views, "_VIEWS", 9)
    ratios = np.where(np.arange(COUNT) < 7, 0, 0.01)
    found = compared(scene, zoomed(scene, seen, ratios))
    assert found.images == images(seen, range(COUNT))
    assert found.step.clear > CLEAR
    assert abs(len(found.step.images) - (COUNT - 7)) <= 2
    assert found.step.images == found.images[-len(found.step.images) :]


def test_of_views_that_determine_nothing_nothing_is_said(scene, seen, monkeypatch):
    def fails(*_):
        raise np.linalg.LinAlgError

    monkeypatch.setattr(between_views.ViewOffsets, "of", fails)
    assert compared(scene, seen) == BetweenViews(images(seen, range(COUNT)))


def test_a_step_is_found_under_a_lens_that_is_held(scene, seen):
    views = zoomed(scene, seen, np.where(np.arange(COUNT) < 8, 0, 0.005))
    options = Options(scene.camera.model, scene.camera.model.parameter_names, scene.camera, ShapeOptions(offsets=False))
    step = calibrate(views, scene.board, options).between_views.step
    assert step.clear > CLEAR
    assert step.share == pytest.approx(0.005, abs=0.001)


def test_of_few_views_nothing_is_said(scene, seen):
    assert compared(scene, seen[:4]) == BetweenViews(images(seen, range(4)))


@pytest.mark.parametrize("noise", [0.0, 0.3])
def test_noise_adds_nothing_to_the_distance_of_two_boards(noise):
    rng = np.random.default_rng(7)
    second = np.arange(20) >= 8
    apart = rng.normal(0, 0.2, (50, 3))
    px = rng.normal(0, noise, (20, 50, 3)) + np.where(second, 0.5, -0.5)[:, None, None] * apart
    found = between_views._distance(px.reshape(20, -1), second)
    assert found == pytest.approx(np.sqrt(np.mean(np.sum(apart**2, axis=1))), rel=0.05)


@pytest.mark.parametrize("count", [12, 50])
def test_a_step_is_as_clear_as_it_is_rare_among_views_that_differ_by_noise(count):
    """One in ten sets has a change that clear by chance, wherever it is; τ above zero takes some of them."""
    rng = np.random.default_rng(8)
    images = tuple(map(str, range(count)))
    sets = [ViewOffsets(rng.normal(size=count), np.eye(count)[:, :, None], np.ones(count)) for _ in range(400)]
    clear = sum(between_views._step(own, images).clear > norm.isf(0.05) for own in sets)
    assert 0.05 * 400 < clear < 0.15 * 400


class Compared(Exception):
    """That views are compared, with the places of those that are."""


def places_compared(monkeypatch, count):
    def linearise(_, chosen):
        raise Compared(chosen)

    monkeypatch.setattr(between_views._Linearised, "of", linearise)
    with pytest.raises(Compared) as compared:
        between_views.between_views([None], [str(number) for number in range(count)])
    return compared.value.args[0]


def test_five_views_are_compared_and_of_many_no_more_than_sixty(monkeypatch):
    assert len(places_compared(monkeypatch, 5)) == 5
    chosen = places_compared(monkeypatch, 100)
    assert (len(chosen), chosen[0], chosen[-1]) == (60, 0, 99)


def test_a_change_has_two_views_on_either_side():
    assert between_views._places(8).tolist() == [2, 3, 4, 5, 6]


def outlying(*clear):
    """The views that are named of sixteen, where the likeliest differ so clearly, one after another."""
    found = iter(SimpleNamespace(index=index, size=[0.01], clear=lambda _, c=c: c) for index, c in enumerate(clear))
    focal = SimpleNamespace(likeliest=lambda *_: next(found))
    return between_views._outlying(focal, tuple(map(str, range(COUNT)))).images


def test_views_that_differ_by_three_standard_deviations_are_named_with_the_one_that_differs_most():
    assert outlying(10.0, 3.5, 2.9) == ("0", "1")
    assert outlying(10.0, 2.9) == ("0",)


def test_a_quarter_of_the_views_at_most_is_named():
    assert outlying(*[10.0] * COUNT) == ("0", "1", "2", "3")


@pytest.mark.parametrize(("corners", "apart"), [(4, False), (5, True)])
def test_views_with_five_corners_in_common_tell_how_far_two_boards_are_apart(corners, apart):
    second = np.array([False, False, True, True])
    px = np.where(second, 0.5, -0.5)[:, None] * np.ones(3 * corners)
    assert (between_views._distance(px, second) > 0) == apart


@pytest.mark.parametrize(("unlikely", "named"), [(17.7, ()), (19.1, ("0",))])
def test_a_view_is_blurred_if_less_than_one_set_in_a_thousand_looks_so_by_chance(unlikely, named):
    """Mauchly's statistic of one of ten views, whose limit is 2 log(10 / 0.001) = 18.4."""
    views, corners = 10, 40
    share = np.exp(unlikely / corners)  # (a + b)² / 4ab of variances a and b
    residuals = np.ones((2, views, corners))
    residuals[0, :, ::2], residuals[1, :, : corners // 2] = -1, -1
    residuals[0, 0] *= np.sqrt(2 * share - 1 + 2 * np.sqrt(share * (share - 1)))
    full = SimpleNamespace(weights=np.ones((views, corners)), residuals=residuals)
    found = between_views._blurred(full, tuple(map(str, range(views))))
    assert tuple(view.image for view in found) == named
