"""The most common calls of every command that needs input: for its --help, and for calls without arguments."""

from collections.abc import Mapping
from types import MappingProxyType

EXAMPLES: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "simulate": (
            "simulate chessboard:9x6:25mm -o scene",
            "simulate charuco:9x7:30mm:22mm:DICT_5X5_100 camera.yaml -o scene --views 30",
            "simulate --stereo -o pairs",
        ),
        "board": (
            "board chessboard:9x6:25mm -o target.pdf",
            "board charuco:9x7:30mm:22mm:DICT_5X5_100 -o target.pdf --paper A4",
            "board aprilgrid:6x6:88mm:0.3 -o target.pdf --kalibr kalibr.yaml",
        ),
        "detect": (
            "detect photos/ --board chessboard:9x6:25mm -o detections.csv",
            "detect video.mp4 --board charuco:9x7:30mm:22mm:DICT_5X5_100 -o detections.csv",
            "detect photos/ --board target.yaml -o detections.csv --draw drawn",
        ),
        "calibrate": (
            "calibrate photos/ --board chessboard:9x6:25mm -o camera.yaml",
            "calibrate video.mp4 --board target.yaml -o camera.yaml",
            "calibrate detections.csv --model fisheye -o camera.yaml",
        ),
        "rig": (
            "rig left=photos/left right=photos/right --board chessboard:9x6:25mm -o rig.yaml",
            "rig photos/ --board target.yaml -o rig.yaml",
            "rig a=a.mp4 b=b.mp4 c=c.mp4 --board target.yaml -o rig.yaml",
        ),
        "undistort": (
            "undistort camera.yaml photos/ -o undistorted",
            "undistort fisheye.yaml photos/ -o wide --projection cylinder",
            "undistort camera.yaml --points pixels.csv -o straight.csv",
        ),
        "convert": (
            "convert camera.yaml opencv.xml",
            "convert camera.yaml ros.yaml --to ros",
            "convert camchain.yaml rig.yaml",
        ),
        "inspect": (
            "inspect camera.yaml",
            "inspect camera.yaml --get cameras.camera.quality.rms_px",
            "inspect IMG_0001.DNG",
        ),
        "demosaic": (
            "demosaic IMG_0001.DNG -o IMG_0001.tiff --wb camera --tone srgb",
            "demosaic raw/ -o developed --wb camera",
            "demosaic frame.raw -o frame.tiff --format BayerRG12p --size 1920x1200",
        ),
        "sensor": (
            "sensor flats/ --dark darks/ -o sensor.yaml --plot photon_transfer.png",
            "sensor flats/ --dark darks/ --pattern RGGB --white 4095 -o sensor.yaml",
            "sensor dim/ bright/ --dark night/ --exposure 0.005,0.02 -o sensor.yaml",
        ),
        "stereo calibrate": (
            "stereo calibrate left/ right/ --board chessboard:9x6:25mm -o rig.yaml",
            "stereo calibrate 'left*.png' 'right*.png' --board target.yaml -o rig.yaml",
            "stereo calibrate left/ right/ --board a.yaml --lenses fixed --guess lens.yaml -o rig.yaml",
        ),
        "stereo run": (
            "stereo run rig.yaml left/ right/ -o result",
            "stereo run left/ right/ --board chessboard:9x6:25mm -o result",
            "stereo run left/ right/ --board target.yaml --scene left.mp4 right.mp4 -o result",
        ),
        "stereo check": (
            "stereo check left.png right.png",
            "stereo check left.png right.png -o check.png",
            "stereo check left/ right/ --max-rms 0.5",
        ),
        "stereo rectify": (
            "stereo rectify rig.yaml left/ right/ -o rectified",
            "stereo rectify rig.yaml left.mp4 right.mp4 -o rectified --scale 0.5",
            "stereo rectify rig.yaml -o maps --maps --opencv --projection pinhole",
        ),
        "stereo disparity": (
            "stereo disparity left.png right.png rig.yaml -o disparity.pfm",
            "stereo disparity left/ right/ rig.yaml -o maps --vis",
            "stereo disparity left.png right.png -o disparity.tiff --range 0:128",
        ),
        "stereo cloud": (
            "stereo cloud disparity.pfm -o cloud.ply",
            "stereo cloud disparity.png left.png rig.yaml -o cloud.ply --max-depth 40",
            "stereo cloud left.png right.png rig.yaml -o cloud.ply --sigma",
        ),
        "stereo eval": (
            "stereo eval disparity.pfm truth.pfm",
            "stereo eval disparity.pfm truth.pfm calib.txt --mask visible.png",
            "stereo eval maps/ truths/ --gate bad2=5",
        ),
        "view": (
            "view cloud.ply -o cloud.html",
            "view cloud.ply -o cloud.png",
            "view disparity.pfm -o disparity.html",
        ),
        "pnp": (
            "pnp camera.yaml photos/ --board chessboard:9x6:25mm -o poses.yaml",
            "pnp camera.yaml photos/ --tags tag36h11:53mm -o poses.yaml",
            "pnp camera.yaml --points points.csv -o poses.yaml",
        ),
        "track": (
            "track camera.yaml video.mp4 --tags tag36h11:53mm -o track.csv",
            "track camera.yaml video.mp4 --board chessboard:9x6:25mm -o track.csv --plot track.png",
            "track poses.csv --fps 30 -o track.csv",
        ),
        "smooth": (
            "smooth track.tum -o smoothed.tum",
            "smooth positions.csv -o smoothed.csv --plot smoothed.png",
            "smooth slam.tum --evaluate truth.tum -o smoothed.tum",
        ),
        "fit": (
            'fit data.csv --model "a*exp(b*x) + c" --start a=2,b=-1,c=0',
            "fit data.csv --model poly:2 --plot fit.png",
            "fit points.csv --model circle --x u,v",
        ),
        "transform chain": (
            "transform chain frames.yaml rig.yaml --to base --from tag",
            "transform chain rig.yaml base_T_body=pose.txt --to base --from left",
            "transform chain frames.yaml --to base --from tag --as matrix",
        ),
        "transform eval": (
            'transform eval "base_T_cam * cam_T_tag" --frames frames.yaml',
            'transform eval "base_T_cam * inv(lidar_T_cam)" --frames frames.yaml',
            'transform eval "inv(base_T_cam)" --frames frames.yaml --as matrix',
        ),
        "transform compose": (
            "transform compose base_T_cam.txt cam_T_tag.txt",
            'transform compose "0 0 1 0 0 90" "1 0 0 0 0 0" --form rvec:deg --as matrix',
            'transform compose "Rz(30deg)" "Ry(-20deg)" --as quat:wxyz',
        ),
        "transform invert": (
            "transform invert rig.yaml#right_T_left",
            "transform invert pose.txt --as matrix",
            "transform invert poses.yaml -o inverted.yaml",
        ),
        "transform convert": (
            "transform convert pose.txt --as euler:ZYX:deg",
            "transform convert world_T_cam=pose.txt --axes cam=opencv:opengl --as matrix",
            "transform convert run.tum --trajectory -o run.csv",
        ),
        "transform average": (
            "transform average a.txt b.txt c.txt -o mean.yaml",
            "transform average poses.yaml --robust",
            "transform average still.tum --trajectory --robust",
        ),
        "transform check": (
            "transform check frames.yaml",
            "transform check pose.txt --fix -o fixed.txt",
            "transform check rig.yaml",
        ),
        "transform points": (
            "transform points cloud.ply --with rig.yaml#body_T_left -o body.ply",
            "transform points corners.csv --with frames.yaml#base_T_cam -o base.csv",
            'transform points marks.csv --with "0 0 1.2 0 0 90" --form euler:xyz:deg -o moved.csv',
        ),
        "optics": (
            "optics camera.yaml --distance 0.5,1,2",
            "optics --f 8 --sensor 1/1.8 --size 2048x1536 --N 2.8 --focus 0.5",
            "optics --solve f --width 0.5 --focus 1.2 --sensor 1/1.8",
        ),
    }
)


def lines(command: str) -> list[str]:
    """Return the most common calls of a command by its full name, such as 'stereo cloud'; none for others."""
    return [f"camcal {example}" for example in EXAMPLES.get(command, ())]
