"""Tags and boards followed over time: how often is the pose the mirrored or another wrong one, and is that said?

Videos are those of `tracking_scenes`: four kinds of motion × tags of 20, 45 and 100 px and boards of 54 corners × clean
and dirty. A frame counts if it shows the target; it is wrong if the pose is more than 10° off or missing. `choice` is
the pose of the single frame that is nearer to the truth: nobody can choose better without the other frames. `poses` is
the filter that knows the poses of single frames only, as `camcal track POSES` has them; a frame of which all poses are
wrong tells it nothing, and is missing. `filled` is the same with --fill, which gives such frames the smoothed pose.
Coverage is the share of the right poses inside their 95 % region. Stated: the mean probability of a wrong pose that is
given, of the poses given, and how many of them are wrong.

Run: python benchmarks/pose_tracks.py [--seeds 200 202] [--frames 300] [--modes poses,filled,batch,lag,causal]
"""

import argparse
import time
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from tracking_scenes import CENTRE, FOCAL, MOTIONS, SIZE, TARGETS, Video, videos

from camcal.arrays import Array
from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.errors import InsufficientData
from camcal.estimate.pnp import estimate_poses
from camcal.estimate.poses.records import Correspondences, PoseEstimate, PoseOptions
from camcal.estimate.tracking.track import Track, TrackOptions, track_poses, track_views
from camcal.geometry import rotation as so3

CAMERA = Camera(model_named("pinhole"), SIZE, np.array([FOCAL, FOCAL, *CENTRE]))
WRONG = np.radians(10.0)
REGION = 12.592  # 95 % of χ² with 6 degrees of freedom
MODES = {"batch": None, "lag": 15, "causal": 0}


@dataclass(frozen=True, eq=False)
class Scored:
    """A mode on a video: shares of wrong frames, coverage, what was said of it, and the time it took.

    doubts: (K, 2) the probability that was given for another pose, and whether it was one.
    """

    wrong: float
    missing: float
    coverage: float
    verdict: str
    milliseconds: float
    doubts: Array


def single_poses(video: Video) -> tuple[list[Correspondences | None], list[PoseEstimate | None]]:
    """Return the views of a video and the poses of its single frames."""
    views = [
        Correspondences(str(index), video.points, pixels) if np.isfinite(pixels[0, 0]) else None
        for index, pixels in enumerate(video.pixels)
    ]
    found = estimate_poses(CAMERA, [view for view in views if view], PoseOptions(outliers="few"))
    by_name = {one.item.image: one.value for one in found}
    return views, [by_name.get(str(index)) for index in range(len(views))]


def off(rotation: Array, video: Video, frame: int) -> float:
    return float(so3.angle_between(rotation, video.rotations[frame]))


def of_single_frames(video: Video, poses: Sequence[PoseEstimate | None]) -> tuple[float, float]:
    """Return the shares of wrong frames of single poses, and of the nearest of all poses that each frame allows."""
    first, nearest = [], []
    for frame in np.flatnonzero(video.right):
        pose = poses[frame]
        allowed = [] if pose is None else [pose.transform, *(other.transform for other in pose.alternatives)]
        angles = [off(each.rotation, video, frame) for each in allowed] or [np.pi]
        first.append(angles[0] > WRONG)
        nearest.append(min(angles) > WRONG)
    return float(np.mean(first)), float(np.mean(nearest))


def scored(video: Video, track: Track, seconds: float) -> Scored:
    frames = np.flatnonzero(video.right)
    given = track.posed[frames]
    turns = so3.log(np.nan_to_num(track.rotations[frames]) @ video.rotations[frames].swapaxes(-1, -2))
    angles = np.where(given, np.linalg.norm(turns, axis=1), np.pi)
    right = angles < WRONG
    steps = np.concatenate([track.translations[frames] - video.translations[frames], turns], axis=1)[right]
    spread = track.covariances[frames][right]
    distance = np.einsum("ni,ni->n", steps, np.linalg.solve(spread, steps[..., None])[..., 0])
    doubts = np.stack([track.p_wrong[frames][given], ~right[given]], axis=1)
    verdict = track.consistency.verdict if track.consistency else "none"
    coverage = float(np.mean(distance < REGION)) if right.any() else float("nan")
    return Scored(
        float(np.mean(~right)), float(np.mean(~given)), coverage, verdict, 1e3 * seconds / len(video.stamps), doubts
    )


def run(video: Video, modes: Sequence[str]) -> dict[str, float | Scored]:
    """Return what every method makes of a video, single frames as shares of wrong ones."""
    views, poses = single_poses(video)
    first, nearest = of_single_frames(video, poses)
    result: dict[str, float | Scored] = {"single": first, "choice": nearest}
    for mode in modes:
        begun = time.process_time()
        try:
            track = (
                track_poses(video.stamps, poses, TrackOptions(fill=mode == "filled"))
                if mode in ("poses", "filled")
                else track_views(CAMERA, video.stamps, views, poses, TrackOptions(lag=MODES[mode]))
            )
        except InsufficientData:
            result[mode] = Scored(1.0, 1.0, float("nan"), "none", float("nan"), np.zeros((0, 2)))
            continue
        result[mode] = scored(video, track, time.process_time() - begun)
    return result


def percent(values: Sequence[float]) -> str:
    return f"{100 * np.nanmean(values):.1f}" if len(values) else "-"


def table(results: Sequence[tuple[Video, dict[str, float | Scored]]], modes: Sequence[str]) -> None:
    """Print the shares by motion and target, then what holds for all."""
    columns = ["single", "choice", *modes]
    print("wrong, %".ljust(18), *(column.rjust(8) for column in columns), "worst".rjust(8), "coverage".rjust(9))
    groups = [(motion, target) for motion in MOTIONS for target in TARGETS] + [("all", "")]
    for motion, target in groups:
        rows = [row for video, row in results if motion == "all" or (video.motion, video.target) == (motion, target)]
        cells = [percent([share(row[column]) for row in rows]) for column in columns]
        last = [row[modes[-1] if "batch" not in modes else "batch"] for row in rows]
        worst = f"{100 * max(share(each) for each in last):.1f}"
        coverage = percent([each.coverage for each in last if isinstance(each, Scored)])
        print(f"{motion} {target}".ljust(18), *(cell.rjust(8) for cell in cells), worst.rjust(8), coverage.rjust(9))
    for mode in modes:
        scores = [row[mode] for _, row in results]
        told = [each for each in scores if isinstance(each, Scored)]
        unsaid = sum(each.wrong > 0.05 and each.verdict == "consistent" for each in told)
        cost = np.nanmedian([each.milliseconds for each in told])
        print(f"{mode}: {unsaid} videos wrong in more than 5 % and called consistent; {cost:.1f} ms a frame (median)")
        doubts = np.concatenate([each.doubts for each in told])
        missing, (said, was) = percent([each.missing for each in told]), 100 * doubts.mean(axis=0)
        print(f"  missing {missing} %; of the poses given: stated {said:.1f} %, wrong {was:.1f} %")
        bounds = (0.0, 0.01, 0.1, 0.3, 0.5, 1.01)
        for low, high in pairwise(bounds):
            inside = doubts[(doubts[:, 0] >= low) & (doubts[:, 0] < high)]
            if len(inside):
                said, was = inside.mean(axis=0)
                print(f"  said {low:.2f}-{min(high, 1):.2f}: {len(inside)} frames, mean {said:.3f}, wrong {was:.3f}")


def share(cell: float | Scored) -> float:
    return cell.wrong if isinstance(cell, Scored) else cell


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, nargs=2, default=(200, 202), metavar=("FIRST", "END"))
    parser.add_argument("--frames", type=int, default=300)
    parser.add_argument("--modes", default="poses,filled,batch,lag,causal")
    parser.add_argument("--verbose", action="store_true")
    options = parser.parse_args()
    modes = options.modes.split(",")
    results = []
    for video in videos(range(*options.seeds), options.frames):
        results.append((video, run(video, modes)))
        if options.verbose:
            cells = [f"{name} {100 * share(cell):.1f}" for name, cell in results[-1][1].items()]
            scores = [cell for cell in results[-1][1].values() if isinstance(cell, Scored)]
            cells += [f"{each.verdict} {100 * each.coverage:.0f} {each.milliseconds:.1f}" for each in scores]
            print(video.name, *cells, sep=", ", flush=True)
    table(results, modes)


if __name__ == "__main__":
    main()
