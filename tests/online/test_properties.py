"""What must hold for any frames: selection by its definition, whatever the order of the work."""

from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings, strategies as st
from torch import Tensor

from helpers.online.dense import embed
from helpers.online.scenes import Factory, assert_same_surface, balanced, reconstruct, settings_of
from tf_lab.benchmarks.known import KnownSurface, LazyOnKnownSurface
from tf_lab.benchmarks.rooms import Rooms, walk
from tf_lab.data.scene import Scene
from tf_lab.errors import TFLabError
from tf_lab.online import Reconstructor
from tf_lab.online.reconstruction import reconstruct as reconstruct_capture
from tf_lab.online.views.selection import AttentionSelection, RandomSelection, SelectionPolicy
from tf_lab.online.views.store import ViewStore

K = torch.tensor([[30.0, 0, 31.5], [0, 30.0, 23.5], [0, 0, 1]])


def random_frames(seed: int, count: int) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Noise, seen from anywhere within half a metre in any direction."""
    rng = np.random.default_rng(seed)
    found = []
    for _ in range(count):
        rotation, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        pose = np.eye(4)
        pose[:3, :3] = rotation * np.linalg.det(rotation)
        pose[:3, 3] = rng.uniform(-0.5, 0.5, 3)
        found.append((rng.integers(0, 256, (48, 64, 3), np.uint8), K.numpy(), pose))
    return found


def brute_force(
    network: Any, frames: list[tuple[np.ndarray, np.ndarray, np.ndarray]], point: Tensor, views: int
) -> list[int]:
    """The definition: when K are held, drop that of the lowest weight; then add the new one."""
    held: list[tuple[int, Tensor]] = []
    for number, (image, k, pose) in enumerate(frames):
        camera = torch.from_numpy(pose).float()
        size = (image.shape[1], image.shape[0])
        intrinsics = torch.from_numpy(k)
        if not network.visible(point[None], intrinsics[None], camera[None], size).any():
            continue
        encoded = network.encode(torch.from_numpy(image).permute(2, 0, 1)[None])
        maps = {name: m[0] for name, m in encoded.items()}
        token = embed(network, "coarse", maps, point[None], intrinsics, camera, size)
        if len(held) == views:
            tokens = torch.stack([t for _, t in held], 1)
            weights = network.fuse("coarse", tokens, None)[1][0]  # the whole first block
            held.pop(int(weights.argmin()))
        held.append((number, token[0]))
    return sorted(number for number, _ in held)


@pytest.fixture(scope="module")
def small_network(tiny_network: Factory) -> Any:
    return tiny_network(seed=3, far=1.2)


@settings(max_examples=12)
@given(seed=st.integers(0, 2**31), count=st.integers(1, 9), views=st.integers(1, 4))
@torch.inference_mode()
def test_attention_selection_is_its_definition(
    small_network: Any, seed: int, count: int, views: int
) -> None:
    frames = random_frames(seed, count)
    r = Reconstructor(small_network, settings_of(views=views))
    for frame in frames:
        r.add_frame(*frame)
    rng = np.random.default_rng(seed)
    for row in rng.integers(0, r.coarse.blocks.rows, 6):
        point = r.coarse.points(torch.tensor([row]))[0]
        held = sorted(f for f in r.coarse.store.frames[row].tolist() if f >= 0)
        assert held == brute_force(small_network, frames, point, views)


@given(seed=st.integers(0, 2**31), parts=st.integers(1, 5))
@pytest.mark.parametrize("policy", [AttentionSelection(), RandomSelection(7)])
def test_voxels_may_be_processed_in_any_order(
    policy: SelectionPolicy, seed: int, parts: int
) -> None:
    rng = np.random.default_rng(seed)
    voxels, heads = 17, 2 if policy.needs_logits else 0
    keys = torch.from_numpy(rng.integers(-99, 99, (voxels, 3)))
    stores = [ViewStore(3, heads, policy) for _ in range(2)]
    for store in stores:
        store.grow(voxels)
    for frame in range(10):
        rows = torch.from_numpy(np.flatnonzero(rng.random(voxels) < 0.7))
        logits = torch.from_numpy(rng.normal(size=(len(rows), heads))).float()
        logits = logits if heads else None
        stores[0].add(frame, rows, keys[rows], logits)
        order = torch.from_numpy(rng.permutation(len(rows)))
        for part in order.chunk(parts):
            some = None if logits is None else logits[part]
            stores[1].add(frame, rows[part], keys[rows[part]], some)
    for name in ("frames", "logits", "seen", "dirty"):
        assert torch.equal(getattr(stores[0], name), getattr(stores[1], name))


class Damaged:
    """A capture one of whose images cannot be read."""

    def __init__(self, scene: Scene, broken: int) -> None:
        self.scene, self.broken = scene, broken

    def __getattr__(self, name: str) -> Any:
        return getattr(self.scene, name)

    def image(self, i: int) -> np.ndarray:
        if i == self.broken:
            raise TFLabError("cut short")
        return self.scene.image(i)


@torch.inference_mode()
def test_a_corrupt_image_changes_nothing_but_the_count(tiny_network: Factory, scene: Scene) -> None:
    network = balanced(tiny_network(), scene)
    every = settings_of(views=3, keyframe_distance=0)
    broken = 9
    damaged: Any = Damaged(scene, broken)
    found = reconstruct_capture(network, damaged, every)
    assert len(found.skipped) == 1
    assert "cut short" in found.skipped[0]
    others = [i for i in range(len(scene)) if i != broken]
    assert found.keyframes == others
    assert_same_surface(found.mesh, reconstruct(network, scene, others, views=3).mesh())


@pytest.mark.slow
@torch.inference_mode()
def test_a_long_walk(tiny_network: Factory) -> None:
    """2000 frames, twice through four rooms: bounded memory, and one mesh without seams."""
    budget = 2 << 20
    network = tiny_network(far=4.0)
    r = LazyOnKnownSurface(network, settings_of(views=4, maps="float16", maps_budget=budget))
    rooms = Rooms(4)
    assert isinstance(r.pipeline, KnownSurface)
    r.pipeline.solid = rooms.solid
    sizes = []
    for _ in range(2):
        for frame in walk(range(4), 250, (64, 48)):
            r.add_frame(*frame)
            if len(r.frames) % 250 == 0:
                r.update()
        sizes.append(r.memory)
    assert len(r.frames) == 2000
    assert r.frames.nbytes <= budget
    for name in ("view sets", "features", "feature maps"):
        assert sizes[1][name] <= 1.02 * sizes[0][name]  # the second time shows nothing new
    mesh = r.mesh(color=False)
    assert len(mesh.faces) > 1000
    assert len(np.unique(mesh.vertices, axis=0)) == len(mesh.vertices)
    assert (rooms.solid(torch.from_numpy(mesh.vertices).float()).abs() < 0.02).all()
    _, used = np.unique(mesh.edges_sorted, axis=0, return_counts=True)
    assert used.max() == 2
    assert (used == 1).mean() < 0.05  # where what was seen ends, not at 1.5 m
