"""What `camcal handeye` says of a robot: noise, what is systematically wrong, doubtful poses; in words and as data."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from camcal.calibrate.problem import POSE
from camcal.calibrate.robot.estimator import RobotEstimate
from camcal.calibrate.robot.problem import SYSTEMATIC, SeenPoses
from camcal.dataclass import dataclass
from camcal.formats.camera_file import Transform
from camcal.geometry import rotation as so3
from camcal.messages import Message
from camcal.report.table import Column

COLUMNS = (
    Column("transform"),
    Column("x", "mm"),
    Column("y", "mm"),
    Column("z", "mm"),
    Column("± std", "mm"),
    Column("rotation vector", "deg"),
    Column("± std", "deg"),
)
POSE_COLUMNS = (
    Column("pose", file=True),
    Column("x", "mm"),
    Column("y", "mm"),
    Column("z", "mm"),
    Column("angle", "deg"),
    Column("weight"),
)
SIGNIFICANT = 4.0  # standard deviations of what is systematically wrong: of few poses, chance in one of 1000 lists
_MOST_SCALE = 0.5  # by which a robot's lengths are wrong: poses that belong to no image would best have none
_MILLI = 1e3
_LARGE_SHIFT = 5e-3  # m: noise of no robot that is sound
_LARGE_TURN = 8.7e-3  # rad
# the weight below which a pose of the robot is named: noise reaches it in fewer than one of 1000 lists, also where that
# of single poses is larger by a half, as that of poses between two moments is
DOUBTFUL = 0.2
_LINEAR = 0.3  # of the variance of its position errors, linear in position
_CHANCE = 1e-3  # of such a share or more by noise alone


@dataclass(frozen=True, eq=False)
class HandEyeReport:
    """Hand and eye. transforms: by their names, with covariances. noise: of the robot, σ with its 95 % interval, m and
    rad. systematic: scale and delay (s) of its poses with standard deviations, where they could be tested; estimated:
    the names of those that were taken out. doubtful: images whose pose of the robot hardly counts. linear: the share of
    the variance of its position errors that is linear in position. words: how the poses were read.
    """

    transforms: Mapping[str, Transform]
    estimate: RobotEstimate
    noise: tuple[tuple[float, float, float], tuple[float, float, float]]
    systematic: Mapping[str, tuple[float, float]]
    estimated: tuple[str, ...]
    images: tuple[str, ...]
    doubtful: tuple[str, ...]
    linear: float
    words: str
    outputs: tuple[Path, ...]
    warnings: tuple[Message, ...]


def systematic_messages(systematic: Mapping[str, tuple[float, float]], estimated: Sequence[str]) -> list[Message]:
    """Return what is significantly wrong with all poses of a robot."""
    found = []
    for name, (value, std) in systematic.items():
        values = {"value": value, "std": std}
        if abs(value) < SIGNIFICANT * std or (name == "scale" and abs(value) > _MOST_SCALE):
            continue
        if name == "scale":
            way = "short" if value > 0 else "long"
            text = f"the robot's lengths are {100 * abs(value):.2g} ± {100 * std:.1g} % too {way} against the board's"
            if name not in estimated:
                text += ": correct them, or the size of the board, or estimate it, --robot-scale"
            found.append(Message("robot_scale", text, values))
        else:
            text = f"the robot's poses are {abs(value):.3g} ± {std:.1g} s {'late' if value > 0 else 'early'}"
            found.append(Message("robot_delay", f"{text}, which is taken out", values))
    return found


def report_of(
    estimate: RobotEstimate,
    transforms: Mapping[str, Transform],
    delay: float,
    images: tuple[str, ...],
    words: str,
    warnings: tuple[Message, ...],
) -> HandEyeReport:
    """Return what is reported of an estimate. delay: s, that has been taken out beforehand. warnings: of the poses."""
    doubtful = tuple(image for image, weight in zip(images, estimate.weights, strict=True) if weight < DOUBTFUL)
    systematic = {
        name: (value + (delay if name == "delay" else 0.0), std) for name, (value, std) in estimate.systematic.items()
    }
    sigmas, dof = estimate.sigmas, estimate.dof
    rig = estimate.problem.rig
    if isinstance(rig, SeenPoses) and rig.covariances is None:
        # how much of it is whose can hardly be told
        sigmas, dof = (sigmas[0], float(np.hypot(sigmas[1], rig.turn_std))), (dof[0], 3.0 * len(images) - POSE)
    estimated, (linear, chance) = tuple(SYSTEMATIC[place] for place in estimate.problem.free), _linear_share(estimate)
    return HandEyeReport(
        transforms,
        estimate,
        (_interval(sigmas[0], dof[0]), _interval(sigmas[1], dof[1])),
        systematic,
        estimated,
        images=images,
        doubtful=doubtful,
        linear=linear,
        words=words,
        outputs=(),
        warnings=(
            *warnings,
            *_remarks(doubtful, linear if chance < _CHANCE else 0.0, sigmas),
            *systematic_messages(systematic, estimated),
        ),
    )


def _interval(sigma: float, dof: float) -> tuple[float, float, float]:
    """Return a standard deviation with its 95 % interval, given its degrees of freedom."""
    from scipy.stats import chi2

    low, high = (sigma * float(np.sqrt(dof / chi2.ppf(share, dof))) for share in (0.975, 0.025))
    return sigma, low, high


def _linear_share(estimate: RobotEstimate) -> tuple[float, float]:
    """Return the share of the variance of the robot's position errors that is linear in position, beyond chance, and
    how likely noise has as much.
    """
    from scipy.special import fdtrc

    counted = estimate.weights >= DOUBTFUL
    places, errors = estimate.problem.robot.base_T_hand.translations[counted], estimate.residuals[counted, :3]
    terms = np.column_stack([np.ones(len(places)), places - places.mean(axis=0)])
    count, used = len(places), terms.shape[1]
    if count <= 2 * used:
        return 0.0, 1.0
    left = float(np.sum((errors - terms @ np.linalg.lstsq(terms, errors, rcond=None)[0]) ** 2)) / (count - used)
    whole = float(np.sum((errors - errors.mean(axis=0)) ** 2))
    if left <= 0:
        return 0.0, 1.0
    ratio = (whole / left - (count - used)) / (used - 1)
    return max(0.0, 1.0 - left * (count - 1) / whole), float(fdtrc(3 * (used - 1), 3 * (count - used), ratio))


def _remarks(doubtful: Sequence[str], systematic: float, sigmas: tuple[float, float]) -> tuple[Message, ...]:
    """Return what is to be said of the robot's poses."""
    found = []
    if sigmas[0] > _LARGE_SHIFT or sigmas[1] > _LARGE_TURN:
        size = f"{_MILLI * sigmas[0]:.2g} mm and {np.degrees(sigmas[1]):.2g}°"
        text = f"noise of the robot {size}, more than any robot has: are poses and images of the same moments?"
        found.append(Message("large_robot_noise", text, {"position_m": sigmas[0], "rotation_rad": sigmas[1]}))
    if doubtful:
        text = f"the robot's poses of {', '.join(doubtful[:5])}{' …' * (len(doubtful) > 5)} fit no other"
        found.append(Message("doubtful_robot_pose", text, {"poses": len(doubtful)}))
    if systematic > _LINEAR:
        share = f"{100 * systematic:.0f} % of the variance of the robot's position errors"
        text = f"{share} is linear in position: systematic, not noise"
        found.append(Message("systematic_robot", text, {"share": systematic}))
    return tuple(found)


def rows(report: HandEyeReport) -> list[list[object]]:
    """Return the rows of the table."""
    table: list[list[object]] = []
    for name, transform in report.transforms.items():
        covariance = np.asarray(transform.covariance)
        std = np.sqrt(np.diag(covariance))
        vector = np.degrees(so3.log(transform.pose.rotation))
        table.append(
            [
                name,
                *(f"{_MILLI * value:.3f}" for value in transform.pose.translation),
                f"{_MILLI * np.sqrt(np.mean(std[:3] ** 2)):.2g}",
                " ".join(f"{value:.4f}" for value in vector),
                f"{np.degrees(np.sqrt(np.mean(std[3:] ** 2))):.2g}",
            ]
        )
    return table


def pose_rows(report: HandEyeReport) -> list[list[object]]:
    """Return the rows of the table of the robot's poses, the worst first."""
    found = report.estimate
    order = np.argsort(found.weights, kind="stable")
    return [
        [
            report.images[place],
            *(f"{_MILLI * value:.3f}" for value in found.residuals[place, :3]),
            f"{np.degrees(np.linalg.norm(found.residuals[place, 3:])):.4f}",
            f"{found.weights[place]:.2f}",
        ]
        for place in order
    ]


def noise_words(report: HandEyeReport) -> str:
    """Return the robot's noise in a line."""
    (shift, low, high), (turn, least, most) = report.noise
    place = f"position {_MILLI * shift:.3g} mm ({_MILLI * low:.2g} to {_MILLI * high:.2g})"
    turned = np.degrees([turn, least, most])
    angle = f"rotation {turned[0]:.3g}° ({turned[1]:.2g} to {turned[2]:.2g})"
    rig = report.estimate.problem.rig
    both = " and of the poses of the board" if isinstance(rig, SeenPoses) and rig.covariances is None else ""
    return f"Noise of the robot{both}: {place}, {angle}, 95 % intervals"


def document(report: HandEyeReport) -> dict[str, Any]:
    """Return the report as plain data for --json."""
    (shift, low, high), (turn, least, most) = report.noise
    return {
        "output": report.outputs[0] if report.outputs else None,
        "read_as": report.words,
        "transforms": {
            name: {
                "R": item.pose.rotation.tolist(),
                "t_m": item.pose.translation.tolist(),
                "covariance": np.asarray(item.covariance).tolist(),
            }
            for name, item in report.transforms.items()
        },
        "robot_noise": {
            "position_m": {"value": shift, "low": low, "high": high},
            "rotation_rad": {"value": turn, "low": least, "high": most},
            "systematic_share": report.linear,
        },
        "systematic": {
            f"{name}_s" if name == "delay" else name: {
                "value": value,
                "std": std,
                "significant": abs(value) >= SIGNIFICANT * std,
                "estimated": name in report.estimated,
            }
            for name, (value, std) in report.systematic.items()
        },
        "poses": [
            {"image": image, "shift_m": shift.tolist(), "rotation_vector": turned.tolist(), "weight": float(weight)}
            for image, shift, turned, weight in zip(
                report.images,
                report.estimate.residuals[:, :3],
                report.estimate.residuals[:, 3:],
                report.estimate.weights,
                strict=True,
            )
        ],
        "passes": report.estimate.passes,
    }
