"""What a pair's preparation remarks on where only the range was measured."""

from textured import textured_pair, waves

from camcal.stereo.matching.preparation import prepare
from camcal.stereo.pair.pair_order import FINDINGS, SWAPPED


def test_a_range_all_behind_infinity_is_remarked_on_without_alignment():
    left, right = textured_pair(waves(12, 30))
    assert prepare(right, left, align=False).remarks == (FINDINGS[SWAPPED],)
    assert prepare(left, right, align=False).remarks == ()


def test_swapped_images_are_remarked_on_once():
    left, right = textured_pair(waves(12, 30))
    assert prepare(right, left).remarks.count(FINDINGS[SWAPPED]) == 1


def test_a_range_that_was_asked_for_is_not_remarked_on():
    left, right = textured_pair(waves(12, 30))
    assert prepare(right, left, (-40, 0), align=False).remarks == ()
