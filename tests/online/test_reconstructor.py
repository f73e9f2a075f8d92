"""Lazy, sparse reconstruction against references, and the independence it promises."""

import gc
import weakref
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import trimesh
from torch import Tensor

from helpers import box_room
from helpers.online.dense import DenseReconstructor, embed
from helpers.online.scenes import (
    FAR,
    FRAMES,
    Factory,
    assert_close_surface,
    assert_same_surface,
    balanced,
    clearance,
    dense,
    dense_grid,
    on_grid,
    reconstruct,
    settings_of,
    trained_to_match,
    volumes_of,
)
from tf_lab.data.keyframes import select_keyframes
from tf_lab.data.scene import Scene
from tf_lab.errors import TFLabError
from tf_lab.geometry import VoxelGrid
from tf_lab.network.chunks import Views
from tf_lab.network.network import Network
from tf_lab.network.refinement import ResidualBlock3d
from tf_lab.online import reconstruction
from tf_lab.online.decode import Decoder
from tf_lab.online.lattice import sparse
from tf_lab.online.lattice.level import Level
from tf_lab.online.reconstructor import Reconstructor
from tf_lab.online.settings import ReconstructionSettings
from tf_lab.online.views.selection import (
    AttentionSelection,
    RandomSelection,
)
from tf_lab.stereo.depth import DepthSequence


def clear_points(grid: VoxelGrid, scene: Scene, count: int) -> np.ndarray:
    """Indices [n, 3] of random voxels that no frame sees by a rounding error only."""
    every = np.argwhere(np.ones(grid.shape))
    points = np.array(grid.origin) + (every + 0.5) * grid.voxel
    clear = np.stack([clearance(points, scene, f) for f in FRAMES])
    usable = (np.abs(clear).min(0) > 1e-4) & ((clear.max(0) > 0) | (np.arange(len(every)) % 9 == 0))
    return np.random.default_rng(0).permutation(every[usable])[:count]


def test_a_mesh_is_painted_by_images_with_their_own_cameras(
    tiny_network: Factory, scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    given: list[Any] = []
    K = scene.K.copy()
    K[:, 0, 0] += np.arange(len(K))  # each camera another
    monkeypatch.setattr(scene, "K", K)
    monkeypatch.setattr("tf_lab.online.reconstructor.painters", lambda held, count: [1, 3])
    monkeypatch.setattr(
        "tf_lab.online.reconstructor.color_vertices", lambda mesh, *views: given.extend(views)
    )
    reconstruct(balanced(tiny_network(), scene), scene).mesh()
    images, K, world_T_cam = given
    for row, i in enumerate([FRAMES[1], FRAMES[3]]):
        assert np.array_equal(images[row].permute(1, 2, 0), scene.image(i))
        np.testing.assert_allclose(K[row], scene.K[i], rtol=1e-6)
        np.testing.assert_allclose(world_T_cam[row], scene.world_T_cam[i], atol=1e-6)


def test_keyframes_are_as_far_apart_as_told(tiny_network: Factory, scene: Scene) -> None:
    """The cameras of the room are farther apart than the default."""
    network = tiny_network()
    for distance in (0.1, 1.5):
        settings = ReconstructionSettings(keyframe_distance=distance)
        found = reconstruction.reconstruct(network, scene, settings, color=False)
        assert found.keyframes == select_keyframes(scene.world_T_cam, distance)
    assert len(found.keyframes) < len(scene)


def test_a_reconstruction_is_freed_when_nobody_holds_it(
    tiny_network: Factory, scene: Scene
) -> None:
    """At once: the cycles that Python looks for now and then would keep a GPU's memory."""
    gc.collect()
    gc.disable()
    try:
        r = reconstruct(balanced(tiny_network(), scene), scene, views=3)
        gone = weakref.ref(r)
        assert len(r.mesh().faces)
        del r
        assert gone() is None
    finally:
        gc.enable()


def fuse_by_hand(
    network: Any, level: str, scene: Scene, point: np.ndarray, views: int
) -> Tensor | None:
    """Fused feature [D] of a point, frame by frame; None if no frame sees it."""
    kept: list[tuple[Tensor, Tensor]] = []
    for frame in FRAMES:
        if clearance(point[None], scene, frame)[0] < 0:
            continue
        image = torch.from_numpy(scene.image(frame)).permute(2, 0, 1)[None]
        k = torch.from_numpy(scene.K[frame]).float()
        pose = torch.from_numpy(scene.world_T_cam[frame]).float()
        maps = {name: m[0] for name, m in network.encode(image).items()}
        p = torch.from_numpy(point).float()[None]
        token = embed(network, level, maps, p, k, pose, scene.size)[0, 0]
        if len(kept) == views:
            logits = torch.stack([logit for _, logit in kept])
            weights = (logits.exp() / logits.exp().sum(0)).mean(1)
            kept.pop(int(weights.argmin()))
        kept.append((token, network.fusion[level].selection_logits(token[None])[0]))
    if not kept:
        return None
    return network.fuse(level, torch.stack([token for token, _ in kept]), None)[0]


@pytest.mark.parametrize(("fusion", "views"), [("transformer", 3), ("transformer", 16), ("gru", 3)])
@torch.inference_mode()
def test_lazy_fusion_equals_fusing_voxel_by_voxel(
    tiny_network: Factory, scene: Scene, fusion: str, views: int
) -> None:
    """Without 3D convolutions a refined voxel is a linear function of its own fused features.

    The list written out keeps the order of time, which a strategy that minds it gets.
    """
    network = balanced(tiny_network(refine=False, fusion=fusion), scene)
    r = reconstruct(network, scene, views=views, batch=100)
    volumes = volumes_of(r, scene)
    grid, fine_grid = volumes.coarse_grid, volumes.fine_grid
    heads = network.refinement.coarse_mask, network.refinement.fine_mask
    weight, bias = network.refinement.merge.weight[:, :, 0, 0, 0], network.refinement.merge.bias
    width = network.config.width

    def coarse_at(point: np.ndarray) -> tuple[Tensor, bool]:
        psi = fuse_by_hand(network, "coarse", scene, point, views)
        if psi is None:
            return torch.zeros(width), False
        return psi, heads[0](psi.view(1, -1, 1, 1, 1)).sigmoid().item() > 0.5

    for i, j, k in clear_points(grid, scene, 40):
        point = np.array(grid.origin) + (np.array([i, j, k]) + 0.5) * 0.3
        psi, _ = coarse_at(point)
        torch.testing.assert_close(volumes.coarse[:, i, j, k], psi, atol=1e-4, rtol=1e-4)

    active = 0
    for x, y, z in clear_points(fine_grid, scene, 60):
        index = np.array([x, y, z])
        point = np.array(fine_grid.origin) + (index + 0.5) * 0.1
        parent = np.array(grid.origin) + (index // 3 + 0.5) * 0.3
        if np.min([np.abs(clearance(parent[None], scene, f)) for f in FRAMES]) < 1e-4:
            continue
        coarse, near = coarse_at(parent)
        fine = fuse_by_hand(network, "fine", scene, point, views)
        if not near or fine is None:
            assert not volumes.active[x, y, z]
            continue
        merged = weight @ torch.cat([coarse, fine]) + bias
        torch.testing.assert_close(volumes.fine[:, x, y, z], merged, atol=1e-4, rtol=1e-4)
        logit = heads[1](merged.view(1, -1, 1, 1, 1)).item()
        if abs(logit) > 1e-3:
            assert volumes.active[x, y, z] == (logit > 0)
        active += 1
    assert active > 15


def test_with_enough_slots_a_voxel_keeps_exactly_the_frames_that_see_it(
    tiny_network: Factory, scene: Scene
) -> None:
    grid = dense_grid(scene)
    points = grid.centers().double().numpy().reshape(-1, 3)
    margin = np.stack([clearance(points, scene, f) for f in FRAMES], 1)
    for select in ({"select": "attention"}, {"select": "random"}):
        r = reconstruct(tiny_network(), scene, **select, views=len(FRAMES))
        held = np.zeros(margin.shape, bool)
        frames = on_grid(r.coarse, r.coarse.store.frames + 1, grid).flatten(0, 2) - 1
        for voxel, some in enumerate(frames.tolist()):
            assert len({f for f in some if f >= 0}) == sum(f >= 0 for f in some)
            held[voxel, [f for f in some if f >= 0]] = True
        clear = np.abs(margin) > 1e-4
        assert clear.mean() > 0.99
        assert (held == (margin > 0))[clear].all()
        assert 0.02 < held.mean() < 0.9


def facing_cameras(count: int) -> tuple[Tensor, Tensor]:
    """K [V, 3, 3] and poses [V, 4, 4], all of which see the whole of a 2.1 m cube."""
    K = torch.tensor([[9.0, 0, 15.5], [0, 9.0, 11.5], [0, 0, 1]]).expand(count, 3, 3)
    poses = []
    for i in range(count):
        yaw = 2 * np.pi * i / count + 0.1
        direction = np.array([np.cos(yaw), np.sin(yaw), 0.0])
        poses.append(box_room.look(0.75 - 3.4 * direction, yaw, 0.0))
    return K, torch.from_numpy(np.stack(poses)).float()


@pytest.mark.parametrize("masks", [True, False])
@pytest.mark.parametrize(
    ("refine", "inputs"),
    [(True, {}), (False, {}), (True, {"matching": True}), (True, {"stereo": True})],
)
@torch.inference_mode()
def test_test_time_computes_what_training_computes(
    tiny_network: Factory, refine: bool, inputs: dict[str, bool], masks: bool
) -> None:
    """Where every view sees every voxel, training and the dense reference differ in nothing."""
    network = tiny_network(refine=refine, **inputs, filter=masks, far=8.0)
    trained_to_match(network)
    K, poses = facing_cameras(4)
    generator = torch.Generator().manual_seed(0)
    images = torch.randint(0, 256, (4, 24, 32, 3), generator=generator, dtype=torch.uint8)
    coarse_grid = VoxelGrid((-0.3, -0.3, -0.3), 0.3, (7, 7, 7))
    points = 0.35 + 0.8 * torch.rand(50, 3, generator=generator)  # clear of the chunk's border
    fine_grid = VoxelGrid((0.0, 0.0, 0.0), 0.1, (15, 15, 15))
    # the same at every pixel: the nearest one is not always the same to a rounding error
    depths = (5 * torch.rand(4, 2, 1, 1, generator=generator)).expand(-1, -1, 12, 16)
    stereo = depths[None] if "stereo" in inputs else None
    views = Views(images.permute(0, 3, 1, 2)[None], K[None], poses[None], stereo=stereo)
    head = network.refinement.coarse_mask[-1]
    logits = network(views, coarse_grid, fine_grid, points[None], None).coarse
    middle = logits.flatten().sort().values[logits.numel() // 2 :][:2].mean()
    head.bias.sub_(middle)  # half of the voxels are near, none by a rounding error
    trained = network(views, coarse_grid, fine_grid, points[None], None)
    r = DenseReconstructor(network, coarse_grid, ReconstructionSettings())
    for image, k, pose in zip(images, K, poses, strict=True):
        r.add_frame(image.numpy(), k.numpy(), pose.numpy())
    for maps, depth in zip(r.maps, depths, strict=True):  # all views are kept, whatever it says
        maps["stereo"] = depth
    v = r.volumes()
    assert v is not None
    occupancy = network.decode(v.coarse, v.coarse_grid, v.fine, v.fine_grid, points)
    torch.testing.assert_close(occupancy, trained.occupancy[0], atol=1e-4, rtol=1e-4)
    assert bool(trained.fine_active.all()) is not masks


@pytest.mark.parametrize(
    ("select", "changes"),
    [
        ({"select": "attention"}, {}),
        ({"select": "random", "seed": 3}, {"refine": False}),
        ({"select": "random", "seed": 1}, {"filter": False}),
        ({"select": {"policy": "diverse", "spread": 0.5}, "seed": 2}, {"matching": True}),
        ({"select": "attention"}, {"matching": True, "stereo": True}),
        ({"select": "random", "seed": 2}, {"fusion": "gru"}),
    ],
)
def test_sparse_equals_dense(
    tiny_network: Factory, scene: Scene, select: dict[str, Any], changes: dict[str, Any]
) -> None:
    """The same view sets and mesh as dense volumes, dense convolutions, one marching cubes."""
    network = balanced(trained_to_match(tiny_network(**changes)), scene)
    r = reconstruct(network, scene, **select, views=3)
    reference = dense(network, scene, **select, views=3)
    mesh, expected = r.mesh(), reference.mesh()
    grid = reference.grid
    frames = on_grid(r.coarse, r.coarse.store.frames + 1, grid) - 1
    assert torch.equal(frames.flatten(0, 2), reference.coarse_store.frames)
    assert_close_surface(mesh, expected)
    volumes, found = reference.volumes(), volumes_of(r, scene)
    assert volumes is not None
    torch.testing.assert_close(found.coarse, volumes.coarse, atol=1e-4, rtol=1e-4)
    low = [
        round((a - b) / 0.1)
        for a, b in zip(volumes.fine_grid.origin, found.fine_grid.origin, strict=True)
    ]
    inner = tuple(slice(a, a + n) for a, n in zip(low, volumes.fine_grid.shape, strict=True))
    torch.testing.assert_close(
        found.fine[(slice(None), *inner)], volumes.fine, atol=1e-4, rtol=1e-4
    )


def test_no_voxels_are_convolved_to_none(tiny_network: Factory) -> None:
    """A chunk where all that is seen is still to be fused has none."""
    (block, *_) = tiny_network().refinement.fine_blocks
    assert isinstance(block, ResidualBlock3d)
    width = block.conv1.in_channels
    nothing = sparse.convolve(block.conv1, torch.zeros(0, width), torch.zeros(0, 27).long())
    assert nothing.shape == (0, width)


def test_parts_fit_without_a_seam(tiny_network: Factory, scene: Scene) -> None:
    """Every chunk border is crossed by faces that share their vertices."""
    r = reconstruct(balanced(tiny_network(), scene), scene)
    mesh = r.mesh(color=False)
    assert len(r.surface.parts) > 8
    assert len(np.unique(mesh.vertices, axis=0)) == len(mesh.vertices)
    together = sum(len(vertices) for vertices, _ in r.surface.parts.values())
    assert len(mesh.vertices) < together


def colors_of(mesh: trimesh.Trimesh) -> np.ndarray:
    assert isinstance(mesh.visual, trimesh.visual.ColorVisuals)
    return np.asarray(mesh.visual.vertex_colors, int)


def assert_same_mesh(a: trimesh.Trimesh, b: trimesh.Trimesh) -> None:
    assert len(a.faces) > 100
    np.testing.assert_array_equal(a.faces, b.faces)
    np.testing.assert_allclose(a.vertices, b.vertices, atol=1e-4)
    assert (np.abs(colors_of(a) - colors_of(b)) > 1).mean() < 1e-3  # what hides what may be close


@pytest.mark.parametrize("select", [{"select": "attention"}, {"select": "random", "seed": 3}])
def test_neither_batches_nor_earlier_meshes_change_the_result(
    tiny_network: Factory, scene: Scene, select: dict[str, Any]
) -> None:
    network = balanced(tiny_network(), scene)
    expected = reconstruct(network, scene, **select, views=3).mesh()
    small = reconstruct(network, scene, **select, views=3, batch=97).mesh()
    assert_same_mesh(expected, small)
    eager = reconstruct(network, scene, FRAMES[:3], **select, views=3)
    for i in FRAMES[3:]:
        eager.mesh()
        eager.add_frame(scene.image(i), scene.K[i], scene.world_T_cam[i])
    assert_same_mesh(expected, eager.mesh())
    assert_same_mesh(expected, eager.mesh())  # and asking twice gives the same answer


def test_with_enough_slots_the_order_of_frames_does_not_matter(
    tiny_network: Factory, scene: Scene
) -> None:
    network = balanced(tiny_network(), scene)
    a = volumes_of(reconstruct(network, scene), scene)
    b = volumes_of(reconstruct(network, scene, FRAMES[::-1]), scene)
    torch.testing.assert_close(a.coarse, b.coarse, atol=1e-4, rtol=1e-4)
    torch.testing.assert_close(a.fine, b.fine, atol=1e-4, rtol=1e-4)
    assert (a.active != b.active).float().mean() < 1e-3


def test_seeds_give_different_views(tiny_network: Factory, scene: Scene) -> None:
    held = [
        reconstruct(tiny_network(), scene, select="random", seed=seed, views=2).coarse.store
        for seed in (1, 2)
    ]
    assert not torch.equal(held[0].frames, held[1].frames)
    assert torch.equal(held[0].seen, held[1].seen)


@pytest.mark.parametrize("masks", [True, False])
def test_the_mesh_stays_within_what_was_seen(
    tiny_network: Factory, scene: Scene, masks: bool
) -> None:
    network = balanced(tiny_network(filter=masks), scene)
    r = reconstruct(network, scene, resolution=0.1)
    mesh, volumes = r.mesh(), volumes_of(r, scene)
    assert len(mesh.faces) > 100
    centers = torch.tensor(mesh.triangles_center, dtype=torch.float32)
    voxel = volumes.fine_grid.to_index(centers).round().long()
    assert volumes.active[tuple(voxel.T)].float().mean() > 0.99
    seen = np.max([clearance(mesh.vertices, scene, f) for f in FRAMES], axis=0)
    assert (seen > -0.1 * 3**0.5).all()  # a voxel's diagonal; pixels count less
    assert colors_of(mesh).shape == (len(mesh.vertices), 4)


def test_nothing_to_reconstruct(tiny_network: Factory, scene: Scene) -> None:
    empty = reconstruct(tiny_network(), scene, [])
    assert len(empty.mesh().faces) == 0
    assert len(empty.mesh(([0, 0, 0], [1, 1, 1])).faces) == 0
    strict = reconstruct(tiny_network(), scene, FRAMES[:2], threshold=1.0)
    assert len(strict.mesh().faces) == 0


def test_a_strategy_without_preference_gets_random_views(
    tiny_network: Factory, scene: Scene
) -> None:
    network = balanced(tiny_network(fusion="avg"), scene)
    r = reconstruct(network, scene, select="attention", seed=3, views=2)
    assert r.policy == RandomSelection(3)  # of the run's own seed
    assert r.coarse.store.seen.max() > 2
    assert len(r.mesh().faces) > 0
    for fusion in ("transformer", "pred"):
        kept = reconstruct(tiny_network(fusion=fusion), scene, FRAMES[:1])
        assert isinstance(kept.policy, AttentionSelection)


def test_a_frame_of_another_size(tiny_network: Factory, scene: Scene) -> None:
    r = reconstruct(tiny_network(), scene, FRAMES[:2])
    with pytest.raises(TFLabError, match="64x48"):
        r.add_frame(np.zeros((48, 64, 3), np.uint8), scene.K[0], scene.world_T_cam[0])
    assert len(r.frames) == 2  # and the reconstruction goes on
    r.add_frame(scene.image(0), scene.K[0], scene.world_T_cam[0])


def test_a_frame_that_cannot_be_one(tiny_network: Factory, scene: Scene) -> None:
    image, K, pose = scene.image(0), scene.K[0], scene.world_T_cam[0]
    larger = np.diag([4.0, 4.0, 1.0]) @ K  # of images of 16 times the pixels
    for frame, said in (
        ((image.transpose(2, 0, 1), K, pose), r"\(3, .*has to be uint8 \[H, W, 3\], RGB"),
        ((image / 255.0, K, pose), r"float64; it has to be uint8"),
        ((image, K, pose[:3]), r"\(3, 4\); it has to be \[4, 4\]"),
        ((image, K.T, pose), r"intrinsics .* that are not fx s cx / 0 fy cy / 0 0 1"),
        ((image, larger, pose), r"principal point .* outside of the .* of one size"),
    ):
        r = reconstruct(tiny_network(), scene, [])
        with pytest.raises(TFLabError, match=said):
            r.add_frame(*frame)
        assert len(r.frames) == 0


@pytest.mark.parametrize("views", [0, -1])
def test_a_voxel_needs_a_view(views: int) -> None:
    with pytest.raises(TFLabError, match="views="):
        ReconstructionSettings(views=views)


PLACES = {
    "encoding": (Network, "encode"),
    "stereo": (DepthSequence, "add"),
    "offering": (Level, "offer"),
    "fusing": (Level, "fuse"),
    "refining": (sparse, "residual_blocks"),
    "masking": (sparse, "mask_logits"),
    "replaying": (Reconstructor, "replay"),
    "decoding": (Decoder, "__call__"),
}


@pytest.mark.parametrize("place", PLACES)
def test_what_breaks_off_leaves_nothing_half_done(
    tiny_network: Factory, scene: Scene, monkeypatch: pytest.MonkeyPatch, place: str
) -> None:
    """Memory that is short, at every call in turn: all goes on as if it had not been."""
    network = balanced(trained_to_match(tiny_network(far=FAR, matching=True, stereo=True)), scene)
    frames = FRAMES[:3]
    expected = reconstruct(network, scene, frames).mesh(color=False)
    owner, name = PLACES[place]
    work, calls = getattr(owner, name), [0]
    broken = 0
    for fatal in range(1, 6):
        calls[0] = 0

        def short(*args: Any, fatal: int = fatal, **kwargs: Any) -> Any:
            calls[0] += 1
            if calls[0] == fatal:
                work(*args, **kwargs)  # what it has changed by then stays changed
                raise torch.OutOfMemoryError("CUDA out of memory")
            return work(*args, **kwargs)

        monkeypatch.setattr(owner, name, short)
        r = Reconstructor(network, settings_of())
        for i in frames:
            frame = scene.image(i), scene.K[i], scene.world_T_cam[i]
            try:
                r.add_frame(*frame)
            except torch.OutOfMemoryError:
                broken += 1
                r.add_frame(*frame)
        try:
            r.mesh(color=False)
        except torch.OutOfMemoryError:
            broken += 1
        mesh = r.mesh(color=False)
        monkeypatch.setattr(owner, name, work)
        assert len(r.frames) == len(frames)
        assert_same_surface(mesh, expected)
    assert broken


def test_files_may_be_named_by_text(tiny_network: Factory, scene: Scene, tmp_path: Path) -> None:
    network = tiny_network(far=FAR)
    r = reconstruct(network, scene, FRAMES[:1])
    r.save(str(tmp_path / "state.safetensors"))
    again = Reconstructor.load(str(tmp_path / "state.safetensors"), network)
    assert torch.equal(again.coarse.store.frames, r.coarse.store.frames)
