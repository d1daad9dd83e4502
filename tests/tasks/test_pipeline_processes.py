"""Steps in worker processes: the same results as one by one, and a process that ends costs its step only."""

import os
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from camcal import urls
from camcal.cli.pipeline import StepCommands, perform
from camcal.errors import FileError
from camcal.progress import SILENT
from camcal.run.options import BatchOptions
from camcal.tasks.pipelines.run_pipeline import DONE, FAILED, NOT_RUN, run_pipeline
from camcal.tasks.pipelines.step import PipelineOptions, StepResult

CAMERA = Path(__file__).parents[2] / "sample_configs" / "cameras" / "pinhole.yaml"
PIPELINE = """\
lists:
  name: [a, b, c]
steps:
  first:
    command: convert
    foreach: name
    arguments: [camera.yaml, $(name).xml]
  second:
    command: convert
    foreach: name
    arguments: [$(name).xml, out/$(name).yaml]
"""


@pytest.fixture
def pipeline(tmp_path):
    """A function that makes a pipeline in a folder of its own."""

    def make(name):
        folder = tmp_path / name
        folder.mkdir()
        shutil.copy(CAMERA, folder / "camera.yaml")
        (folder / "pipeline.yaml").write_text(PIPELINE)
        return folder / "pipeline.yaml"

    return make


def killed(job, progress=SILENT):
    """A step whose process ends without a word, as one that the system kills for its memory."""
    if job.name == "first[b]":
        os._exit(9)
    return perform(job, progress)


def run(path, jobs, function=perform, **options):
    return run_pipeline(PipelineOptions(path, jobs=jobs, **options), StepCommands(), function)


def files_of(pipeline):
    return {
        path.relative_to(pipeline.parent): path.read_bytes() for path in pipeline.parent.rglob("*") if path.is_file()
    }


@pytest.mark.slow
def test_steps_in_processes_write_the_same_bytes_as_one_by_one(pipeline):
    one, two = pipeline("one"), pipeline("two")
    assert run(one, 1).count(DONE) == 6
    assert run(two, 2).count(DONE) == 6
    assert files_of(one) == files_of(two)
    assert len(files_of(one)) >= 9


def where(job, progress=SILENT):
    """A step that says in which process it runs."""
    return StepResult({"process": float(os.getpid())})


@pytest.mark.parametrize(("jobs", "apart"), [(5, True), (6, False), (7, False)])
def test_steps_have_a_process_each_if_they_keep_more_than_half_of_the_jobs_busy(pipeline, jobs, apart):
    text = PIPELINE.partition("  second:")[0]
    path = pipeline("one")
    path.write_text(text)
    found = {each.result.figures["process"] for each in run(path, jobs, where).steps}
    assert (os.getpid() not in found) == apart


@pytest.mark.parametrize("option", ["jobs: 2", "timeout: 60", 'scheduler: "dask://local"'])
def test_steps_that_start_processes_of_their_own_run_here(pipeline, option):
    path = pipeline("here")
    step = "{command: undistort, foreach: name, arguments: [camera.yaml, camera.yaml], output: $(name), %s}"
    path.write_text(f"lists: {{name: [a, b, c]}}\nsteps: {{views: {step % option}}}\n")
    processes = []

    def noted(job, progress=SILENT):
        processes.append(os.getpid())
        return StepResult()

    assert run(path, 2, noted).count(DONE) == 3
    assert processes == [os.getpid()] * 3


def test_steps_that_name_urls_do_not_go_to_a_cluster_as_a_whole(pipeline):
    pytest.importorskip("fsspec")
    path = pipeline("here")
    path.write_text(PIPELINE.replace("camera.yaml", f"file://{path.with_name('camera.yaml')}"))
    processes = []

    def noted(job, progress=SILENT):
        processes.append(job.name)
        return StepResult()

    token = urls.REMOTE.set(None)
    run(path, 2, noted, batch=BatchOptions(scheduler="dask://127.0.0.1:1"), only=("first",))
    urls.REMOTE.reset(token)
    assert processes == ["first[a]", "first[b]", "first[c]"]


@pytest.mark.slow
@pytest.mark.usefixtures("local_cluster")
def test_a_cluster_writes_the_same_bytes(pipeline):
    pytest.importorskip("distributed")
    one, cluster = pipeline("one"), pipeline("cluster")
    assert run(one, 1).count(DONE) == 6
    assert run(cluster, 2, batch=BatchOptions(scheduler="dask://local")).count(DONE) == 6
    assert files_of(one) == files_of(cluster)


@pytest.mark.slow
def test_a_process_that_ends_costs_its_step_and_those_that_need_it(pipeline):
    path = pipeline("work")
    report = run(path, 2, killed)
    states = {each.name: each.state for each in report.steps}
    assert states == dict.fromkeys(states, DONE) | {"first[b]": FAILED, "second[b]": NOT_RUN}
    assert report.code == 6
    assert run(path, 2).count(DONE) == 2


def test_two_runs_of_one_pipeline_do_not_write_its_state_at_once(pipeline):
    path = pipeline("work")

    def nested(job, progress=SILENT):
        with pytest.raises(FileError, match="another run of this pipeline is in progress"):
            run(path, 1)
        assert run(path, 1, dry_run=True).code == 0
        return perform(job, progress)

    assert run(path, 1, nested, only=("first[a]",)).count(DONE) == 1
    assert run(path, 1, only=("first[a]",)).count(DONE) == 0


def test_a_step_that_breaks_leaves_the_others_and_its_traceback(pipeline):
    path = pipeline("work")

    report = run(path, 1, lambda job, progress=SILENT: perform(_broken(job), progress))
    failed = [each for each in report.steps if each.state == FAILED]
    assert [each.name for each in failed] == ["first[b]"]
    assert "Traceback" in failed[0].result.error.trace
    assert report.code == 1


def _broken(job):
    """Return a job whose options the command cannot use."""
    return replace(job, options=PipelineOptions(job.pipeline)) if job.name == "first[b]" else job
