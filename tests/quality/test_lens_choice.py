"""Choice of the lens model by what is known of the whole image, at its limits."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from camcal.calibrate.intrinsics import CandidateModel
from camcal.quality import assess
from camcal.quality.lens_choice import alternative, chosen, rank_models

VIEWS, CORNERS = 10, 100


def candidate(name, score, map_px, sigma_px=0.1, failures=()):
    """A model with the same score, nat a corner, in all views."""
    scores = np.full(VIEWS, score * CORNERS / VIEWS)
    return CandidateModel(name, scores, CORNERS, sigma_px, map_px=map_px, failures=failures)


@pytest.mark.parametrize(("ratio", "taken"), [(0.35, "other"), (0.69, "other"), (0.71, "default"), (1.4, "default")])
def test_of_models_that_predict_alike_the_one_that_is_known_better_is_used(ratio, taken):
    default, other = candidate("default", 1.0, 2.0), candidate("other", 1.0, 2.0 * ratio)
    assert chosen([default, other], "default").name == taken
    assert chosen([other, default], "default").name == taken


@pytest.mark.parametrize(("map_px", "taken"), [(0.05, "default"), (0.099, "default"), (0.101, "other"), (0.2, "other")])
def test_a_lens_that_is_known_better_than_it_predicts_is_kept(map_px, taken):
    default, other = candidate("default", 1.0, map_px), candidate("other", 1.0, map_px / 2)
    assert chosen([default, other], "default").name == taken


@pytest.mark.parametrize(
    ("map_px", "taken"), [(0.01, "default"), (0.019, "default"), (0.021, "other"), (0.04, "other")]
)
def test_a_lens_that_is_known_to_a_fiftieth_of_a_pixel_is_kept(map_px, taken):
    default, other = candidate("default", 1.0, map_px, 0.001), candidate("other", 1.0, map_px / 2, 0.001)
    assert chosen([default, other], "default").name == taken


def test_coefficients_that_a_prior_holds_are_not_known_better():
    default, other = candidate("default", 1.0, 2.0), candidate("other", 1.0, 0.2)
    held = replace(other, calibration=SimpleNamespace(held_by_prior=("k4",)))
    free = replace(other, calibration=SimpleNamespace(held_by_prior=()))
    assert chosen([default, held], "default").name == "default"
    assert chosen([default, free], "default").name == "other"


@pytest.mark.parametrize(("worse", "taken"), [(0.01, "other"), (0.0199, "other"), (0.021, "default"), (0.2, "default")])
def test_a_lens_that_predicts_clearly_worse_is_not_used_however_well_it_is_known(worse, taken):
    # views that agree: by 0.02 nat a corner is enough
    default, other = candidate("default", 1.0, 20.0), candidate("other", 1.0 - worse, 0.2)
    assert chosen([default, other], "default").name == taken


@pytest.mark.parametrize(("worse", "found"), [(0.01, "other"), (0.0199, "other"), (0.021, None), (0.04, None)])
def test_an_alternative_predicts_about_alike(worse, found):
    used, other = candidate("used", 1.0, 2.0), candidate("other", 1.0 - worse, 2.0)
    assert getattr(alternative([used, other], "used"), "name", None) == found


def test_the_best_alternative_that_passes_is_found():
    used, good, better = (
        candidate(name, score, 2.0) for name, score in [("used", 1.0), ("good", 0.985), ("best", 0.99)]
    )
    failed = candidate("failed", 1.0, 2.0, failures=("known_region",))
    assert alternative([good, failed, better, used], "used").name == "best"
    assert alternative([used, failed], "used") is None
    assert alternative([good], "used") is None


def test_models_that_pass_come_first_then_those_that_do_not_then_those_without_a_score():
    best = candidate("best", 2.0, 0.1, failures=("not_invertible",))
    second, third = candidate("second", 1.5, 0.1), candidate("third", 1.0, 0.1)
    failed, default = CandidateModel("failed", reason="no start"), CandidateModel("default", reason="no start")
    order = rank_models([failed, default, third, best, second], "default")
    assert [own.name for own in order] == ["second", "third", "best", "default", "failed"]
    assert [own.name for own in rank_models([replace(third, failures=("lens_model",)), best], "third")] == [
        "best",
        "third",
    ]


@pytest.mark.parametrize("known", [0.5, np.inf])
def test_pixels_without_a_ray_count_as_known_to_a_hundredth_of_the_diagonal(monkeypatch, known):
    std = np.array([0.5, known])
    map_ = SimpleNamespace(std_rms=std, pixels=np.zeros((2, 2)))
    found = SimpleNamespace(uncertainty=map_, failures=(), messages=())
    monkeypatch.setattr(assess, "assess", lambda *_: found)
    own = replace(
        candidate("own", 1.0, 2.0), calibration=SimpleNamespace(camera=SimpleNamespace(image_size=(300, 400)))
    )
    expected = 0.5 if np.isfinite(known) else np.sqrt((0.5**2 + 5.0**2) / 2)
    assert assess.judge([own])[0].map_px == pytest.approx(expected)
