"""What a pipeline is reported as: the worst first, why results are not to be trusted, figures of lists."""

from camcal.messages import Message
from camcal.tasks.calibration.options import CalibrateOptions
from camcal.tasks.pipelines import summary
from camcal.tasks.pipelines.run_pipeline import DONE, FAILED, NOT_RUN, UP_TO_DATE, PipelineReport, StepReport
from camcal.tasks.pipelines.step import Step, StepError, StepResult, figures_of

WEAK = Message("few_views", "8 views only")
WRONG = Message("wrong_corners", "too many wrong corners", where="a.csv")


def step(name, state=DONE, **result):
    return StepReport(
        Step(name, name.partition("[")[0], "calibrate", CalibrateOptions, {}), state, "", StepResult(**result)
    )


def calibrated(name, rms_px, **result):
    return step(name, figures={"rms_px": rms_px, "trustworthy": "failures" not in result}, **result)


GOOD, WORSE = calibrated("c[1]", 0.1), calibrated("c[2]", 0.3)
WARNED, DOUBTED = calibrated("c[3]", 0.2, warnings=(WEAK,)), calibrated("c[4]", 0.1, failures=(WRONG, WEAK))
ITEMS = step("d[1]", FAILED, error=StepError(6, "items_failed", "1 image could not be read", partial=True))
GATE = step("d[2]", FAILED, error=StepError(7, "gate_failed", "too large\nand too small"))
WAITING = step("e", NOT_RUN)
OLD = calibrated("f", 0.4)


def report(*steps):
    return PipelineReport("p.yaml", steps)


def test_the_worst_step_comes_first():
    found = summary.worst_first([GOOD, WORSE, WARNED, DOUBTED, ITEMS, GATE, WAITING])
    assert [each.name for each in found] == ["d[2]", "d[1]", "e", "c[4]", "c[3]", "c[2]", "c[1]"]
    assert report(GOOD, ITEMS, GATE).code == 7


def test_a_line_says_what_came_of_a_step():
    assert summary.result_words(GOOD) == "trustworthy, RMS 0.1 px"
    assert summary.result_words(DOUBTED) == "DO NOT TRUST: too many wrong corners (and 1 more), RMS 0.1 px"
    assert summary.result_words(GATE) == "too large (and 1 more)"


def test_results_that_are_not_to_be_trusted_are_counted_and_named():
    found = report(GOOD, DOUBTED)
    assert summary.verdict(found) == "2 steps: 2 done; 1 result not to be trusted"
    assert [str(each) for each in summary.doubts(found)] == [
        "c[4]: a.csv: too many wrong corners",
        "c[4]: 8 views only",
    ]
    assert not summary.is_good(found)
    assert summary.is_good(report(GOOD, step("x", UP_TO_DATE)))


def test_the_key_figure_of_a_list_is_drawn_if_it_has_enough_items():
    assert list(summary.distributions(report(GOOD, WORSE, WARNED, OLD))) == [("c: RMS, px", [0.1, 0.3, 0.2])]
    assert list(summary.distributions(report(GOOD, WORSE))) == []


def test_figures_are_the_single_values_of_a_document():
    document = {"rms_px": 0.1, "output": "a.yaml", "none": None, "views": [1, 2], "std": {"fx": 0.2, "all": [1]}}
    assert figures_of(document) == {"rms_px": 0.1, "output": "a.yaml", "std.fx": 0.2}
