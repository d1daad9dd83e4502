"""Images of a cube with a board on each face, from the scenes of body_scenes.py."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from body_scenes import SIZE, BodyScene

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.geometry.pose import Pose
from camcal.simulate.render import Exposure, develop, evenly_lit, light
from camcal.targets.board import Board

MODEL = model_named("opencv5")


def tagged_faces(count: int) -> dict[str, Board]:
    """Return AprilGrids of 3 x 3 tags each, without a tag in common."""
    tags = Board("aprilgrid", 3, 3, 0.0805, 0.07, "tag36h11")
    return {f"f{face}": replace(tags, first_marker=9 * face) for face in range(count)}


def picture(scene: BodyScene, name: str, moment: int, folder: Path) -> int:
    """Write the image of a camera at a moment; return how many faces it shows."""
    matrix, coefficients = scene.lenses[name]
    lens = Camera(MODEL, SIZE, [matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2], *coefficients])
    exposure, rng = Exposure(), np.random.default_rng([moment, int(name[1:]), 9])
    image, count = np.full(SIZE[::-1], exposure.background), 0
    for face, board in scene.boards.items():
        pose = scene.pose_of(name, face, moment)
        # the faces of a cube that are seen do not hide each other: each is drawn where its paper is
        corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * 0.56 * np.array(board.extent)
        paper = np.column_stack([corners + np.array(board.extent) / 2, np.zeros(4)])
        middle = (pose[:3, :3] @ paper.mean(axis=0)) + pose[:3, 3]
        if board.z_sign * pose[:3, 2] @ middle < 0.1 * np.linalg.norm(middle):
            continue
        outline = cv2.projectPoints(paper, pose[:3, :3], pose[:3, 3], matrix, coefficients)[0].reshape(-1, 2)
        inside = ((outline > 0) & (outline < np.array(SIZE) - 1)).all()
        drawn = evenly_lit(lens, board, Pose(pose[:3, :3], pose[:3, 3]), exposure)
        mask = cv2.fillConvexPoly(np.zeros(SIZE[::-1], np.uint8), np.round(outline).astype(np.int32), 1)
        image = np.where(mask > 0, drawn, image)
        count += int(inside)
    (folder / name).mkdir(exist_ok=True)
    taken = develop(image * light(SIZE, exposure, rng.uniform(0, 2 * np.pi)), exposure, rng)
    cv2.imwrite(str(folder / name / f"{moment:03d}.png"), taken)
    return count
