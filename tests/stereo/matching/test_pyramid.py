"""Large pairs by way of small ones: nearly as good as all at once, whatever their size."""

import numpy as np
import pytest
from layered import layered_pair

from camcal.stereo.disparity import Confidence
from camcal.stereo.matching.match import _halve_pair, match
from camcal.stereo.matching.preparation import gray_pair, noise_of
from camcal.stereo.matching.semi_global import aggregate
from camcal.stereo.options import ALL, BALANCED, BEST, FILLS, MatchOptions

LEFT, RIGHT, TRUTH, VISIBLE = layered_pair((320, 240), (7, 14, 22))


def bad2(found):
    return np.mean(~(np.abs(found.values - TRUTH) <= 2)[VISIBLE])


@pytest.mark.parametrize("quality", [BALANCED, BEST])
def test_a_pair_is_matched_nearly_as_well_by_way_of_its_half_and_quarter_size(monkeypatch, quality):
    options = MatchOptions(quality, fill=ALL)
    direct = match(LEFT, RIGHT, options)
    monkeypatch.setattr("camcal.stereo.matching.match.LARGEST", 13_000)
    stepwise = match(LEFT, RIGHT, options)
    assert bad2(stepwise) < bad2(direct) + 0.02  # edges are found to the pixel of a quarter of the size, or so
    known = VISIBLE & (stepwise.confidence > Confidence.FILLED)
    assert np.quantile(np.abs(stepwise.values - TRUTH)[known], 0.68) < 0.1
    assert stepwise.searched == direct.searched


def test_no_more_costs_are_held_than_there_is_room_for(monkeypatch):
    volumes = []

    def recorded(costs, guide):
        volumes.append(costs.nbytes)
        return aggregate(costs, guide)

    monkeypatch.setattr("camcal.stereo.matching.matchers.aggregate", recorded)
    monkeypatch.setattr("camcal.stereo.matching.match._MOST_COSTS", 1_000_000)
    match(LEFT, RIGHT, MatchOptions(BALANCED, (0, 63)))
    assert max(volumes) <= 1_000_000


def test_what_nothing_is_known_of_at_half_the_size_stays_unknown(monkeypatch):
    monkeypatch.setattr("camcal.stereo.matching.match.LARGEST", 2_000)
    left, right = LEFT[:60, :81], RIGHT[:60, :81]
    for quality in (BALANCED, BEST):
        for fill in FILLS:
            assert np.isnan(match(left, right, MatchOptions(quality, (300, 331), fill)).values).all()


@pytest.mark.parametrize("size", [(1, 240), (320, 1), (75, 41), (101, 75)])
@pytest.mark.parametrize("quality", [BALANCED, BEST])
def test_images_of_any_size_have_a_half(monkeypatch, size, quality):
    monkeypatch.setattr("camcal.stereo.matching.match.LARGEST", 200)
    image = LEFT[: size[1], : size[0]]
    found = match(image, image, MatchOptions(quality, (-5, 6), ALL))
    assert found.values.shape == image.shape
    assert np.mean(np.abs(found.values) < 0.5) > 0.9  # both images are the same


def test_the_noise_of_a_pair_at_half_its_size_is_what_is_measured_there():
    rng = np.random.default_rng(3)
    images = [np.clip(128 + 3.5 * rng.normal(size=(200, 300)), 0, 255).astype(np.uint8) for _ in range(2)]
    half = _halve_pair(gray_pair(*images))
    assert half.noise == pytest.approx(noise_of(half.left), rel=0.2)  # medians of whole gray levels
