"""The most common calls of every command: for --examples, --help and man pages, and for calls without arguments."""

from collections.abc import Iterator, Mapping
from textwrap import dedent
from types import MappingProxyType
from typing import NamedTuple


class Example(NamedTuple):
    """A call of a command, without the program's name, and what it does."""

    call: str
    purpose: str


_CALLS = {  # a comment with the purpose above each call, as in a shell
    "demo": """
        # Calibrate 20 rendered images and compare with the truth, in camcal-demo/
        demo
        # The same with more images
        demo -o demo --views 40
        # Other poses and other noise
        demo -o other --seed 7
    """,
    "simulate": """
        # Images of a chessboard with 9 x 6 inner corners
        simulate chessboard:9x6:25mm -o scene
        # 30 images of a ChArUco board through the lens of a camera file
        simulate charuco:9x7:30mm:22mm:DICT_5X5_100 camera.yaml -o scene --views 30
        # Rectified stereo pairs with true disparities
        simulate --stereo -o pairs
    """,
    "board": """
        # A chessboard as PDF, on the smallest paper that it fits
        board chessboard:9x6:25mm -o target.pdf
        # A ChArUco board for A4 paper
        board charuco:9x7:30mm:22mm:DICT_5X5_100 -o target.pdf --paper A4
        # An AprilGrid, with the target file for Kalibr
        board aprilgrid:6x6:88mm:0.3 -o target.pdf --kalibr kalibr.yaml
    """,
    "detect": """
        # The corners in all images of a folder as a table
        detect photos/ --board chessboard:9x6:25mm -o detections.csv
        # The corners in sharp, different frames of a video
        detect video.mp4 --board charuco:9x7:30mm:22mm:DICT_5X5_100 -o detections.csv
        # The same with pictures that show what was found
        detect photos/ --board target.yaml -o detections.csv --draw drawn
    """,
    "calibrate": """
        # From a folder of images to a camera file
        calibrate photos/ --board chessboard:9x6:25mm -o camera.yaml
        # From a video, with the board file that camcal board wrote
        calibrate video.mp4 --board target.yaml -o camera.yaml
        # From corners that were detected before, with a chosen lens model
        calibrate detections.csv --model fisheye -o camera.yaml
    """,
    "rig": """
        # Two cameras, each with a folder of its own
        rig left=photos/left right=photos/right --board chessboard:9x6:25mm -o rig.yaml
        # Cameras told apart by the names of the images or their folders
        rig photos/ --board target.yaml -o rig.yaml
        # Three cameras from synchronised videos
        rig a=a.mp4 b=b.mp4 c=c.mp4 --board target.yaml -o rig.yaml
    """,
    "report": """
        # From detections: the verdict, all figures, and the data to repeat them
        report detections.csv -o report.html
        # What a camera file holds
        report camera.yaml -o report.html
        # With another lens model
        report detections.csv -o report.html --model opencv8
    """,
    "rerun": """
        # Calibrate again from a report: camera.yaml and report.html in a folder
        rerun report.html -o repeated
        # The same as JSON, for scripts
        rerun report.html -o repeated --json
        # List all figures that differ
        rerun report.html -o repeated --verbose
    """,
    "undistort": """
        # All images of a folder without distortion
        undistort camera.yaml photos/ -o undistorted
        # Images of a fisheye lens as a cylindrical panorama
        undistort fisheye.yaml photos/ -o wide --projection cylinder
        # Pixel coordinates in place of images
        undistort camera.yaml --points pixels.csv -o straight.csv
    """,
    "plot": """
        # All figures of a camera file, with their captions
        plot camera.yaml -o figures
        # One figure of detections, as PDF
        plot detections.csv -o coverage.pdf --figure coverage
        # A trajectory against its reference, coloured by the error
        plot estimate.tum -o figures --reference truth.tum --figure-format svg
    """,
    "convert": """
        # A camera file for OpenCV
        convert camera.yaml opencv.xml
        # A camera file for ROS
        convert camera.yaml ros.yaml --to ros
        # A camera chain of Kalibr as a rig of camcal
        convert camchain.yaml rig.yaml
    """,
    "inspect": """
        # One value of a camera file, for a script
        inspect camera.yaml --get cameras.camera.quality.rms_px
        # How well it measures at 0.8 m: points, and an object of 100 mm
        inspect camera.yaml --at 0.8m --length 100mm
        # Size, pattern and exposure of a raw frame
        inspect IMG_0001.DNG
    """,
    "advise": """
        # Which views to take next, with their picture
        advise camera.yaml -o next.png
        # The same from corners, with the views that may be left out
        advise corners.csv
        # Which poses a robot's hand should take next, by what handeye said of its noise
        advise hand.yaml --robot 0.5mm,0.06deg
    """,
    "handeye": """
        # Where the camera stands on the hand, poses by the names of images
        handeye camera.yaml images/ --robot poses.csv -o hand.yaml
        # Where it stands beside the robot, with the board in the hand
        handeye camera.yaml images/ --robot poses.txt --eye-to-hand -o base.yaml
        # Poses of the board of another program in the place of images
        handeye --camera-poses board.csv --robot poses.csv -o hand.yaml
    """,
    "check": """
        # Whether last month's calibration still holds
        check camera.yaml today/*.png
        # All cameras of a rig and how they stand to each other, for a build server
        check rig.yaml left=today/left right=today/right --junit check.xml
        # By how much a camera has moved against a board that has not
        check camera.yaml now.png --reference installed.yaml
    """,
    "diff": """
        # Whether two calibrations are of the same camera
        diff monday.yaml friday.yaml
        # The history of one camera, as a gate for scripts
        diff first.yaml second.yaml third.yaml --max 1 --max-sigma 4
        # The difference for points at 0.5 m and 2 m, with its map
        diff camera.yaml opencv.xml --at 0.5m,2m --plot difference.png
    """,
    "demosaic": """
        # A raw photograph in colour, with a tone curve for the screen
        demosaic IMG_0001.DNG -o IMG_0001.tiff --wb camera --tone srgb
        # All raw frames of a folder as linear colour images
        demosaic raw/ -o developed --wb camera
        # A frame of an industrial camera without a header
        demosaic frame.raw -o frame.tiff --format BayerRG12p --size 1920x1200
    """,
    "sensor": """
        # Gain, read noise and full well, with the photon transfer curve
        sensor flats/ --dark darks/ -o sensor.yaml --plot photon_transfer.png
        # The same of Bayer mosaics whose white level is known
        sensor flats/ --dark darks/ --pattern RGGB --white 4095 -o sensor.yaml
        # Flat frames of two exposures, in folders of their own
        sensor dim/ bright/ --dark night/ --exposure 0.005,0.02 -o sensor.yaml
    """,
    "stereo calibrate": """
        # A pair of cameras from a folder of images each
        stereo calibrate left/ right/ --board chessboard:9x6:25mm -o rig.yaml
        # Images of both cameras in one folder
        stereo calibrate 'left*.png' 'right*.png' --board target.yaml -o rig.yaml
        # Only where the cameras stand; their lenses are known
        stereo calibrate left/ right/ --board a.yaml --lenses fixed --guess lens.yaml -o rig.yaml
    """,
    "stereo run": """
        # Point clouds from the images of a calibrated pair
        stereo run rig.yaml left/ right/ -o result
        # The same, calibrated from those of the images that show the board
        stereo run left/ right/ --board chessboard:9x6:25mm -o result
        # Calibrated from images, clouds of two videos
        stereo run left/ right/ --board target.yaml --scene left.mp4 right.mp4 -o result
    """,
    "stereo check": """
        # Whether the rows of two images correspond
        stereo check left.png right.png
        # The same with a picture of the errors
        stereo check left.png right.png -o check.png
        # All pairs of two folders, as a gate for scripts
        stereo check left/ right/ --max-rms 0.5
    """,
    "stereo rectify": """
        # Rectified images of a calibrated pair
        stereo rectify rig.yaml left/ right/ -o rectified
        # Two videos, at half the size
        stereo rectify rig.yaml left.mp4 right.mp4 -o rectified --scale 0.5
        # Maps and matrices for OpenCV, no images
        stereo rectify rig.yaml -o maps --maps --opencv --projection pinhole
    """,
    "stereo disparity": """
        # The disparity map of a pair
        stereo disparity left.png right.png rig.yaml -o disparity.pfm
        # Maps of all pairs of two folders, with coloured pictures
        stereo disparity left/ right/ rig.yaml -o maps --vis
        # A rectified pair with a known range of disparities
        stereo disparity left.png right.png -o disparity.tiff --range 0:128
    """,
    "stereo cloud": """
        # The point cloud of a disparity map that camcal wrote
        stereo cloud disparity.pfm -o cloud.ply
        # A coloured cloud of any disparity map, up to 40 m
        stereo cloud disparity.png left.png rig.yaml -o cloud.ply --max-depth 40
        # From a pair in one step, with the standard deviation of every point
        stereo cloud left.png right.png rig.yaml -o cloud.ply --sigma
    """,
    "stereo eval": """
        # The errors of a disparity map
        stereo eval disparity.pfm truth.pfm
        # Errors in depth too, only where both cameras see the surface
        stereo eval disparity.pfm truth.pfm calib.txt --mask visible.png
        # A folder of maps, as a gate for scripts
        stereo eval maps/ truths/ --gate bad2=5
    """,
    "view": """
        # A cloud as a page that turns in the browser
        view cloud.ply -o cloud.html
        # A cloud as a picture
        view cloud.ply -o cloud.png
        # The cloud of a disparity map, with the geometry beside it
        view disparity.pfm -o disparity.html
    """,
    "pnp": """
        # The pose of a board in every image
        pnp camera.yaml photos/ --board chessboard:9x6:25mm -o poses.yaml
        # The poses of AprilTags with a side of 53 mm
        pnp camera.yaml photos/ --tags tag36h11:53mm -o poses.yaml
        # A pose from a table of points and pixels
        pnp camera.yaml --points points.csv -o poses.yaml
    """,
    "track": """
        # The path of tags over a video
        track camera.yaml video.mp4 --tags tag36h11:53mm -o track.csv
        # The path of a board, with a picture of it over time
        track camera.yaml video.mp4 --board chessboard:9x6:25mm -o track.csv --plot track.png
        # Smooth poses that another program estimated
        track poses.csv --fps 30 -o track.csv
    """,
    "smooth": """
        # A smooth trajectory with covariances
        smooth track.tum -o smoothed.tum
        # A smooth time series, with a picture
        smooth positions.csv -o smoothed.csv --plot smoothed.png
        # Errors against a reference, before and after
        smooth slam.tum --evaluate truth.tum -o smoothed.tum
    """,
    "fit": """
        # A formula with starting values
        fit data.csv --model "a*exp(b*x) + c" --start a=2,b=-1,c=0
        # A parabola, with a picture
        fit data.csv --model poly:2 --plot fit.png
        # A circle through points in the columns u and v
        fit points.csv --model circle --x u,v
    """,
    "transform chain": """
        # The pose of the tag in the frame base, over two files
        transform chain frames.yaml rig.yaml --to base --from tag
        # The same with a transform named on the command line
        transform chain rig.yaml base_T_body=pose.txt --to base --from left
        # The result as a 4 x 4 matrix
        transform chain frames.yaml --to base --from tag --as matrix
    """,
    "transform eval": """
        # A product of named transforms
        transform eval "base_T_cam * cam_T_tag" --frames frames.yaml
        # With an inverse
        transform eval "base_T_cam * inv(lidar_T_cam)" --frames frames.yaml
        # The result as a 4 x 4 matrix
        transform eval "inv(base_T_cam)" --frames frames.yaml --as matrix
    """,
    "transform compose": """
        # Two poses multiplied
        transform compose base_T_cam.txt cam_T_tag.txt
        # Poses written as position and rotation vector in degrees
        transform compose "0 0 1 0 0 90" "1 0 0 0 0 0" --form rvec:deg --as matrix
        # Two rotations about axes, as a quaternion
        transform compose "Rz(30deg)" "Ry(-20deg)" --as quat:wxyz
    """,
    "transform invert": """
        # left_T_right from the rig's right_T_left
        transform invert rig.yaml#right_T_left
        # The inverse as a 4 x 4 matrix
        transform invert pose.txt --as matrix
        # All poses of a file, with their covariances
        transform invert poses.yaml -o inverted.yaml
    """,
    "transform convert": """
        # A pose with Euler angles in degrees
        transform convert pose.txt --as euler:ZYX:deg
        # The camera's axes changed from OpenCV's to OpenGL's
        transform convert world_T_cam=pose.txt --axes cam=opencv:opengl --as matrix
        # A trajectory in another format
        transform convert run.tum --trajectory -o run.csv
    """,
    "transform average": """
        # The mean of three estimates of one pose
        transform average a.txt b.txt c.txt -o mean.yaml
        # The same, with less weight for outliers
        transform average poses.yaml --robust
        # One pose from the trajectory of a camera at rest
        transform average still.tum --trajectory --robust
    """,
    "transform check": """
        # Whether the poses of a file are valid
        transform check frames.yaml
        # The nearest valid pose in place of a rounded one
        transform check pose.txt --fix -o fixed.txt
        # The transforms of a rig file
        transform check rig.yaml
    """,
    "transform points": """
        # A point cloud in the frame of the body
        transform points cloud.ply --with rig.yaml#body_T_left -o body.ply
        # A table of points with columns x, y, z
        transform points corners.csv --with frames.yaml#base_T_cam -o base.csv
        # With a pose that is written out
        transform points marks.csv --with "0 0 1.2 0 0 90" --form euler:xyz:deg -o moved.csv
    """,
    "optics": """
        # Field of view and size of a pixel at three distances
        optics camera.yaml --distance 0.5,1,2
        # Depth of field and diffraction from the data sheet of a lens
        optics --f 8 --sensor 1/1.8 --size 2048x1536 --N 2.8 --focus 0.5
        # The focal length that shows 0.5 m at 1.2 m
        optics --solve f --width 0.5 --focus 1.2 --sensor 1/1.8
    """,
    "run": """
        # What would run, and why
        run pipeline.yaml --dry-run
        # The steps that are not up to date
        run pipeline.yaml
        # The same for another folder, with one JSON document for a CI job
        run pipeline.yaml --set photos=monday/photos --json
    """,
    "doctor": """
        # Whether all packages are there and work together
        doctor
        # With the OpenCV packages and the variables that matter
        doctor --verbose
        # As JSON, for a bug report
        doctor --json
    """,
}


def _read(text: str) -> Iterator[Example]:
    lines = dedent(text).split("\n")[1:-1]
    for comment, call in zip(lines[::2], lines[1::2], strict=True):
        yield Example(call, comment.removeprefix("# "))


EXAMPLES: Mapping[str, tuple[Example, ...]] = MappingProxyType(
    {name: tuple(_read(text)) for name, text in _CALLS.items()}
)


def calls(command: str) -> list[str]:
    """Return the most common calls of a command by its full name, such as 'stereo cloud'; none for others."""
    return [f"camcal {example.call}" for example in EXAMPLES.get(command, ())]


def script(command: str) -> list[str]:
    """Return the same as lines of a shell script: each call below a comment that says what it does."""
    return [line for each in EXAMPLES[command] for line in (f"# {each.purpose}", f"camcal {each.call}")]
