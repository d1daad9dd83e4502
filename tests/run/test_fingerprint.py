"""Fingerprints of files and settings."""

import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import pytest

from camcal.options import INPUT, Argument, Option, OptionsRecord
from camcal.run import fingerprint
from camcal.tasks.options import Jobs, Written, output_option


@dataclass(frozen=True)
class Options(OptionsRecord):
    inputs: Annotated[tuple[str, ...], Argument("Images.", metavar="IMAGES…")] = ()
    camera: Annotated[str, Option("A file.", group=INPUT)] = ""
    darks: Annotated[Path | None, Option("A folder.", group=INPUT)] = None
    scale: Annotated[float, Option("A number.")] = 1.0
    output: Annotated[Path, output_option("Where.", Written(), metavar="FILE")] = Path("out")
    jobs: Jobs = None


@pytest.fixture
def camera(tmp_path):
    path = tmp_path / "camera.yaml"
    path.write_text("focal: 1000\n", encoding="utf-8")
    return path


def test_a_setting_that_changes_a_result_changes_the_fingerprint_and_others_do_not():
    options = Options(scale=2.0)
    known = fingerprint.of_settings(options)
    assert fingerprint.of_settings(replace(options, scale=2.5)) != known
    assert fingerprint.of_settings(replace(options, jobs=2, output=Path("elsewhere"))) == known


@pytest.mark.parametrize("form", ["{}", "{}#left", "left={}", "left={}#left"])
def test_of_a_file_the_content_counts_and_not_its_place(camera, tmp_path, form):
    options = Options(camera=form.format(camera))
    known = fingerprint.of_settings(options)
    moved = tmp_path / "other.yaml"
    moved.write_bytes(camera.read_bytes())
    os.utime(moved, (0, 0))
    assert fingerprint.of_settings(replace(options, camera=form.format(moved))) == known
    camera.write_text("focal: 1001\n", encoding="utf-8")
    assert fingerprint.of_settings(options) != known


def test_another_camera_of_one_file_is_another_setting(camera):
    left, right = (fingerprint.of_settings(Options(camera=f"{camera}#{name}")) for name in ("left", "right"))
    assert left != right


def test_of_a_folder_names_and_contents_count_and_hidden_files_do_not(camera):
    options = Options(darks=camera.parent)
    known = fingerprint.of_settings(options)
    (camera.parent / ".camcal-output").write_text("camera.yaml\n", encoding="utf-8")
    assert fingerprint.of_settings(options) == known
    text = camera.read_text(encoding="utf-8")
    camera.write_text(text.replace("1000", "1001"), encoding="utf-8")
    assert fingerprint.of_settings(options) != known
    camera.write_text(text, encoding="utf-8")
    assert fingerprint.of_settings(options) == known
    camera.rename(camera.with_name("other.yaml"))
    assert fingerprint.of_settings(options) != known


def test_fields_that_are_left_out_do_not_count():
    one, other = Options(inputs=("a.png",)), Options(inputs=("b.png",))
    assert fingerprint.of_settings(one) != fingerprint.of_settings(other)
    assert fingerprint.of_settings(one, without=["inputs"]) == fingerprint.of_settings(other, without=["inputs"])


def test_another_version_of_camcal_or_another_date_of_files_is_another_fingerprint(monkeypatch):
    known = fingerprint.of_settings(Options())
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "0")
    assert fingerprint.of_settings(Options()) != known
    monkeypatch.delenv("SOURCE_DATE_EPOCH")
    monkeypatch.setattr("camcal.__version__", "999.0")
    assert fingerprint.of_settings(Options()) != known
