"""What stands beside a disparity map: the files its sidecar names, and the image that points are made of."""

from pathlib import Path

from camcal.errors import FileError
from camcal.formats import disparity, disparity_sidecar
from camcal.formats.disparity import DisparityMap
from camcal.images.load import load
from camcal.progress import Progress
from camcal.stereo.points.depth import StereoImage
from camcal.tasks.stereo.rectified_pair import RectifiedPair


def named_file(
    path: Path | None, disparity_path: Path, progress: Progress, needed_by: str | None = None
) -> Path | None:
    """Return a file that the sidecar of a map names; None with a warning if it is not there.

    needed_by: the option that asks for it.
    Raises FileError if it is not there and an option asks for it.
    """
    if path is None or path.is_file():
        return path
    sidecar = disparity_sidecar.path_beside(disparity_path)
    told = f"it names {path.name}, which is not there"
    if needed_by is not None:
        raise FileError(f"{told}, and {needed_by} needs it", where=str(sidecar))
    progress.warn(f"{sidecar}: {told}; done without")
    return None


def stereo_image(
    found: DisparityMap,
    pair: RectifiedPair,
    image: Path | None,
    sigma: Path | float | None,
    confidence: Path | None = None,
) -> StereoImage:
    """Return a map whose geometry is known, with what is to be used of the files beside it.

    image: the left one. sigma: an image of it, or one for all pixels, pixels.
    Raises InvalidInput if their sizes differ, FileError.
    """
    assert pair.geometry is not None
    return StereoImage(
        found.values,
        pair.geometry,
        signed=found.signed,
        pixels=load(image).pixels if image else None,
        sigma=disparity.read(sigma).values if isinstance(sigma, Path) else sigma,
        confidence=load(confidence).pixels if confidence else None,
        calibration_sigma=pair.sigma_of_product,
    )
