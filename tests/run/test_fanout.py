"""What the fan-out promises, with real threads, real processes and real signals.

Not proven here: that a worker stuck in C code without releasing the interpreter leaves when its parent is killed.
"""

import errno
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from multiprocessing.util import get_temp_dir
from pathlib import Path

import cv2
import fanout_work as work
import numpy as np
import pytest

from camcal.errors import FileError, InvalidInput, ItemsFailed
from camcal.messages import Message
from camcal.progress import Outcome
from camcal.run import workers
from camcal.run.fanout import fan_out
from camcal.run.options import BatchOptions
from camcal.run.process import available_cores, over_threads

WAYS = [
    pytest.param({"jobs": 1}, id="inline"),
    pytest.param({"jobs": 2}, id="threads"),
    pytest.param({"jobs": 2, "processes": True}, id="processes"),
]


def gone(pid: int, within_s: float = 5.0) -> bool:
    until = time.monotonic() + within_s
    while time.monotonic() < until:
        try:
            state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
        except (FileNotFoundError, ProcessLookupError):
            return True
        if state == "Z":  # dead; whoever inherited it has not collected it yet
            return True
        time.sleep(0.02)
    return False


def children() -> list[str]:
    """Return the worker processes of this one, each as its number and command line: the children of the server that
    forks them, or its own where an earlier test has given it a folder of temporary files with a long path. The server
    and the resource tracker of multiprocessing live on by design.
    """
    commands, parents = {}, {}
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, parent = stat.read_text().rpartition(")")[2].split()[:2]
            command = (stat.parent / "cmdline").read_text()
        except (FileNotFoundError, ProcessLookupError):
            continue
        if state != "Z":  # ended, and not yet collected by the server
            commands[int(stat.parent.name)], parents[int(stat.parent.name)] = command, int(parent)
    own = {process for process, parent in parents.items() if parent == os.getpid()}
    servers = {process for process in own if "forkserver" in commands[process]}
    forked = Path("/proc/self/cmdline").read_text()
    workers = [process for process in own if "spawn_main" in commands[process] or commands[process] == forked]
    workers += [process for process, parent in parents.items() if parent in servers]
    return [f"{process}: {commands[process]}".replace("\0", " ") for process in sorted(workers)]


class Recorder:
    def __init__(self) -> None:
        self.calls: list[object] = []

    def start(self, what: str, total: int | None) -> None:
        self.calls.append((what, total))

    def advance(self, count: int = 1) -> None:
        self.calls.append(count)

    def finish(self) -> None:
        self.calls.append("finish")

    def warn(self, message: Message) -> None:
        self.calls.append(message)


@pytest.mark.parametrize("way", WAYS)
def test_results_come_in_the_order_of_the_items(way):
    outcomes = list(fan_out(work.doubled, range(9), **way))
    assert [outcome.item for outcome in outcomes] == list(range(9))
    assert [outcome.value for outcome in outcomes] == [2 * number for number in range(9)]


@pytest.mark.parametrize("way", WAYS[:2])
def test_an_error_of_the_user_stays_with_its_item(way):
    outcomes = list(fan_out(work.refused, [0, 1, 2], **way))
    assert [outcome.value for outcome in outcomes] == [0, None, 2]
    assert isinstance(outcomes[1].error, FileError)
    assert str(outcomes[1].error) == "b.png: is empty"


@pytest.mark.parametrize("way", WAYS[:2])
def test_a_bug_is_raised_and_not_swallowed(way):
    with pytest.raises(KeyError):
        list(fan_out(work.mistaken, [0, 1, 2], **way))


def test_a_bug_in_a_worker_process_shows_the_lines_it_comes_from():
    with pytest.raises(KeyError) as caught:
        list(fan_out(work.mistaken, [0, 1], jobs=2, processes=True))
    assert "return {}[number]" in str(caught.value.__cause__)
    assert children() == []


def test_a_bug_that_cannot_be_pickled_still_shows_its_traceback():
    with pytest.raises(RuntimeError, match="Unreadable: lost") as caught:
        list(fan_out(work.mistaken_beyond_pickling, [0, 1], jobs=2, processes=True))
    assert 'raise Unreadable("lost", "property")' in str(caught.value.__cause__)


@pytest.mark.parametrize("way", WAYS[:2])
def test_progress_hears_of_every_item(way):
    recorder = Recorder()
    list(fan_out(work.doubled, [1, 2, 3], what="doubling", progress=recorder, **way))
    assert recorder.calls == [("doubling", 3), 1, 1, 1, "finish"]


@pytest.mark.parametrize("way", WAYS)
def test_no_items_give_no_outcomes(way):
    assert list(fan_out(work.doubled, [], **way)) == []


@pytest.mark.parametrize("way", WAYS)
def test_an_endless_source_is_read_no_further_than_a_window_and_stopping_leaves_no_process(way):
    taken = []

    def source():
        for number in range(1000):
            taken.append(number)
            yield number

    outcomes = fan_out(work.doubled, source(), **way)
    assert [next(outcomes).value for _ in range(3)] == [0, 2, 4]
    assert len(children()) == (2 if "processes" in way else 0)
    outcomes.close()
    assert len(taken) < 50  # 3 handed on, at most 2 × 16 + 1 ahead
    assert children() == []


def test_a_worker_that_dies_costs_its_item_only_and_the_error_names_the_file():
    names = ["0.png", "killed.png", "2.png", "crashed.png", "4.png", "left.png", "6.png", "7.png"]
    outcomes = list(fan_out(work.deadly, map(Path, names), jobs=2, processes=True))
    assert [outcome.value for outcome in outcomes] == ["0", None, "2", None, "4", None, "6", "7"]
    for outcome, words in zip(outcomes[1:6:2], ["SIGKILL", "SIGSEGV", "code 3"], strict=True):
        assert isinstance(outcome.error, ItemsFailed)
        assert outcome.error.where == str(outcome.item)
        assert words in str(outcome.error)
    assert children() == []


def test_a_worker_that_cannot_be_started_leaves_none_of_the_others(monkeypatch):
    def started(payload):
        if children():
            raise OSError(errno.EAGAIN, "no more processes")
        return start(payload)

    start = workers._Worker
    monkeypatch.setattr(workers, "_Worker", started)
    with pytest.raises(OSError, match="no more processes") as caught:  # which holds the frames of the call
        list(fan_out(work.doubled, range(3), jobs=2, processes=True))
    assert children() == []
    assert caught.traceback


def test_a_worker_that_hangs_is_stopped_and_costs_its_item_only():
    # Work for threads goes to processes then, and the limit of the batch comes before that of the call.
    outcomes = list(fan_out(work.hanging, range(3), jobs=2, batch=BatchOptions(timeout=0.5), timeout=1e6))
    assert [outcome.value for outcome in outcomes] == [0, None, 2]
    assert "took longer than 0.5 s" in str(outcomes[1].error)
    assert children() == []


def test_a_timeout_holds_for_one_job_too():
    outcomes = list(fan_out(work.hanging, [0, 1], jobs=1, processes=True, timeout=0.2))
    assert "took longer than 0.2 s" in str(outcomes[1].error)


def test_one_item_is_worked_on_in_this_process_unless_the_user_limits_its_time():
    [alone] = fan_out(work.own_pid, [0], processes=True, timeout=60.0)
    assert alone.value == os.getpid()
    [limited] = fan_out(work.own_pid, [0], batch=BatchOptions(timeout=60.0))
    assert limited.value != os.getpid()
    assert os.getpid() not in {each.value for each in fan_out(work.own_pid, [0, 1], jobs=2, timeout=60.0)}


def test_stopping_early_drops_what_threads_have_not_begun(tmp_path):
    outcomes = fan_out(partial(work.noted, tmp_path), range(100), jobs=2)
    next(outcomes)
    outcomes.close()
    assert len(list(tmp_path.iterdir())) < 10


@pytest.mark.parametrize("way", WAYS[:2])
def test_every_worker_has_one_opencv_thread(way):
    before = cv2.getNumThreads()
    assert {outcome.value[0] for outcome in fan_out(work.threads_of_libraries, range(4), **way)} == {1}
    assert cv2.getNumThreads() == before


def test_worker_processes_have_the_environment_that_their_parent_has_by_then(monkeypatch):
    def seen():
        return [each.value for each in fan_out(os.getenv, ["CAMCAL_PROBE"] * 2, jobs=2, processes=True)]

    monkeypatch.setenv("CAMCAL_PROBE", "first")
    assert seen() == ["first", "first"]
    monkeypatch.setenv("CAMCAL_PROBE", "second")
    assert seen() == ["second", "second"]
    monkeypatch.delenv("CAMCAL_PROBE")
    assert seen() == [None, None]


def test_worker_processes_have_one_thread_of_opencv_and_of_blas_and_the_environment_is_put_back(monkeypatch):
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "7")
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    values = [outcome.value for outcome in fan_out(work.threads_of_libraries, range(2), jobs=2, processes=True)]
    assert values == [(1, "1"), (1, "1")]
    assert os.environ["OPENBLAS_NUM_THREADS"] == "7"
    assert "OMP_NUM_THREADS" not in os.environ


def test_no_jobs_are_refused():
    with pytest.raises(InvalidInput, match="0 jobs"):
        fan_out(work.doubled, [1], jobs=0)


@pytest.mark.parametrize("way", WAYS)
def test_nothing_is_begun_after_a_failure_that_ends_a_batch(way, tmp_path):
    recorder = Recorder()
    batch = BatchOptions(fail_fast=True)
    outcomes = list(
        fan_out(partial(work.noted_and_refused, tmp_path), range(40), batch=batch, progress=recorder, **way)
    )
    begun = [outcome.item for outcome in outcomes]
    assert begun == sorted(int(path.name) for path in tmp_path.iterdir())
    assert begun[:2] == [0, 1]
    assert len(begun) <= 2 * 2 + 1  # what was at work, and waiting
    assert [(outcome.item, str(outcome.error)) for outcome in outcomes if outcome.error] == [(1, "b.png: is empty")]
    warning = recorder.calls[-1]
    assert (warning.code, warning.values) == ("stopped_at_failure", {"not_begun": 40 - len(begun)})
    assert children() == []


def test_a_batch_that_fails_with_its_last_item_has_left_out_nothing():
    recorder = Recorder()
    list(fan_out(work.refused, [0, 1], batch=BatchOptions(fail_fast=True), progress=recorder))
    assert recorder.calls[-1] == "finish"


def test_large_arrays_of_the_function_are_read_by_workers_from_one_file(tmp_path, monkeypatch):
    get_temp_dir()  # multiprocessing's own folder, once for a process, stands elsewhere
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    arrays = np.ones(100_001, np.uint8), np.arange(1e5), np.ones(5), np.ones((500, 400), order="F")
    outcomes = fan_out(work.Sum(arrays), range(3), jobs=2, processes=True)
    first = next(outcomes)
    [file] = tmp_path.iterdir()
    total = sum(float(array.sum()) for array in arrays)
    assert [first, *outcomes] == [Outcome(number, (total + number, [True, True, False, True])) for number in range(3)]
    assert file.name.startswith("camcal-")
    assert list(tmp_path.iterdir()) == []


def test_a_time_limit_below_a_millisecond_is_refused():
    with pytest.raises(InvalidInput, match=r"'--timeout': 0 is less than 0\.001"):
        BatchOptions(timeout=0.0)


def test_the_cores_available_are_at_least_one_and_not_more_than_the_machine_has():
    assert 1 <= available_cores() <= (os.cpu_count() or 1)


PARENT = """
import sys
from functools import partial
from pathlib import Path
sys.path.insert(0, sys.argv[1])
import fanout_work as work
from camcal.run.fanout import fan_out
import numpy as np
work_on = partial(work.pid_then_hang, Path(sys.argv[2]), array=np.zeros(1 << 16))
list(fan_out(work_on, range(9), jobs=2, processes=True))
"""


def parent_with_two_hanging_workers(
    start_python: Callable[..., subprocess.Popen[str]], folder: Path, *, as_file: bool = False
) -> tuple[subprocess.Popen[str], list[int]]:
    program = ["-c", PARENT]
    if as_file:
        script = folder / "parent.py"
        script.write_text(PARENT)
        program = [str(script)]
    notes = folder / "pids"
    notes.mkdir()
    process = start_python(*program, Path(__file__).parent, notes)
    until = time.monotonic() + 30
    while len(pids := [int(path.name) for path in notes.iterdir()]) < 2:
        assert process.poll() is None, process.communicate()[1]
        assert time.monotonic() < until
        time.sleep(0.02)
    return process, pids


def test_workers_leave_when_their_parent_is_killed_in_the_middle_of_an_item(start_python, tmp_path, monkeypatch):
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setenv("TMPDIR", str(folder))
    process, pids = parent_with_two_hanging_workers(start_python, tmp_path)
    assert len(list(folder.glob("camcal-*"))) == 1
    process.kill()
    process.communicate()
    assert all(gone(pid) for pid in pids)
    assert list(folder.glob("camcal-*")) == []


@pytest.mark.parametrize(
    "as_file", [False, pytest.param(True, marks=pytest.mark.slow)], ids=["python -c", "a script without a guard"]
)
def test_ctrl_c_ends_the_parent_and_its_workers_without_noise_from_them(start_python, tmp_path, as_file):
    process, pids = parent_with_two_hanging_workers(start_python, tmp_path, as_file=as_file)
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does: to the whole group
    _, noise = process.communicate(timeout=10)
    assert process.returncode == -signal.SIGINT
    assert noise.count("Traceback") == 1
    assert noise.rstrip().endswith("KeyboardInterrupt")
    assert all(gone(pid) for pid in pids)


THREADS = PARENT.replace("pid_then_hang", "noted").replace(", array=np.zeros(1 << 16)", "")
THREADS = THREADS.replace("range(9), jobs=2, processes=True", "range(1000), jobs=2")


def test_ctrl_c_drops_the_items_that_threads_have_not_begun(start_python, tmp_path):
    process = start_python("-c", THREADS, Path(__file__).parent, tmp_path)
    until = time.monotonic() + 30
    while not list(tmp_path.iterdir()):
        assert time.monotonic() < until
        time.sleep(0.01)
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=10)
    assert process.returncode == -signal.SIGINT
    assert len(list(tmp_path.iterdir())) < 500  # all of them would take 25 s


ONE_BLAS_THREAD = {"OPENBLAS_NUM_THREADS": "1"}
MAIN_FUNCTION = """
from camcal.run.fanout import fan_out

def tripled(number):
    return 3 * number

if __name__ == "__main__":
    print([outcome.value for outcome in fan_out(tripled, range(3), jobs=2, processes=True)])
"""


PARENTS = """
import os
import signal
import sys
import threading

from camcal import system
from camcal.cli import main
from camcal.run.fanout import fan_out

main.prepare()
if "--thread" in sys.argv:
    threading.Thread(target=threading.Event().wait, daemon=True).start()

def parent(number):
    if number == 1:
        os.kill(os.getpid(), signal.SIGTERM)  # is heard by this process, and not by the one that waits for its result
    return os.getppid() == MAIN, len(system._LOCKED)

MAIN = os.getpid()
if __name__ == "__main__":
    with system.held(__import__("pathlib").Path(__file__)):
        print([outcome.value for outcome in fan_out(parent, range(3), jobs=2, processes=True)])
        print(len(system._LOCKED))
"""


@pytest.mark.parametrize("thread", [(), ("--thread",)])
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="needs /proc/self/task")
def test_workers_are_forked_from_this_process_where_no_thread_is_at_work(tmp_path, thread):
    (tmp_path / "script.py").write_text(PARENTS)
    words = [sys.executable, tmp_path / "script.py", *thread]
    done = subprocess.run(words, capture_output=True, text=True, check=False, env=os.environ | ONE_BLAS_THREAD)
    forked = not thread
    assert done.stdout == f"[({forked}, 0), None, ({forked}, 0)]\n1\n", done.stderr


def test_a_function_of_the_main_script_works_too(tmp_path):
    (tmp_path / "script.py").write_text(MAIN_FUNCTION)
    done = subprocess.run([sys.executable, tmp_path / "script.py"], capture_output=True, text=True, check=False)
    assert done.stdout == "[0, 3, 6]\n", done.stderr


@pytest.mark.slow
def test_a_main_script_without_a_guard_is_told_so(tmp_path):
    thread = "import threading\n\nthreading.Thread(target=threading.Event().wait, daemon=True).start()\n"
    script = MAIN_FUNCTION.replace('if __name__ == "__main__":', "if True:")
    (tmp_path / "script.py").write_text(thread + script)  # beside a thread nothing is forked, and the script runs again
    done = subprocess.run([sys.executable, tmp_path / "script.py"], capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "`if __name__ == '__main__':`" in done.stderr.splitlines()[-1]


def test_pieces_of_one_work_are_done_on_threads_before_it_returns():
    done = [0] * 50

    def work(piece):
        done[piece] += 1

    with over_threads(3) as each:
        each(work, range(50))
        assert done == [1] * 50
        each(work, (piece for piece in range(0, 50, 2)))
    assert done == [2, 1] * 25


LIMITED = """
import sys, threading
sys.path.insert(0, sys.argv[1])
import fanout_work as work
from camcal.run.fanout import fan_out
from camcal.run.process import over_threads
threading.stack_size(1 << 46)  # no thread can start: there is no room for what it asks for
for way in ({}, {"processes": True}):
    print([outcome.value for outcome in fan_out(work.doubled, range(4), jobs=2, **way)])
done = []
with over_threads(2) as each:
    each(done.append, range(3))
print(done)
"""


def test_a_process_that_may_start_no_other_does_the_work_itself(start_python):
    process = start_python("-c", LIMITED, Path(__file__).parent, stdout=subprocess.PIPE)
    out, err = process.communicate(timeout=30)
    assert (out, err) == ("[0, 2, 4, 6]\n[0, 2, 4, 6]\n[0, 1, 2]\n", "")


def test_running_out_of_memory_costs_the_item_that_did():
    outcomes = list(fan_out(work.greedy, [Path("a.png"), Path("b.png")], jobs=2))
    assert outcomes[0].value == 5
    assert isinstance(outcomes[1].error, FileError)
    assert str(outcomes[1].error).startswith("b.png: out of memory: Unable to allocate 1.00 EiB")


def test_an_error_in_a_piece_is_raised():
    def work(piece):
        if piece == 3:
            raise InvalidInput("the third is bad")

    with pytest.raises(InvalidInput, match="third"), over_threads(2) as each:
        each(work, range(6))
