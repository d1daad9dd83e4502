"""Links between cameras, and the most certain path from one camera to another."""

import heapq
from collections.abc import Sequence

from camcal.dataclass import dataclass


@dataclass(frozen=True)
class CameraLink:
    """Two cameras, the boards that they saw in the same captures (one name where it is the same, none where it has
    none), how many captures, and the standard deviation, m, of an axis of their relative position by these alone.
    """

    cameras: tuple[str, str]
    boards: tuple[str, ...]
    captures: int
    std: float

    def as_data(self) -> dict[str, object]:
        """Return the link as plain data."""
        return {
            "cameras": list(self.cameras),
            "boards": list(self.boards),
            "captures": self.captures,
            "std_m": self.std,
        }


def certain_path(links: Sequence[CameraLink], first: str, last: str) -> tuple[CameraLink, ...]:
    """Return the links that lead from one camera to another with the least variance, none where nothing does.

    Source: Dijkstra, A note on two problems in connexion with graphs, 1959.
    """
    beside: dict[str, list[CameraLink]] = {}
    for link in links:
        for camera in link.cameras:
            beside.setdefault(camera, []).append(link)
    reached: dict[str, tuple[CameraLink, ...]] = {}
    open_: list[tuple[float, int, str, tuple[CameraLink, ...]]] = [(0.0, 0, first, ())]
    count = 0
    while open_:
        variance, _, camera, path = heapq.heappop(open_)
        if camera in reached:
            continue
        reached[camera] = path
        for link in beside.get(camera, ()):
            [other] = set(link.cameras) - {camera}
            count += 1
            heapq.heappush(open_, (variance + link.std**2, count, other, (*path, link)))
    return reached.get(last, ())
