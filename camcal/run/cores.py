"""How many cores this process may use: its CPU affinity and the quota of its control group."""

import math
import os
from pathlib import Path

_MOUNT = Path("/sys/fs/cgroup")
_MEMBERSHIP = Path("/proc/self/cgroup")


def available_cores() -> int:
    """Return the number of cores this process may use, at least 1."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return max(1, min(cores, quota_cores(_MEMBERSHIP, _MOUNT)))


def quota_cores(membership: Path, mount: Path) -> int:
    """Return the cores the tightest CPU quota of a control group allows, rounded up; a huge number without one.

    membership: a file as /proc/self/cgroup, lines `id:controllers:path`. mount: the folder of the control groups.
    Source: Linux documentation, cgroup-v2 (cpu.max) and sched-bwc (cpu.cfs_quota_us).
    """
    shares = [share for folder in _folders(membership, mount) if (share := _share(folder)) is not None]
    return math.ceil(min(shares, default=1 << 20))


def _folders(membership: Path, mount: Path) -> list[Path]:
    """Return the folders that may limit the process; a parent's quota holds for its children too."""
    result = []
    for line in _text(membership).splitlines():
        _, controllers, path = line.split(":", 2)
        if not controllers:
            root = mount
        elif "cpu" in controllers.split(","):
            root = mount / controllers if (mount / controllers).is_dir() else mount / "cpu"
        else:
            continue
        # Inside a container the path may be the host's; its own group is then the root of the mount.
        group = root / path.lstrip("/")
        result += [group, *(parent for parent in group.parents if parent.is_relative_to(root))]
    return result


def _share(folder: Path) -> float | None:
    """Return quota / period of one group, None where it has no limit."""
    words = _text(folder / "cpu.max").split() or [
        *_text(folder / "cpu.cfs_quota_us").split(),
        *_text(folder / "cpu.cfs_period_us").split(),
    ]
    if len(words) != 2 or not all(word.isdigit() for word in words) or int(words[1]) == 0:
        return None  # "max 100000" and "-1" mean no limit
    return int(words[0]) / int(words[1])


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="ascii")
    except (OSError, UnicodeDecodeError):
        return ""
