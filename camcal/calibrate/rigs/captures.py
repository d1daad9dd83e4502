"""What the cameras of a rig saw of a board: detections by capture and camera."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

from camcal.brief import Brief
from camcal.errors import InvalidInput
from camcal.targets.detection import BoardDetection


@dataclass(frozen=True, eq=False)
class Captures(Brief):
    """cameras: (N,) names. names: (G,) of the captures. views[g][c]: what camera c saw in capture g, None without an
    image of it. Raises InvalidInput for names that occur twice and for rows of another length.
    """

    cameras: tuple[str, ...]
    names: tuple[str, ...]
    views: tuple[tuple[BoardDetection | None, ...], ...]

    def __post_init__(self) -> None:
        for what, names in (("camera", self.cameras), ("capture", self.names)):
            twice = next((name for index, name in enumerate(names) if name in names[:index]), None)
            if twice is not None:
                raise InvalidInput(f"{what} {twice!r} occurs twice")
        if len(self.views) != len(self.names) or any(len(row) != len(self.cameras) for row in self.views):
            raise InvalidInput("captures need a row each and a view, or None, of every camera in it")

    def __len__(self) -> int:
        """Return the number of captures."""
        return len(self.names)

    def of(self, camera: int) -> tuple[BoardDetection | None, ...]:
        """Return the views of one camera, one for each capture."""
        return tuple(row[camera] for row in self.views)

    def without(self, views: Collection[tuple[int, int]], reason: str) -> "Captures":
        """Return the captures without the points of some views (capture, camera), and why they have none."""
        rows = [
            tuple(
                view.without_points(reason) if view is not None and (capture, camera) in views else view
                for camera, view in enumerate(row)
            )
            for capture, row in enumerate(self.views)
        ]
        return replace(self, views=tuple(rows))

    def take(self, captures: Sequence[int]) -> "Captures":
        """Return some of the captures."""
        return replace(
            self,
            names=tuple(self.names[index] for index in captures),
            views=tuple(self.views[index] for index in captures),
        )
