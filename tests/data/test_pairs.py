"""Pairs of the analytic room: the pixels said to correspond show the same point of its walls."""

import itertools
import shutil
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor
from torch.utils.data import DataLoader

from helpers import box_room
from tf_lab.data.pairs import PairBatch, PairSettings, PairStream
from tf_lab.data.scene import Scene
from tf_lab.data.settings import PhotometricSettings
from tf_lab.errors import TFLabError

Pair = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
SETTINGS = PairSettings(pairs=4, points=24, epipolar=5)


def batches(box_scene: Path, count: int, seed: int = 0, first_step: int = 0) -> list[PairBatch]:
    stream = PairStream([box_scene], SETTINGS, seed, first_step)
    return list(itertools.islice(stream, count))


def same(a: PairBatch, b: PairBatch) -> bool:
    return all(torch.equal(x, y) for x, y in zip(vars(a).values(), vars(b).values(), strict=True))


def frames_of(images: Tensor, scene: Scene) -> list[int]:
    """Which frames the images [2, 3, H, W] are."""
    known = [torch.tensor(scene.image(i)).permute(2, 0, 1) for i in range(len(scene))]
    return [next(i for i, k in enumerate(known) if torch.equal(k, image)) for image in images]


@pytest.fixture(scope="module")
def pairs(box_scene: Path) -> list[Pair]:
    """Of two batches: pose a, pose b, uv_a [P, 2], uv_b [P, 1 + E, 2]; poses by the room's list."""
    scene, poses = Scene(box_scene), box_room.poses()
    found = []
    for batch in batches(box_scene, 2):
        for images, uv_a, uv_b in zip(batch.images, batch.uv_a, batch.uv_b, strict=True):
            a, b = frames_of(images, scene)
            found.append((poses[a], poses[b], uv_a.double().numpy(), uv_b.double().numpy()))
    return found


def homogeneous(uv: np.ndarray) -> np.ndarray:
    return np.concatenate([uv, np.ones((*uv.shape[:-1], 1))], axis=-1)


def points_of(pose: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """World points [P, 3] of whole pixels [P, 2], by the exact depth of the room."""
    u, v = uv.round().astype(int).T
    np.testing.assert_array_equal(uv, np.stack([u, v], -1))
    rays = homogeneous(uv) @ np.linalg.inv(box_room.intrinsics()).T
    return rays * box_room.depth_image(pose)[v, u, None] @ pose[:3, :3].T + pose[:3, 3]


def test_shapes(box_scene: Path) -> None:
    (batch,) = batches(box_scene, 1)
    width, height = box_room.SIZE
    assert batch.images.shape == (4, 2, 3, height, width)
    assert batch.images.dtype == torch.uint8
    assert batch.uv_a.shape == (4, 24, 2)
    assert batch.uv_b.shape == (4, 24, 6, 2)


def test_pixels_correspond(
    pairs: list[Pair],
) -> None:
    for pose_a, pose_b, uv_a, uv_b in pairs:
        camera = (points_of(pose_a, uv_a) - pose_b[:3, 3]) @ pose_b[:3, :3]
        pixels = camera @ box_room.intrinsics().T
        # the depth map is rounded to millimetres: some hundredths of a pixel
        np.testing.assert_allclose(pixels[:, :2] / pixels[:, 2:], uv_b[:, 0], atol=0.1)
        assert (camera[:, 2] > 0).all()
        assert ((uv_b[:, 0] >= -0.5) & (uv_b[:, 0] < np.array(box_room.SIZE) - 0.5)).all()


def test_nothing_stands_between_the_second_camera_and_the_point(
    pairs: list[Pair],
) -> None:
    """By the signed distance along the line of sight; a rounded pixel may graze an edge."""
    hidden_somewhere = False
    for pose_a, pose_b, uv_a, _ in pairs:
        for point in points_of(pose_a, uv_a):
            way = np.linspace(pose_b[:3, 3], point, 60)[:50]
            assert box_room.signed_distance(way).min() > -0.05
        # the test would see occlusion: other points of frame a are hidden from frame b
        everywhere = np.stack(np.meshgrid(np.arange(80), np.arange(60)), -1).reshape(-1, 2)
        for point in points_of(pose_a, everywhere.astype(float))[::97]:
            way = np.linspace(pose_b[:3, 3], point, 60)[:50]
            hidden_somewhere |= bool(box_room.signed_distance(way).min() < -0.05)
    assert hidden_somewhere


def test_cameras_are_apart(
    pairs: list[Pair],
) -> None:
    for pose_a, pose_b, _, _ in pairs:
        assert np.linalg.norm(pose_a[:3, 3] - pose_b[:3, 3]) >= SETTINGS.baseline


def test_wrong_candidates_lie_on_the_epipolar_line_and_apart_from_the_truth(
    pairs: list[Pair],
) -> None:
    K_inverse = np.linalg.inv(box_room.intrinsics())
    checked = 0
    for pose_a, pose_b, uv_a, uv_b in pairs:
        b_T_a = np.linalg.inv(pose_b) @ pose_a
        x, y, z = b_T_a[:3, 3]
        cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        fundamental = K_inverse.T @ cross @ b_T_a[:3, :3] @ K_inverse
        lines = homogeneous(uv_a) @ fundamental.T  # [P, 3], in image b
        lines /= np.linalg.norm(lines[:, :2], axis=1, keepdims=True)
        distance = np.abs(np.einsum("pec,pc->pe", homogeneous(uv_b), lines))
        near = (np.abs(uv_b) < 200).all(-1)  # farther out, float32 pixels are coarse
        assert distance[near].max() < 0.02
        # other depths along the ray: by 8 % at least, so never the truth itself
        moved = np.linalg.norm(uv_b[:, 1:] - uv_b[:, :1], axis=-1)
        assert (moved > 1e-3).all()
        checked += int((near[:, 1:] & (moved > 3)).sum())
    assert checked > 100


def test_a_batch_is_a_function_of_seed_and_step_alone(box_scene: Path) -> None:
    first, second, third = batches(box_scene, 3)
    assert same(batches(box_scene, 1, first_step=2)[0], third)
    assert not same(first, second)
    assert not same(batches(box_scene, 1, seed=1)[0], first)


def test_augmentation_changes_images_alone_and_each_by_itself(box_scene: Path) -> None:
    """A point keeps its pixels; a pair's two images change by different draws."""
    exposure = PhotometricSettings(exposure=1.0)
    plain = PairStream([box_scene], PairSettings(1, 24, 5), 0)
    augmented = PairStream([box_scene], PairSettings(1, 24, 5), 0, augment=exposure)
    differ = []
    for step in range(6):
        a, b = (s.batch(np.random.default_rng([0, step])) for s in (plain, augmented))
        assert torch.equal(a.uv_a, b.uv_a)
        assert torch.equal(a.uv_b[:, :, 0], b.uv_b[:, :, 0])
        light = [((x.images / 255) ** 2.2).mean((0, 2, 3, 4)) for x in (a, b)]
        stops = (light[1] / light[0]).log2()
        assert stops.abs().max() < 1.05
        differ.append(float((stops[0] - stops[1]).abs()))
    assert sum(d > 0.1 for d in differ) >= 4


def test_jitter_moves_the_true_pixel_alone(box_scene: Path) -> None:
    exact, moved = (
        next(iter(PairStream([box_scene], PairSettings(4, 24, 5, jitter=jitter), 0)))
        for jitter in (0.0, 0.7)
    )
    assert torch.equal(exact.uv_a, moved.uv_a)
    off = moved.uv_b[:, :, 0] - exact.uv_b[:, :, 0]  # 4 x 24 points, 2 coordinates
    assert float(off.std()) == pytest.approx(0.7, rel=0.2)
    assert float(off.mean().abs()) < 0.2
    assert torch.equal(exact.uv_b[:, :, 1:], moved.uv_b[:, :, 1:])


def test_worker_processes_give_the_same_batches(box_scene: Path) -> None:
    loader = DataLoader(PairStream([box_scene], SETTINGS, 0), batch_size=None, num_workers=2)
    for a, b in zip(batches(box_scene, 3), loader, strict=False):
        assert same(a, b)


def test_no_scene_and_no_overlap_are_told(box_scene: Path) -> None:
    with pytest.raises(TFLabError, match="no scene to pre-train on"):
        PairStream([], SETTINGS, 0)
    stream = PairStream([box_scene], PairSettings(pairs=1, points=24, overlap=1.1), 0)
    with pytest.raises(TFLabError, match="do not overlap enough"):
        next(iter(stream))


def test_a_scene_without_depth_is_named(box_scene: Path, tmp_path: Path) -> None:
    bare = tmp_path / "bare"
    shutil.copytree(box_scene, bare)
    shutil.rmtree(bare / "depth")
    with pytest.raises(TFLabError, match=r"bare: pre-training needs depth"):
        next(iter(PairStream([bare], SETTINGS, 0)))
