"""Cameras made wrong: by as much as is asked for, and only in training's copies."""

from dataclasses import replace

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from tf_lab.data.camera_noise import disturb_cameras
from tf_lab.data.settings import CameraNoise

NOISE = CameraNoise(translation=0.01, rotation=0.5, focal=0.02)
VIEWS = 12


def cameras() -> tuple[torch.Tensor, torch.Tensor]:
    rng = np.random.default_rng(1)
    K = torch.tensor([[120.0, 0, 79.5], [0, 121, 59.5], [0, 0, 1]]).repeat(VIEWS, 1, 1)
    poses = np.tile(np.eye(4, dtype=np.float32), (VIEWS, 1, 1))
    poses[:, :3, :3] = Rotation.random(VIEWS, rng=rng).as_matrix()
    poses[:, :3, 3] = rng.normal(size=(VIEWS, 3))
    return K, torch.from_numpy(poses)


def errors(noise: CameraNoise, chunks: int = 400) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of every chunk: shifts [C, V, 3] (m), turns [C, V, 3] (degrees), log focal lengths [C]."""
    rng, (K, poses) = np.random.default_rng(0), cameras()
    shifts, turns, focals = [], [], []
    for _ in range(chunks):
        K2, poses2 = disturb_cameras(K, poses, noise, rng)
        turned = (poses[:, :3, :3].mT @ poses2[:, :3, :3]).double().numpy()
        turns.append(np.degrees(Rotation.from_matrix(turned).as_rotvec()))
        shifts.append((poses2 - poses)[:, :3, 3].numpy())
        ratio = (K2 / K)[:, [0, 1], [0, 1]]
        assert torch.allclose(ratio, ratio[0, 0], rtol=1e-5), "one focal length a chunk"
        assert torch.equal(K2[:, :2, 2], K[:, :2, 2])
        focals.append(float(ratio[0, 0].log()))
    return np.array(shifts), np.array(turns), np.array(focals)


def test_deviations_are_what_is_asked_for() -> None:
    """A share uniform in 0..1 of a deviation d: the mean square is d^2 / 3."""
    shifts, turns, focals = errors(NOISE)
    assert np.isclose(np.sqrt(3 * (shifts**2).mean()), 0.01, rtol=0.1)
    assert np.isclose(np.sqrt(3 * (turns**2).mean()), 0.5, rtol=0.1)
    assert np.isclose(np.sqrt(3 * (focals**2).mean()), 0.02, rtol=0.2)
    assert abs(shifts.mean()) < 5e-4 and abs(turns.mean()) < 0.02


def test_chunks_differ_in_how_wrong_they_are() -> None:
    """Some are nearly right; within one, views err independently."""
    shifts, _, _ = errors(NOISE)
    size = np.sqrt((shifts**2).mean(axis=(1, 2)))
    assert np.quantile(size, 0.1) < 0.002 and np.quantile(size, 0.9) > 0.007
    scaled = shifts / size[:, None, None]
    assert abs((scaled[:, 0] * scaled[:, 1]).mean()) < 0.1


def test_each_error_by_itself() -> None:
    K, poses = cameras()
    rng = np.random.default_rng(0)
    K2, poses2 = disturb_cameras(K, poses, replace(CameraNoise(), focal=0.05), rng)
    assert torch.allclose(poses2, poses, atol=1e-6) and not torch.allclose(K2, K)
    before = K.clone(), poses.clone()
    K2, poses2 = disturb_cameras(K, poses, replace(CameraNoise(), rotation=1.0), rng)
    assert torch.equal(K2, K) and torch.equal(poses2[:, :3, 3], poses[:, :3, 3])
    assert not torch.allclose(poses2, poses)
    assert torch.equal(K, before[0]) and torch.equal(poses, before[1]), "the scene's stay"
