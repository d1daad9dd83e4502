"""Contents of a camera file: named cameras, the transforms between them, and provenance."""

import math
from collections.abc import Callable, Mapping

import numpy as np

from camcal.arrays import Array, FloatArray, readonly
from camcal.cameras.model import Camera, Rig, reframed, reframing, resized
from camcal.cameras.validity import ImageCircle, valid_block
from camcal.dataclass import dataclass, field, replace
from camcal.errors import InvalidInput
from camcal.geometry.frame_graph import FrameGraph
from camcal.geometry.pose import JOINT, Derived, NamedTransform, Pose, frames_of
from camcal.messages import Message
from camcal.quality.projection_uncertainty import KnownRegion, ProjectionUncertainty
from camcal.quality.range_uncertainty import CalibrationBoards
from camcal.records import Brief
from camcal.targets.board import Surface

STEP = ("tx", "ty", "tz", "rx", "ry", "rz")  # of a pose, the order of its covariance
FRAME = "rig"  # the name of a rig's own frame, where transforms name it


@dataclass(frozen=True, eq=False)
class ValidRegion:
    """Where a camera may be trusted; a limit that is None is not known.

    max_theta: angle from the optical axis, rad. max_radius_px: distance from the principal point.
    polygon: (N, 2) pixels around the region that was observed. image_circle: what the lens lights of the image, None
    where none was found; it is not masked then.
    """

    max_theta: float | None = None
    max_radius_px: float | None = None
    polygon: FloatArray | None = None
    image_circle: ImageCircle | None = None

    def __post_init__(self) -> None:
        if self.polygon is not None:
            object.__setattr__(self, "polygon", readonly(self.polygon, (None, 2), "polygon"))

    @classmethod
    def of(cls, camera: Camera, circle: ImageCircle | None = None) -> "ValidRegion":
        """Return how far a camera's model is one-to-one within its image, or within its image circle."""
        own = {"max_theta_deg": None, **valid_block(camera, circle)}
        return cls(own["max_theta_deg"] and math.radians(own["max_theta_deg"]), own["max_radius_px"], None, circle)


@dataclass(frozen=True)
class ProjectionStd:
    """Standard deviations of where a point at one range (m, None: infinity) is projected, px.

    figures: over the image, those that begin with `inside` over the part of it where corners were seen.
    """

    figures: Mapping[str, float]
    range_m: float | None = None

    @classmethod
    def of(cls, uncertainty: ProjectionUncertainty) -> "ProjectionStd":
        """Return the figures of a map at infinity by the keys of a file."""
        return cls({name.replace("worst", "max"): value for name, value in uncertainty.figures().items()})


@dataclass(frozen=True)
class CalibrationNoise:
    """The standard deviation of one measured pixel coordinate, and the degrees of freedom it was estimated with.

    model_error_px: the part of it that board and lens model leave beyond what detection says of a typical corner.
    """

    sigma_px: float
    degrees_of_freedom: int | None = None
    model_error_px: float | None = None


@dataclass(frozen=True)
class CalibrationVerdict(Brief):
    """Whether a calibration may be trusted, why not, and in which part of the image, None where that is not known."""

    trustworthy: bool
    reasons: tuple[str, ...] = ()
    region: KnownRegion | None = None


def verdict_of_view(verdict: CalibrationVerdict | None) -> CalibrationVerdict | None:
    """Return the verdict for a view that is drawn with a camera: its region is one of the camera's own image."""
    return None if verdict is None else replace(verdict, region=None)


@dataclass(frozen=True, eq=False)
class CameraEntry(Brief):
    """A camera and what is known of it.

    quality: figures such as rms_px, images_used. sensor: pixel_pitch_um, gain_e_per_dn, read_noise_e, full_well_e.
    timing: when images are taken, s, see `native_entry.TIMING`. channels: a lens of its own for some colours.
    held_by_prior: coefficients that the data of the calibration hardly determined: their prior did. boards: of the
    calibration. extra: the x_ keys of other programs, kept as they are.
    """

    camera: Camera
    valid: ValidRegion | None = None
    projection: tuple[ProjectionStd, ...] = ()
    quality: Mapping[str, float] = field(default_factory=dict)
    noise: CalibrationNoise | None = None
    verdict: CalibrationVerdict | None = None
    sensor: Mapping[str, float] = field(default_factory=dict)
    timing: Mapping[str, float] = field(default_factory=dict)
    channels: Mapping[str, Camera] = field(default_factory=dict)
    held_by_prior: tuple[str, ...] = ()
    boards: CalibrationBoards | None = None
    extra: Mapping[str, object] = field(default_factory=dict)

    @property
    def image_circle(self) -> ImageCircle | None:
        """What the lens lights of the image, None where that is not known."""
        return self.valid.image_circle if self.valid is not None else None


@dataclass(frozen=True, eq=False)
class Transform:
    """A pose a_T_b in metres and its covariance (6, 6), order tx ty tz rx ry rz, m and rad."""

    pose: Pose
    covariance: FloatArray | None = None

    def __post_init__(self) -> None:
        if self.covariance is not None:
            object.__setattr__(self, "covariance", readonly(self.covariance, (6, 6), "covariance"))


@dataclass(frozen=True, eq=False)
class JointCovariance:
    """The covariance (N, N) of parameters of several cameras and transforms, such as left.fx and right_T_left.tx."""

    names: tuple[str, ...]
    matrix: FloatArray

    def __post_init__(self) -> None:
        count = len(self.names)
        object.__setattr__(self, "matrix", readonly(self.matrix, (count, count), "joint covariance"))


@dataclass(frozen=True, eq=False)
class CameraFile(Brief):
    """A camera file. transforms: by their names a_T_b. boards: several of them, by their names; they may stand in
    transforms. provenance, converted_from: plain data, never interpreted.

    warnings: what is implausible in the file, or untrustworthy; they are not written.
    """

    cameras: Mapping[str, CameraEntry]
    transforms: Mapping[str, Transform] = field(default_factory=dict)
    joint_covariance: JointCovariance | None = None
    board_shape: Surface | None = None
    boards: Mapping[str, Surface] = field(default_factory=dict)
    provenance: Mapping[str, object] = field(default_factory=dict)
    converted_from: Mapping[str, object] = field(default_factory=dict)
    extra: Mapping[str, object] = field(default_factory=dict)
    warnings: tuple[Message, ...] = ()


@dataclass(frozen=True)
class Framing:
    """Which part of a camera's images others are, applied in this order.

    crop: width, height and the top-left pixel x, y of a part. binning: so many pixels a side became one. scale_to: the
    (width, height) that images were resized to.
    """

    crop: tuple[int, int, int, int] | None = None
    binning: int = 1
    scale_to: tuple[int, int] | None = None

    def of(self, camera: Camera) -> tuple[Camera, FloatArray]:
        """Return the camera of such images, and the derivatives (K, K) of its parameters.

        Raises InvalidInput for a part that is not in the image, and a size of another shape.
        """
        jacobian = np.eye(len(camera.parameters))
        if self.crop is not None:
            width, height, x, y = self.crop
            if x + width > camera.image_size[0] or y + height > camera.image_size[1]:
                size = "{}x{}".format(*camera.image_size)
                raise InvalidInput(f"--crop {width}x{height}+{x}+{y}: not within the image of {size} pixels")
            jacobian = reframing(camera, (1.0, 1.0), (x, y))[1] @ jacobian
            camera = reframed(camera, (width, height), (1.0, 1.0), (x, y))
        if self.binning > 1:
            width, height = (side // self.binning for side in camera.image_size)
            if not width or not height:
                raise InvalidInput(f"--binning {self.binning}: more than the image has pixels")
            scale = 1 / self.binning, 1 / self.binning
            jacobian = reframing(camera, scale)[1] @ jacobian
            camera = reframed(camera, (width, height), scale)
        if self.scale_to is not None:
            usual, camera = camera, resized(camera, self.scale_to)
            scale = camera.image_size[0] / usual.image_size[0], camera.image_size[1] / usual.image_size[1]
            jacobian = reframing(usual, scale)[1] @ jacobian
        return camera, jacobian


def framed(file: CameraFile, framing: Framing) -> CameraFile:
    """Return a file for other images, with all covariances.

    Figures in pixels of the usual images (residuals, uncertainty, regions; noise but of a crop) are left out.
    Raises InvalidInput as `Framing.of` does.
    """
    if framing == Framing():
        return file
    framings = {name: framing.of(entry.camera) for name, entry in file.cameras.items()}
    file = with_cameras(file, framings)
    entries = {
        name: replace(
            entry,
            valid=None if entry.valid is None else ValidRegion(max_theta=entry.valid.max_theta),
            channels={channel: framing.of(own)[0] for channel, own in entry.channels.items()},
            verdict=verdict_of_view(entry.verdict),
            projection=(),
            quality={},
            noise=entry.noise if framing == Framing(framing.crop) else None,
        )
        for name, entry in file.cameras.items()
    }
    return replace(file, cameras=entries)


def with_cameras(file: CameraFile, cameras: Mapping[str, tuple[Camera, Array]]) -> CameraFile:
    """Return a file with other cameras under some names, whose parameters have derivatives (L, K) by those before: what
    the file knows of their covariance with transforms and boards follows. Each camera brings its own covariance.
    """
    entries, joint = dict(file.cameras), file.joint_covariance
    for name, (camera, jacobian) in cameras.items():
        before = entries[name]
        boards = before.boards
        if boards is not None and boards.shift is not None:
            count = len(before.camera.parameters)
            shift = np.concatenate([boards.shift[:, :count] @ jacobian.T, boards.shift[:, count:]], axis=1)
            boards = replace(boards, shift=shift)
        entries[name] = replace(before, camera=camera, boards=boards)
        if joint is not None:
            joint = _with_camera(joint, name, (before.camera, camera), jacobian)
    return replace(file, cameras=entries, joint_covariance=joint)


def _with_camera(joint: JointCovariance, name: str, change: tuple[Camera, Camera], jacobian: Array) -> JointCovariance:
    """Return a joint covariance with the parameters of one camera changed into those of another."""
    old, new = ([f"{name}.{each}" for each in camera.model.parameter_names] for camera in change)
    known = [place for place, each in enumerate(old) if each in joint.names]
    if not known:
        return joint
    columns = [joint.names.index(old[place]) for place in known]
    moved = np.flatnonzero(jacobian[:, known].any(axis=1))  # a parameter that is held has no uncertainty
    lens, others = np.zeros((len(moved), len(joint.names))), np.eye(len(joint.names))
    lens[:, columns] = jacobian[:, known][moved]
    names: list[str] = []
    rows: list[Array] = []
    for place, each in enumerate(joint.names):
        if place == min(columns):
            names += [new[row] for row in moved]
            rows.append(lens)
        if each not in old:
            names.append(each)
            rows.append(others[place : place + 1])
    whole = np.concatenate(rows)
    return JointCovariance(tuple(names), whole @ joint.matrix @ whole.T)


def rig_of(file: CameraFile, where: str) -> tuple[Rig, str]:
    """Return the cameras of a file as a rig, and the name of the rig's frame.

    That is `rig` if a transform names such a frame, otherwise the first camera. Transforms without a covariance are
    taken as exact. Raises InvalidInput naming the first camera of which no transforms say where it stands.
    """
    graph = _graph(file)
    first = next(iter(file.cameras))
    frame = FRAME if FRAME in graph.frames else first
    derived = {name: _pose(graph, frame, name, where) for name in file.cameras}
    poses = {name: own.pose.inverse() for name, own in derived.items()}
    cameras = {name: entry.camera for name, entry in file.cameras.items()}
    return Rig(cameras, poses, _rig_covariance(file, derived)), frame


def parameters_covariance(file: CameraFile) -> JointCovariance:
    """Return the covariance of all lens parameters and transforms of a file: what the joint covariance has, for the
    rest the covariance of each camera and transform by itself, zero for what has none.
    """
    blocks: list[tuple[tuple[str, ...], FloatArray | None]] = [
        (tuple(f"{name}.{each}" for each in entry.camera.model.parameter_names), entry.camera.covariance)
        for name, entry in file.cameras.items()
    ]
    blocks += [(tuple(f"{name}.{step}" for step in STEP), item.covariance) for name, item in file.transforms.items()]
    names = tuple(name for block, _ in blocks for name in block)
    index = {name: place for place, name in enumerate(names)}
    result = np.zeros((len(names), len(names)))
    for block, own in blocks:
        if own is not None:
            rows = [index[name] for name in block]
            result[np.ix_(rows, rows)] = own
    if file.joint_covariance is not None:
        rows = [index[name] for name in file.joint_covariance.names]
        result[rows, :] = result[:, rows] = 0.0  # cross-terms of a block are not known beside those of the joint one
        result[np.ix_(rows, rows)] = file.joint_covariance.matrix
    return JointCovariance(names, result)


def pair_covariance(file: CameraFile, first: str, second: str) -> FloatArray:
    """Return the covariance (N, N) of the lens parameters of two cameras and the step of second_T_first, with
    cross-terms; zero for what has none. Raises InvalidInput if no transforms join the two.
    """
    graph, known, transforms = _graph(file), parameters_covariance(file), list(file.transforms)
    index = {name: place for place, name in enumerate(known.names)}
    lenses = [f"{name}.{each}" for name in (first, second) for each in file.cameras[name].camera.model.parameter_names]
    jacobian = np.zeros((len(lenses) + 6, len(known.names)))
    jacobian[np.arange(len(lenses)), [index[name] for name in lenses]] = 1.0
    for place, by in graph.along(graph.path(second, first)).by.items():
        jacobian[len(lenses) :, [index[f"{transforms[place]}.{step}"] for step in STEP]] = by
    return np.asarray(jacobian @ known.matrix @ jacobian.T)


def transform_covariances(file: CameraFile, transform: str) -> dict[str, FloatArray]:
    """Return the covariances (6, 6) of the step of a transform with those of others in a file by their names, its own
    among them, as far as they are known.
    """
    known = file.transforms[transform].covariance
    own = {} if known is None else {transform: known}
    if file.joint_covariance is None or not (rows := _rows(file.joint_covariance, transform)):
        return own
    places = {name: _rows(file.joint_covariance, name) for name in file.transforms}
    matrix = file.joint_covariance.matrix
    return {name: matrix[np.ix_(rows, columns)] for name, columns in places.items() if columns} | own


def _rows(joint: JointCovariance, transform: str) -> list[int]:
    """Return where the step of a transform stands in a joint covariance, nothing where it does not."""
    names = [f"{transform}.{step}" for step in STEP]
    return [joint.names.index(name) for name in names] if set(names) <= set(joint.names) else []


def named_transform(file: CameraFile, name: str, place: Callable[[str], str] = str) -> NamedTransform:
    """Return a transform of a file with its covariance; place: what is said of where the one of a name stands."""
    known = transform_covariances(file, name)
    cross = {place(other): own for other, own in known.items() if other != name}
    return NamedTransform(*frames_of(name), file.transforms[name].pose, known.get(name), place(name), cross)


def _graph(file: CameraFile) -> FrameGraph:
    return FrameGraph([NamedTransform(*frames_of(name), item.pose) for name, item in file.transforms.items()])


def _rig_covariance(file: CameraFile, derived: Mapping[str, Derived[int]]) -> FloatArray | None:
    """Return the covariance as in Rig; None where no transform has one."""
    known = parameters_covariance(file)
    transforms = list(file.transforms)
    index = {name: place for place, name in enumerate(known.names)}
    rows: list[FloatArray] = []
    for name, own in derived.items():
        parameters = file.cameras[name].camera.model.parameter_names
        lens = np.eye(len(known.names))[[index[f"{name}.{each}"] for each in parameters]]
        pose = np.zeros((6, len(known.names)))
        for place, jacobian in own.by.items():
            pose[:, [index[f"{transforms[place]}.{step}"] for step in STEP]] = jacobian
        rows += [lens, pose]
    jacobian = np.concatenate(rows)
    result = np.asarray(jacobian @ known.matrix @ jacobian.T)
    uncertain = any(known.matrix[index[f"{name}.{step}"]].any() for name in transforms for step in STEP)
    return result if uncertain else None


def transform_between(file: CameraFile, target: str, source: str) -> Transform | None:
    """Return target_T_source by way of the transforms of a file, with its covariance where all of them have one; None
    if they do not join the two.
    """
    graph, names = _graph(file), list(file.transforms)
    try:
        derived = graph.along(graph.path(target, source))
    except InvalidInput:
        return None
    used = {place: named_transform(file, names[place]) for place in derived.by}
    unknown = any(item.covariance is None for item in used.values())
    return Transform(derived.pose, None if unknown else derived.covariance_of(used))


def pose_between(file: CameraFile, target: str, source: str) -> Pose | None:
    """Return the pose of `transform_between`."""
    found = transform_between(file, target, source)
    return None if found is None else found.pose


def _pose(graph: FrameGraph, frame: str, camera: str, where: str) -> Derived[int]:
    """Return camera_T_frame, by the places of the transforms in the file."""
    if camera == frame:
        return Derived(Pose.identity(), {})
    try:
        return graph.along(graph.path(camera, frame))
    except InvalidInput as error:
        raise InvalidInput(
            f"no transform connects camera {camera!r}: transforms such as {camera}{JOINT}{frame} are missing",
            where=where,
        ) from error
