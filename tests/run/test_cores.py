"""CPU quotas as the two generations of Linux control groups write them, and memory that a process keeps."""

import platform
import subprocess
import sys

import pytest

from camcal.run.process import quota_cores

MANY = 1 << 10  # no machine the tests know of has more


def write(path, text):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)


@pytest.fixture
def mount(tmp_path):
    return tmp_path / "cgroup"


@pytest.mark.parametrize(
    ("quota", "cores"), [("200000 100000", 2), ("150000 100000", 2), ("50000 100000", 1)], ids=["2", "1.5", "0.5"]
)
def test_a_quota_counts_as_cores_rounded_up(tmp_path, mount, quota, cores):
    write(tmp_path / "self", "0::/user/job\n")
    write(mount / "user/job/cpu.max", f"{quota}\n")
    assert quota_cores(tmp_path / "self", mount) == cores


def test_the_quota_of_a_parent_group_holds_too(tmp_path, mount):
    write(tmp_path / "self", "0::/user/job\n")
    write(mount / "user/job/cpu.max", "800000 100000\n")
    write(mount / "user/cpu.max", "300000 100000\n")
    assert quota_cores(tmp_path / "self", mount) == 3


def test_a_container_that_sees_its_group_at_the_root_of_the_mount_has_its_quota(tmp_path, mount):
    write(tmp_path / "self", "0::/docker/0123\n")
    write(mount / "cpu.max", "100000 100000\n")
    assert quota_cores(tmp_path / "self", mount) == 1


@pytest.mark.parametrize("name", ["cpu", "cpu,cpuacct"])
def test_the_first_generation_is_read_too(tmp_path, mount, name):
    write(tmp_path / "self", "7:memory:/job\n4:cpu,cpuacct:/job\n")
    write(mount / name / "job/cpu.cfs_quota_us", "250000\n")
    write(mount / name / "job/cpu.cfs_period_us", "100000\n")
    assert quota_cores(tmp_path / "self", mount) == 3


@pytest.mark.parametrize("text", ["max 100000\n", "-1\n", "", "nonsense\n"])
def test_no_quota_is_no_limit(tmp_path, mount, text):
    write(tmp_path / "self", "0::/job\n")
    write(mount / "job/cpu.max", text)
    assert quota_cores(tmp_path / "self", mount) > MANY


def test_a_system_without_control_groups_has_no_limit(tmp_path):
    assert quota_cores(tmp_path / "missing", tmp_path) > MANY


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="only glibc says where freed memory goes")
@pytest.mark.parametrize(("kept", "faults"), [(True, False), (False, True)])
def test_arrays_are_made_in_freed_memory_once_that_is_kept(kept, faults):
    """What the system hands out anew is counted by page faults: of 64 MB there are thousands."""
    script = (
        "import resource, sys, numpy as np; from camcal.run.process import keep_freed_memory\n"
        "if sys.argv[1] == 'True': keep_freed_memory()\n"
        "made = lambda: np.full(1 << 23, 1.0)\n"
        "made(); before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt\n"
        "made(); print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)\n"
    )
    done = subprocess.run([sys.executable, "-c", script, str(kept)], capture_output=True, text=True, check=True)
    assert (int(done.stdout) > 20) == faults
