"""What a report says of failures and warnings, and whether a calibration is to be trusted."""

import pytest
from report_scenes import SCENES, camera_of

from camcal.formats import native
from camcal.formats.camera_file import CalibrationVerdict, CameraEntry, CameraFile
from camcal.messages import Message
from camcal.quality.criteria import CRITERIA
from camcal.report.page.record import BAD, FAILURE, GOOD, WARNING, WEAK, Table, checks_table, shown_messages, verdict
from camcal.tasks.file_options import ReportOptions
from camcal.tasks.reports.report import report

FAILED, WEAKER = Message("a", "it failed"), Message("b", "it is weak")


def test_failures_are_shown_before_warnings():
    assert [each.level for each in shown_messages([FAILED], [WEAKER])] == [FAILURE, WARNING]


def test_what_to_do_is_what_stands_behind_the_last_colon():
    (shown,) = shown_messages([Message("a", "left.yaml: views are alike: tilt the board")], [])
    assert (shown.what, shown.remedy) == ("left.yaml: views are alike.", "Tilt the board.")


@pytest.mark.parametrize(
    ("failures", "warnings", "state"),
    [((), (), GOOD), ((), (WEAKER,), WEAK), ((FAILED,), (), BAD), ((FAILED,), (WEAKER,), BAD)],
)
def test_one_failure_is_enough_not_to_trust_a_calibration(failures, warnings, state):
    assert verdict(failures, warnings, "").state == state


@pytest.mark.parametrize(("failure", "result"), [(True, "failure"), (False, "warning")])
def test_the_table_of_checks_tells_failures_from_warnings(failure, result):
    code = next(each.code for each in CRITERIA.values() if each.failure == failure)
    rows = {row[0]: row[1] for row in checks_table([Message(code, "it is so")], "").rows}
    assert rows.pop(code) == result
    assert set(rows.values()) == {"passed"}


def test_a_table_of_more_than_20_rows_is_opened_by_the_reader():
    assert [Table.of("c", ("n",), [["1"]] * count).folded for count in (20, 21)] == [False, True]


@pytest.mark.parametrize(
    ("trustworthy", "headline"),
    [((True, None), "Unknown"), ((True, False), "Do not trust this calibration"), ((True, True), "Trustworthy")],
)
def test_a_file_is_trusted_if_every_camera_of_it_is(tmp_path, trustworthy, headline):
    verdicts = [None if each is None else CalibrationVerdict(each) for each in trustworthy]
    cameras = {f"camera{index}": CameraEntry(camera_of(SCENES["good"]), verdict=v) for index, v in enumerate(verdicts)}
    native.write(tmp_path / "rig.yaml", CameraFile(cameras))
    report(ReportOptions(str(tmp_path / "rig.yaml"), tmp_path / "report.html"))
    assert f"{headline}</h2>" in (tmp_path / "report.html").read_text(encoding="utf-8")
