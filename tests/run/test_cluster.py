"""What the fan-out promises on a Dask cluster, with a real scheduler, real workers and real signals."""

import gc
import os
import signal
import sys
import threading
from functools import partial
from pathlib import Path

import fanout_work as work
import numpy as np
import pytest

from camcal import files, urls
from camcal.errors import FileError, InvalidInput, ItemsFailed
from camcal.progress import Silent
from camcal.run import cluster
from camcal.run.cluster_worker import RunTerms, SharedFolders, answers
from camcal.run.fanout import fan_out
from camcal.run.fingerprint import versions
from camcal.run.options import BatchOptions

sys.path.insert(0, str(Path(__file__).parents[1]))  # the cluster serves tests of commands too

from dask_cluster import dask_cluster, wait_until

TERMS = RunTerms(folder=str(Path.cwd()), shared={}, versions=versions(), max_pixels=10**8, remote=None)

pytestmark = [  # of connections that were lost; Dask leaves their sockets to the collector
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
]


@pytest.fixture(autouse=True)
def collected():
    yield
    gc.collect()


@pytest.fixture(scope="module")
def scheduler(tmp_path_factory):
    with dask_cluster(tmp_path_factory.mktemp("dask")) as running:
        yield running


def outcomes(function, items, scheduler, **batch):
    return list(fan_out(function, items, batch=BatchOptions(scheduler=scheduler.url, **batch)))


@pytest.mark.slow
def test_outcomes_are_those_of_this_machine_in_the_order_of_the_items(scheduler):
    assert outcomes(work.doubled, range(100), scheduler) == list(fan_out(work.doubled, range(100), jobs=1))


@pytest.mark.slow
def test_an_error_of_an_item_is_its_own(scheduler):
    found = outcomes(work.refused, range(3), scheduler)
    assert [each.value for each in found] == [0, None, 2]
    assert (type(found[1].error), str(found[1].error)) == (FileError, "b.png: is empty")


@pytest.mark.slow
def test_a_bug_is_raised(scheduler):
    with pytest.raises(KeyError):
        outcomes(work.mistaken, range(3), scheduler)


@pytest.mark.slow
def test_large_arrays_reach_the_workers(scheduler):
    function = work.Sum([np.ones((1000, 1000)), np.arange(3.0)])
    assert [each.value[0] for each in outcomes(function, range(3), scheduler)] == [
        1_000_003.0,
        1_000_004.0,
        1_000_005.0,
    ]


@pytest.mark.slow
def test_an_item_that_no_worker_survives_costs_itself_only(scheduler):
    found = outcomes(work.killed, range(6), scheduler)
    assert [each.value for each in found] == [0, None, 2, 3, 4, 5]
    assert isinstance(found[1].error, ItemsFailed)
    assert str(found[1].error).startswith("item 2: 4 workers died with it")


@pytest.mark.slow
def test_an_item_that_hangs_is_stopped_and_the_others_go_on(scheduler):
    found = outcomes(work.hanging, range(6), scheduler, timeout=1.0)
    assert [each.value for each in found] == [0, None, 2, 3, 4, 5]
    assert found[1].error.message == "took longer than 1 s and was stopped"


@pytest.mark.slow
def test_none_is_begun_after_a_failure_with_fail_fast(scheduler, tmp_path):
    found = outcomes(partial(work.noted_and_refused, tmp_path), range(300), scheduler, fail_fast=True)
    assert [each.item for each in found if each.error] == [1]
    assert len(found) == len(list(tmp_path.iterdir())) < 300


@pytest.mark.slow
def test_a_worker_that_is_lost_costs_no_item(scheduler, tmp_path):
    run = fan_out(partial(work.noted, tmp_path), range(60), batch=BatchOptions(scheduler=scheduler.url))
    found = [next(run)]
    wait_until(lambda: len(scheduler.worker_pids()) == 2)
    os.kill(scheduler.worker_pids()[0], signal.SIGKILL)
    found += run
    assert [each.value for each in found] == list(range(60))


@pytest.mark.slow
def test_a_scheduler_that_dies_and_comes_back_costs_no_item(tmp_path):
    with dask_cluster(tmp_path) as running:
        (tmp_path / "notes").mkdir()
        function = partial(work.noted, tmp_path / "notes")
        run = fan_out(function, range(60), batch=BatchOptions(scheduler=running.url))
        found = [next(run)]

        def start_again():
            running.kill("scheduler")
            running.wait_for_end("worker")  # Dask's workers leave with their scheduler
            running.start()

        again = threading.Thread(target=start_again)
        again.start()
        found += run
        again.join()
    assert [each.value for each in found] == list(range(60))


@pytest.mark.slow
def test_a_scheduler_that_does_not_come_back_ends_the_run_in_one_line(tmp_path, monkeypatch):
    monkeypatch.setattr(cluster, "_PATIENCE_S", 2.0)
    with dask_cluster(tmp_path) as running:
        run = fan_out(partial(work.noted, tmp_path), range(200), batch=BatchOptions(scheduler=running.url))
        next(run)
        running.kill("scheduler")
        with pytest.raises(FileError, match="was lost and did not come back in 2 s; what is done is kept") as caught:
            list(run)
    assert caught.value.where == running.url
    assert "\n" not in str(caught.value)


@pytest.mark.slow
def test_a_scheduler_without_workers_is_waited_for_with_a_warning(tmp_path, monkeypatch):
    monkeypatch.setattr(cluster, "_LOOK_S", 0.5)
    warned = threading.Event()

    class Heard(Silent):
        def warn(self, message):
            assert message.code == "no_workers"
            warned.set()

    with dask_cluster(tmp_path) as running:
        running.kill("worker")
        starter = threading.Thread(target=lambda: warned.wait(60) and running.start("worker"))
        starter.start()
        found = list(fan_out(work.doubled, range(3), batch=BatchOptions(scheduler=running.url), progress=Heard()))
        starter.join()
    assert warned.is_set()
    assert [each.value for each in found] == [0, 2, 4]


@pytest.mark.slow
def test_a_connection_may_be_encrypted(tmp_path, monkeypatch):
    pytest.importorskip("cryptography")
    from distributed.security import Security

    security = Security.temporary()
    (tmp_path / "ca.pem").write_text(security.tls_ca_file)
    (tmp_path / "key.pem").write_text(security.tls_client_key)
    (tmp_path / "cert.pem").write_text(security.tls_client_cert)
    extra = {"DASK_DISTRIBUTED__COMM__TLS__CA_FILE": str(tmp_path / "ca.pem")}
    for role in ("CLIENT", "SCHEDULER", "WORKER"):
        for part in ("KEY", "CERT"):
            extra[f"DASK_DISTRIBUTED__COMM__TLS__{role}__{part}"] = str(tmp_path / f"{part.lower()}.pem")
    for name, value in extra.items():
        monkeypatch.setenv(name, value)
    import dask

    dask.config.refresh()
    with dask_cluster(tmp_path, protocol="tls", extra=extra) as running:
        assert running.url.startswith("dask+tls://")
        found = outcomes(work.doubled, range(5), running)
    monkeypatch.undo()
    dask.config.refresh()
    assert [each.value for each in found] == [0, 2, 4, 6, 8]


@pytest.mark.parametrize(
    ("settings", "scheduler", "error", "words"),
    [
        ({}, "dask+tls://127.0.0.1:1", InvalidInput, "needs certificates: set distributed.comm.tls"),
        ({"default-scheme": "tls"}, "dask://127.0.0.1:1", InvalidInput, "needs certificates"),
        ({"require-encryption": True}, "dask://127.0.0.1:1", InvalidInput, r"requires encryption; use dask\+tls://"),
        ({"require-encryption": True}, "dask://local", InvalidInput, "needs certificates"),
        (
            dict.fromkeys(("tls.ca-file", "tls.client.cert", "tls.client.key"), "missing.pem"),
            "dask+tls://127.0.0.1:1",
            FileError,
            "the certificates of Dask's configuration cannot be read: No such file",
        ),
    ],
)
def test_encryption_is_that_of_dasks_configuration(settings, scheduler, error, words):
    import dask
    import distributed  # noqa: F401 - its import adds to the configuration, which `set` would take back

    given = dask.config.set({f"distributed.comm.{name}": value for name, value in settings.items()})
    with given, pytest.raises(error, match=words) as caught:
        list(fan_out(work.doubled, range(3), batch=BatchOptions(scheduler=scheduler)))
    assert caught.value.where == scheduler


@pytest.mark.slow
def test_a_cluster_of_this_machine_listens_on_it_only_and_at_no_fixed_port():
    started = cluster._local_cluster.__wrapped__(1)
    pages = started.scheduler.http_server
    assert (pages.address, pages.port != 8787) == ("127.0.0.1", True)
    assert started.scheduler_address.startswith("tcp://127.0.0.1:")
    started.close()


def test_a_scheduler_that_is_not_there_is_named(monkeypatch):
    monkeypatch.setattr(cluster, "_CONNECT_S", 0.1)
    with pytest.raises(FileError, match="the scheduler does not answer") as caught:
        list(fan_out(work.doubled, range(3), batch=BatchOptions(scheduler="dask://127.0.0.1:1")))
    assert caught.value.where == "dask://127.0.0.1:1"


def test_without_dask_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(InvalidInput, match=r"pip install 'camcal\[cluster\]'"):
        list(fan_out(work.doubled, range(3), batch=BatchOptions(scheduler="dask://local")))


def test_a_worker_with_other_versions_refuses_items():
    other = RunTerms(**{**vars(TERMS), "versions": {**versions(), "opencv": "4.14.0"}})
    with pytest.raises(InvalidInput, match=r"has opencv \S+ instead of 4\.14\.0; install the same versions"):
        answers(work.doubled, [1], other)
    assert answers(work.doubled, [1, 2], TERMS)[0] == [(2, None), (4, None)]


def test_a_worker_works_in_the_folder_of_the_run_and_returns_to_its_own(tmp_path):
    before = Path.cwd()
    terms = RunTerms(**{**vars(TERMS), "folder": str(tmp_path)})
    assert answers(lambda _: str(Path.cwd()), [0], terms)[0] == [(str(tmp_path), None)]
    elsewhere = RunTerms(**{**vars(TERMS), "folder": str(tmp_path / "missing")})
    [(folder, _)], _ = answers(lambda _: str(Path.cwd()), [0], elsewhere)
    assert Path(folder) not in (before, tmp_path)
    assert Path.cwd() == before


def test_a_file_is_written_only_where_the_sender_finds_it(tmp_path):
    (tmp_path / "shared").mkdir()
    (tmp_path / "shared" / "mark").touch()
    shared = {str(tmp_path / "shared"): "mark", str(tmp_path / "other"): "mark"}
    ledger = SharedFolders(RunTerms(**{**vars(TERMS), "shared": shared, "folder": str(tmp_path / "missing")}))
    ledger.writes(tmp_path / "shared" / "deep" / "a.png")
    for path in (tmp_path / "other" / "a.png", Path("a.png")):
        with pytest.raises(FileError, match="its folder is not shared with the worker"):
            ledger.writes(path)


def test_nothing_of_a_run_stays_with_the_worker():
    before = files.LEDGER.get(), urls.REMOTE.get()
    answers(work.doubled, [1], RunTerms(**{**vars(TERMS), "max_pixels": 5}))
    assert (files.LEDGER.get(), urls.REMOTE.get()) == before
    from camcal.images.options import max_pixels

    assert max_pixels() != 5
