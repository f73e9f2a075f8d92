"""Plane-sweep stereo against a room whose depth is known exactly."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

from helpers import box_room
from tf_lab.benchmarks.plane_sweep import (
    PlaneSweepSettings,
    Views,
    checked,
    plane_sweep,
    swept,
)
from tf_lab.errors import TFLabError

SETTINGS = PlaneSweepSettings(planes=64, near=0.5, far=3.5, window=5)
STEP = 0.12  # metres between the cameras of a walk along a wall


def walk(texture: bool = True) -> Views:
    """Seven cameras side by side that look at the box in front of a wall."""
    poses = [box_room.look(np.array([-0.9, STEP * (i - 3), 0.9]), 0.0, -0.25) for i in range(7)]
    images = [box_room.color_image(p, box_room.depth_image(p)) for p in poses]
    grey = torch.from_numpy(np.stack(images)).float().mean(-1) / 255
    if not texture:
        grey = torch.full_like(grey, 0.5)
    K = torch.from_numpy(box_room.intrinsics()).float().expand(7, 3, 3)
    return Views([*range(7)], grey, K, torch.from_numpy(np.stack(poses)).float())


def true_depth(views: Views, i: int) -> torch.Tensor:
    return torch.from_numpy(box_room.depth_image(views.world_T_cam[i].numpy())).float()


def test_depth_is_that_of_the_room() -> None:
    views = walk()
    depth = swept(views, 3, views.sources(3, SETTINGS), SETTINGS)
    found, error = depth > 0, (depth - true_depth(views, 3)).abs()
    assert found.float().mean() > 0.6
    assert (error[found] < 0.1).float().mean() > 0.85  # the rest at edges of the box
    assert error[found].median() < 0.05  # a plane is 16 cm from the next at the wall


def test_without_texture_nothing_is_claimed() -> None:
    views = walk(texture=False)
    depth = swept(views, 3, views.sources(3, SETTINGS), SETTINGS)
    assert not (depth > 0).any()


def test_what_others_contradict_goes() -> None:
    views = walk()
    depths = torch.stack([true_depth(views, i) for i in range(7)])
    wrong = depths.clone()
    wrong[3, 20:40, 30:50] *= 1.3
    kept = checked(wrong, views, 3, SETTINGS)
    assert not (kept[22:38, 32:48] > 0).any()
    rest = torch.ones_like(kept, dtype=torch.bool)
    rest[20:40, 30:50] = False
    assert (checked(depths, views, 3, SETTINGS)[rest] > 0).float().mean() > 0.85
    strict = replace(SETTINGS, agree=7)  # more than there are
    assert not (checked(depths, views, 3, strict) > 0).any()


class Walk:
    """The same as a capture; one frame cannot be read."""

    name = "walk"

    def __init__(self) -> None:
        views = walk()
        self.frames = [str(i) for i in range(7)]
        self.K, self.world_T_cam = views.K.numpy(), views.world_T_cam.double().numpy()
        self.broken: set[int] = {6}

    def image(self, i: int) -> np.ndarray:
        if i in self.broken:
            raise TFLabError(f"{i}.png: damaged")
        pose = self.world_T_cam[i]
        return box_room.color_image(pose, box_room.depth_image(pose))


def test_a_capture_becomes_a_mesh_of_the_room() -> None:
    capture: Any = Walk()
    found = plane_sweep(capture, keyframe_distance=0.0, settings=SETTINGS)
    assert found.keyframes == [0, 1, 2, 3, 4, 5]
    assert found.skipped == ["6: 6.png: damaged"]
    assert len(found.mesh.faces) > 200
    distance = np.abs(box_room.signed_distance(np.asarray(found.mesh.vertices)))
    assert np.quantile(distance, 0.8) < 0.06
    capture.broken = {*range(7)}
    with pytest.raises(TFLabError, match=r"no keyframe can be read; the first: 0: 0\.png: damaged"):
        plane_sweep(capture, keyframe_distance=0.0, settings=SETTINGS)
