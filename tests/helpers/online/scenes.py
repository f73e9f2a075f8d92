"""What the tests of reconstruction share: a room, few frames, networks that say yes and no."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
import trimesh
from scipy.spatial import cKDTree
from torch import Tensor

from helpers import box_room
from helpers.online.dense import DenseReconstructor, Volumes, frustum_grid
from tf_lab.data.scene import Scene
from tf_lab.geometry import COARSE, FINE, VoxelGrid
from tf_lab.online.lattice.blocks import offsets
from tf_lab.online.lattice.level import Level
from tf_lab.online.reconstructor import Reconstructor
from tf_lab.online.settings import ReconstructionSettings
from tf_lab.online.state import fingerprint

Factory = Callable[..., Any]  # a Network; to mypy its parts are Tensor | Module

FRAMES = (2, 6, 9, 13, 16, 5)
NEAR, FAR = 0.3, 1.8


def settings_of(**settings: Any) -> ReconstructionSettings:
    return ReconstructionSettings(**{"resolution": 0.05, "logits": "float32", **settings})


def add(r: Any, scene: Scene, frames: Sequence[int] = FRAMES) -> Any:
    for i in frames:
        r.add_frame(scene.image(i), scene.K[i], scene.world_T_cam[i])
    return r


def reconstruct(
    network: Any,
    scene: Scene,
    frames: Sequence[int] = FRAMES,
    **settings: Any,
) -> Reconstructor:
    return add(Reconstructor(network, settings_of(**settings)), scene, frames)


def dense_grid(scene: Scene, far: float = FAR) -> VoxelGrid:
    some = list(FRAMES)
    return frustum_grid(scene.K[some], scene.world_T_cam[some], scene.size, far)


def dense(
    network: Any,
    scene: Scene,
    **settings: Any,
) -> DenseReconstructor:
    return add(DenseReconstructor(network, dense_grid(scene), settings_of(**settings)), scene)


def trained_to_match(network: Any) -> Any:
    """As if trained with ``inputs=stereo``: what is zero at first is not."""
    for module in (*network.agreement.values(), *network.stereo_evidence.values()):
        torch.nn.init.normal_(module.linear.weight)
    return network


def balanced(network: Any, scene: Scene) -> Any:
    """Shift the heads so that each says yes about half of the time; random ones may never."""
    refinement = network.refinement
    heads = (refinement.coarse_mask[-1], refinement.fine_mask[-1], network.occupancy.output)
    known = (fingerprint(network), scene.directory)
    if known not in _BALANCED:
        _balance(network, heads, scene)
        _BALANCED[known] = [head.bias.detach().clone() for head in heads]
    with torch.no_grad():
        for head, bias in zip(heads, _BALANCED[known], strict=True):
            head.bias.copy_(bias)
    return network


_BALANCED: dict[tuple[str, Path], list[Tensor]] = {}  # the heads' biases by network and scene


def _balance(network: Any, heads: Sequence[Any], scene: Scene) -> None:
    grid = VoxelGrid.covering(box_room.ROOM[0], box_room.ROOM[1], COARSE)
    for head in heads:
        said: list[Tensor] = []
        handle = head.register_forward_hook(lambda _m, _i, out, said=said: said.append(out))
        settings = settings_of(resolution=0.1)
        add(DenseReconstructor(network, grid, settings), scene).mesh()
        handle.remove()
        with torch.no_grad():  # voxels without features all say the same: count them once
            head.bias.sub_(torch.cat([out.flatten() for out in said]).unique().median().item())


def on_grid(level: Level, values: Tensor, grid: VoxelGrid) -> Tensor:
    """Values by row as a dense volume [X, Y, Z, ...], zero where there is no voxel."""
    low = torch.tensor([round(o / grid.voxel) for o in grid.origin])
    every = torch.ones(grid.shape).nonzero() + low
    rows = level.blocks.row_of(every)
    found = values.new_zeros(len(rows), *values.shape[1:])
    found[rows >= 0] = values[rows[rows >= 0]]
    return found.view(*grid.shape, *values.shape[1:])


def volumes_of(r: Reconstructor, scene: Scene) -> Volumes:
    """What the reconstructor knows, as dense volumes."""
    r.update()
    grid = dense_grid(scene, r.network.config.far)
    fine_grid = grid.refined(3)
    coarse = on_grid(r.coarse, r.coarse.features["refined"], grid).permute(3, 0, 1, 2)
    fine = on_grid(r.fine, r.fine.features["refined"], fine_grid).permute(3, 0, 1, 2)
    shown = on_grid(r.fine, r.fine.features["shown"], fine_grid)
    assert shown.sum() == r.fine.features["shown"].sum()
    return Volumes(coarse, grid, fine, fine_grid, shown)


def clearance(points: np.ndarray, scene: Scene, frame: int, far: float = FAR) -> np.ndarray:
    """How clearly a frame sees points [P, 3]: positive if it does (metres or tenths of a pixel)."""
    pose, K = scene.world_T_cam[frame], scene.K[frame]
    camera = (points - pose[:3, 3]) @ pose[:3, :3]
    z = camera[:, 2]
    with np.errstate(divide="ignore"):
        u, v = K[0, 0] * camera[:, 0] / z + K[0, 2], K[1, 1] * camera[:, 1] / z + K[1, 2]
    pixels = np.minimum.reduce([u + 0.5, scene.size[0] - 0.5 - u, v + 0.5, scene.size[1] - 0.5 - v])
    return np.minimum.reduce([np.where(z > 0, pixels, -1) / 10, z - NEAR, far - z])


def assert_same_surface(a: trimesh.Trimesh, b: trimesh.Trimesh, tolerance: float = 1e-4) -> None:
    """The same vertices and faces, in whatever order."""
    assert len(a.faces) > 100
    assert len(a.vertices) == len(b.vertices)
    assert len(a.faces) == len(b.faces)
    distance, partner = cKDTree(b.vertices).query(a.vertices)
    assert distance.max() < tolerance
    assert len(np.unique(partner)) == len(partner)
    faces = [np.sort(f, 1)[np.lexsort(np.sort(f, 1).T)] for f in (partner[a.faces], b.faces)]
    np.testing.assert_array_equal(*faces)


def assert_close_surface(a: trimesh.Trimesh, b: trimesh.Trimesh, tolerance: float = 1e-4) -> None:
    """The same surface up to a sample in a thousand, whose logit is 0 but for rounding."""
    assert len(a.faces) > 100
    assert abs(len(a.faces) - len(b.faces)) <= len(b.faces) / 1000
    for one, other in ((a, b), (b, a)):
        distance, _ = cKDTree(other.vertices).query(one.vertices)
        assert np.mean(distance < tolerance) > 0.999


def surface_of(
    decode: Callable[[Tensor], Tensor], active: Tensor, grid: VoxelGrid, network: Any, n: int
) -> Reconstructor:
    """A reconstructor that believes in a known field: logits at points [P, 3], active voxels."""
    r = Reconstructor(network, ReconstructionSettings(resolution=FINE / n))
    voxels = active.nonzero() + torch.tensor([round(o / FINE) for o in grid.origin])
    r.fine.allocate(r.fine.blocks.block_of(voxels))
    rows = r.fine.blocks.row_of(voxels)
    samples = ((offsets(n, rows.device) + 0.5) / n - 0.5) * FINE
    points = (r.fine.points(rows)[:, None] + samples).reshape(-1, 3)
    values = torch.cat([decode(p) for p in points.split(1 << 18)])
    r.fine.features["values"][rows] = values.view(len(rows), -1).float()
    r.fine.features["shown"][rows] = True
    r.surface.touch(torch.arange(len(r.fine.blocks)))
    r.surface.update(None)
    return r
