"""Training chunks of the analytic room: consistent geometry, and the same at every run."""

import itertools
import pickle
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor
from torch.utils.data import DataLoader

from helpers import box_room
from helpers.small_shards import same
from tf_lab.data.chunk_sampler import ChunkSampler, ChunkScene, ChunkStream, choose_frames
from tf_lab.data.chunks import COARSE_GRID, FINE_GRID, ChunkBatch, _disturbed, make_batch
from tf_lab.data.groundtruth import GroundTruth
from tf_lab.data.scene import Scene
from tf_lab.data.settings import CameraNoise, ChunkSettings
from tf_lab.errors import TFLabError
from tf_lab.geometry import CHUNK, COARSE, FINE

NEAR, FAR = 0.3, 5.0
SMALL = ChunkSettings(chunks=2, images=3, points=64)
RULES = {"attention": 1.0, "random": 1.0}


def sampler(box_scene: Path, settings: ChunkSettings = SMALL, far: float = FAR) -> ChunkSampler:
    return ChunkSampler([box_scene], settings, NEAR, far)


def stream(box_scene: Path, **arguments: int) -> ChunkStream:
    return ChunkStream(sampler(box_scene), **{"seed": 0, **arguments})


def draw(box_scene: Path, settings: ChunkSettings, seed: int = 0) -> ChunkBatch:
    return ChunkStream(sampler(box_scene, settings), seed).batch(0)


def frames_of(batch: ChunkBatch, scene: Scene) -> list[list[int]]:
    """Which frames the images are: int [B][V]."""
    known = [torch.tensor(scene.image(i)).permute(2, 0, 1) for i in range(len(scene))]
    return [
        [next(i for i, k in enumerate(known) if torch.equal(k, image)) for image in images]
        for images in batch.images
    ]


def world_T_chunk(batch: ChunkBatch, scene: Scene) -> Tensor:
    """[B, 4, 4], told by the cameras: world_T_cam of the scene times the inverse of the chunk's."""
    frames = frames_of(batch, scene)
    poses = torch.from_numpy(scene.world_T_cam[[f[0] for f in frames]])
    return poses @ torch.linalg.inv(batch.world_T_cam[:, 0].double())


@pytest.fixture(scope="module")
def batch(box_scene: Path) -> ChunkBatch:
    settings = ChunkSettings(chunks=8, images=4, points=1000)
    return draw(box_scene, settings, seed=3)


@pytest.fixture(scope="module")
def scene(box_scene: Path) -> Scene:
    return Scene(box_scene)


def test_shapes(batch: ChunkBatch) -> None:
    assert batch.images.shape == (8, 4, 3, 60, 80)
    assert batch.images.dtype == torch.uint8
    assert batch.K.shape == (8, 4, 3, 3)
    assert batch.world_T_cam.shape == (8, 4, 4, 4)
    assert batch.coarse_target.shape == (8, 7, 7, 7)
    assert batch.fine_target.shape == (8, 15, 15, 15)
    assert batch.coarse_target.dtype == batch.fine_target.dtype == torch.bool
    assert batch.points.shape == (8, 1000, 3)
    assert batch.sdf.shape == (8, 1000)
    for value in (batch.K, batch.world_T_cam, batch.points, batch.sdf):
        assert value.dtype == torch.float32


def test_times_are_those_of_the_images(batch: ChunkBatch, scene: Scene) -> None:
    for frames, times in zip(frames_of(batch, scene), batch.times, strict=True):
        assert frames != sorted(frames) or len(frames) < 3
        assert [frames[i] for i in times.argsort()] == sorted(frames)


def test_cameras_belong_to_the_images(batch: ChunkBatch, scene: Scene) -> None:
    """One rigid motion about the vertical takes all cameras of a chunk to the scene's."""
    for b, frames in enumerate(frames_of(batch, scene)):
        assert len(set(frames)) == 4
        poses = torch.from_numpy(scene.world_T_cam[frames])
        motion = poses @ torch.linalg.inv(batch.world_T_cam[b].double())
        torch.testing.assert_close(motion, motion[:1].expand(4, 4, 4), atol=1e-5, rtol=0)
        rotation = motion[0, :3, :3]
        torch.testing.assert_close(rotation @ rotation.T, torch.eye(3).double(), atol=1e-5, rtol=0)
        torch.testing.assert_close(
            rotation[:, 2], torch.tensor([0, 0, 1]).double(), atol=1e-5, rtol=0
        )
        assert torch.linalg.det(rotation) > 0
        np.testing.assert_allclose(batch.K[b], scene.K[frames], rtol=1e-6)


def test_surface_points_seen_by_the_cameras_are_surface_in_the_chunk(
    batch: ChunkBatch, scene: Scene
) -> None:
    """Depth unprojected with a chunk's own cameras falls on near-surface voxels."""
    checked = 0
    for b, frames in enumerate(frames_of(batch, scene)):
        if not batch.fine_target[b].any():  # a chunk beyond the walls
            continue
        for i, frame in enumerate(frames):
            depth = scene.depth(frame)
            assert depth is not None
            k = batch.K[b, i].numpy()
            v, u = np.indices(depth.shape)
            camera = np.stack([(u - k[0, 2]) / k[0, 0], (v - k[1, 2]) / k[1, 1], np.ones(u.shape)])
            camera = (camera * depth).reshape(3, -1)
            pose = batch.world_T_cam[b, i].numpy()
            points = (pose[:3, :3] @ camera).T + pose[:3, 3]
            inside = ((points > 0.05) & (points < CHUNK - 0.05)).all(1)
            fine = np.floor(points[inside] / FINE).astype(int)
            coarse = np.floor(points[inside] / COARSE).astype(int) + 1
            # the voxel of a surface point has its centre within 8.7 cm of it: near on both levels
            assert batch.fine_target[b][tuple(fine.T)].float().mean() > 0.98
            assert batch.coarse_target[b][tuple(coarse.T)].float().mean() > 0.9
            checked += inside.sum()
    assert checked > 5000


def wrong_targets(
    batch: ChunkBatch, scene: Scene, truth: GroundTruth, beyond: bool
) -> tuple[int, int]:
    """How many voxels have a target that the analytic distance contradicts, and of how many.

    Of voxels with their centre beyond the ground truth's volume, or of the others.
    """
    wrong = count = 0
    for b, pose in enumerate(world_T_chunk(batch, scene).numpy()):
        for grid, target, radius in (
            (COARSE_GRID, batch.coarse_target, COARSE),
            (FINE_GRID, batch.fine_target, FINE),
        ):
            centers = grid.centers().double().numpy().reshape(-1, 3) @ pose[:3, :3].T + pose[:3, 3]
            distance = np.abs(box_room.signed_distance(centers))
            index = truth.grid.to_index(torch.from_numpy(centers)).numpy()
            outside = ((index < -0.5) | (index > np.array(truth.grid.shape) - 0.5)).any(1)
            # 3 cm for the volume's resolution; there is no surface under the box
            asked = (np.abs(distance - radius) > 0.03) & (outside == beyond)
            asked &= beyond | (centers[:, 2] > box_room.ROOM[0][2])
            wrong += int(((target[b].flatten().numpy() != (distance < radius)) & asked).sum())
            count += int(asked.sum())
    return wrong, count


def test_targets_are_the_analytic_distances(
    batch: ChunkBatch, scene: Scene, box_scene: Path
) -> None:
    wrong, count = wrong_targets(batch, scene, GroundTruth(box_scene / "groundtruth"), False)
    assert count > 10_000
    assert wrong < 0.002 * count


def test_targets_behind_the_outermost_walls(
    batch: ChunkBatch, scene: Scene, box_scene: Path
) -> None:
    wrong, _ = wrong_targets(batch, scene, GroundTruth(box_scene / "groundtruth"), True)
    assert wrong == 0


def test_sdf_is_the_analytic_distance(batch: ChunkBatch, scene: Scene) -> None:
    transforms = world_T_chunk(batch, scene).numpy()
    for b, pose in enumerate(transforms):
        if not batch.fine_target[b].any():  # a chunk beyond the walls: all is unknown
            continue
        points = batch.points[b].double().numpy() @ pose[:3, :3].T + pose[:3, 3]
        true, found = box_room.signed_distance(points), batch.sdf[b].numpy()
        known = np.isfinite(found)
        close = known & (np.abs(true) < 0.06)
        assert np.median(np.abs(found - true)[close]) < 0.01
        clear = known & (np.abs(true) > 0.04)
        assert ((found > 0) == (true > 0))[clear].mean() > 0.98
        assert known[true > 0.05].mean() > 0.97


def test_points_are_mostly_near_the_surface(batch: ChunkBatch, scene: Scene) -> None:
    assert (batch.points >= 0).all()
    assert (batch.points < CHUNK).all()
    shares = []
    for b, pose in enumerate(world_T_chunk(batch, scene).numpy()):
        points = batch.points[b].double().numpy() @ pose[:3, :3].T + pose[:3, 3]
        true = np.abs(box_room.signed_distance(points))
        if batch.fine_target[b].any():
            shares.append((true[:800] < 0.1).mean())
        # the last fifth is uniform: as near as the chunk is
        uniform = np.random.default_rng(0).uniform(0, CHUNK, (20_000, 3)) @ pose[:3, :3].T
        volume = (np.abs(box_room.signed_distance(uniform + pose[:3, 3])) < 0.1).mean()
        assert (true[800:] < 0.1).mean() == pytest.approx(volume, abs=0.12)
    assert np.mean(shares) > 0.9


def test_views_see_the_chunk(box_scene: Path, scene: Scene) -> None:
    """Every image sees its share of the chunk; with more asked for, fewer images qualify."""
    centers = np.stack(np.meshgrid(*[np.arange(0.15, 1.5, 0.3)] * 3, indexing="ij"), -1)
    points = centers.reshape(-1, 3)
    for coverage in (0.1, 0.4):
        settings = ChunkSettings(chunks=4, images=2, points=10, coverage=coverage)
        batch = draw(box_scene, settings)
        for b, i in itertools.product(range(4), range(2)):
            camera = (points - batch.world_T_cam[b, i, :3, 3].numpy()) @ batch.world_T_cam[
                b, i, :3, :3
            ].numpy()
            u, v = (batch.K[b, i].numpy() @ camera.T)[:2] / camera[:, 2]
            seen = (camera[:, 2] > NEAR) & (np.abs(u - 39.5) < 40) & (np.abs(v - 29.5) < 30)
            assert seen.mean() >= coverage - 0.01


def test_without_augmentation_only_shifts(box_scene: Path, scene: Scene) -> None:
    settings = ChunkSettings(chunks=3, images=2, points=10, augment=False)
    batch = draw(box_scene, settings)
    rotations = world_T_chunk(batch, scene)[:, :3, :3]
    torch.testing.assert_close(rotations, torch.eye(3).double().expand(3, 3, 3), atol=1e-5, rtol=0)


def test_cameras_are_made_wrong_and_nothing_else(box_scene: Path) -> None:
    """As often as the batch is drawn, in the same way."""
    right = draw(box_scene, ChunkSettings(chunks=3, images=4, points=10))
    noise = CameraNoise(translation=0.05, focal=0.05)
    settings = ChunkSettings(chunks=3, images=4, points=10, camera_noise=noise)
    wrong = draw(box_scene, settings)
    assert same(wrong, draw(box_scene, settings))
    off = (wrong.world_T_cam - right.world_T_cam)[..., :3, 3].norm(dim=-1)
    assert (off > 0).all() and (off < 0.3).all()
    assert (wrong.K != right.K).any(dim=(1, 2, 3)).all()
    assert same(replace(wrong, K=right.K, world_T_cam=right.world_T_cam), right)


def test_some_cameras_are_nearly_right() -> None:
    """Of normal shifts some 0.5 % are below a third of their deviation; of shares of such, many."""
    poses, K = torch.eye(4).double().expand(1, 4, 4), torch.eye(3).double().expand(1, 3, 3)
    rng, noise = np.random.default_rng(0), CameraNoise(translation=0.05)
    off = [float(_disturbed(K, poses, noise, rng)[1][0, :3, 3].norm()) for _ in range(500)]
    assert 0.1 < np.mean(np.array(off) < 0.05 / 3) < 0.4
    assert max(off) > 0.1


def test_chunks_are_drawn_by_weight(box_scene: Path) -> None:
    """Centres against the weights of the candidates, jitter apart."""
    opened = ChunkScene(box_scene)
    truth, rng = opened.truth, np.random.default_rng(0)
    centers = []
    for _ in range(1500):
        pose = torch.linalg.inv(opened.place(rng, turn=True)).numpy()
        centers.append(pose[:3, :3] @ np.full(3, CHUNK / 2) + pose[:3, 3])
    share = truth.weight / truth.weight.sum()
    expected = (share[:, None] * truth.centers).sum(0)
    spread = np.std(centers, axis=0) / 1500**0.5
    assert (np.abs(np.mean(centers, axis=0) - expected) < 4 * spread).all()
    assert np.linalg.norm(np.array(centers) - box_room.BOX.mean(0), axis=1).min() < 0.2


def test_a_batch_is_a_function_of_seed_rank_and_step(box_scene: Path) -> None:
    first = list(itertools.islice(stream(box_scene), 4))
    again = list(itertools.islice(stream(box_scene), 4))
    assert all(same(a, b) for a, b in zip(first, again, strict=True))
    for other in (stream(box_scene, seed=1), stream(box_scene, rank=1)):
        assert not same(next(iter(other)), first[0])
    assert not any(same(a, b) for a, b in itertools.combinations(first, 2))
    for start in (1, 3):
        resumed = itertools.islice(stream(box_scene, first_step=start), 4 - start)
        assert all(same(a, b) for a, b in zip(resumed, first[start:], strict=True))


@pytest.mark.parametrize("views", [(), (2, 3)])
def test_processes_share_the_chunks_of_a_step(box_scene: Path, views: tuple[int, ...]) -> None:
    """Two with two chunks each have those that one with four has, and keep as many views."""
    of_four = replace(SMALL, chunks=4, views=views, rules=RULES)
    of_two = sampler(box_scene, replace(of_four, chunks=2))
    parts = [of_two.stream(0, 1, rank, 2) for rank in range(2)]
    whole = sampler(box_scene, of_four).stream(0, 1, 0, 1)
    for one, *two in itertools.islice(zip(whole, *parts, strict=True), 4):
        joined = {
            k: torch.cat([vars(part)[k] for part in two])
            for k, value in vars(one).items()
            if isinstance(value, Tensor)
        }
        assert same(replace(one, **joined), one)
        assert {(part.keep, part.rule) for part in two} == {(one.keep, one.rule)}
        assert len(set(one.draws.tolist())) == 4  # chance is the chunk's own, whoever has it


@pytest.mark.parametrize("workers", [1, 2])
def test_the_number_of_workers_does_not_matter(box_scene: Path, workers: int) -> None:
    expected = itertools.islice(stream(box_scene, first_step=5), 4)
    loader = DataLoader(stream(box_scene, first_step=5), batch_size=None, num_workers=workers)
    found = itertools.islice(iter(loader), 4)
    assert all(same(a, b) for a, b in zip(found, expected, strict=True))


def test_a_stream_travels_to_worker_processes(box_scene: Path) -> None:
    """Where processes aren't forked (macOS, Windows, Python 3.14) the stream is pickled."""
    original = stream(box_scene)
    copy = pickle.loads(pickle.dumps(original))
    assert same(next(iter(copy)), next(iter(original)))


def test_the_number_of_views_varies_from_step_to_step(box_scene: Path) -> None:
    settings = ChunkSettings(chunks=1, images=4, views=(2, 3), rules=RULES, points=8)
    batches = list(itertools.islice(ChunkStream(sampler(box_scene, settings), 0), 12))
    assert {b.images.shape[1] for b in batches} == {4}
    assert {b.keep for b in batches} == {2, 3}
    assert {b.rule for b in batches} == {"attention", "random"}
    assert len({int(b.draws) for b in batches}) == 12


def test_fewer_images_than_a_record_holds(box_scene: Path) -> None:
    """A step uses some of them, each with its own camera; other steps use others."""
    record = sampler(box_scene, replace(SMALL, images=6)).record(0, 0)
    stored = torch.empty((6, 3, 60, 80), dtype=torch.uint8)
    record.decode(range(6), stored.numpy())
    used = []
    for step in range(8):
        batch = make_batch([record], SMALL, seed=0, rank=0, step=step)
        assert len(batch.images[0]) == SMALL.images
        found = [next(i for i in range(6) if torch.equal(stored[i], x)) for x in batch.images[0]]
        assert torch.equal(batch.world_T_cam[0], record.world_T_cam[found])
        used.append(frozenset(found))
    assert len(set(used)) > 2
    assert frozenset.union(*used) == set(range(6))


def test_a_chunk_is_covered_as_much_as_its_probes_are_seen(box_scene: Path) -> None:
    """Frames left out by their frustum's sides are those that see nothing: all frames tested."""
    opened = ChunkScene(box_scene)
    axis = torch.arange(0.15, CHUNK, COARSE, dtype=torch.float64)
    probes = torch.cartesian_prod(axis, axis, axis)
    rng = np.random.default_rng(1)
    shares = []
    for _ in range(20):
        world_T_chunk = torch.linalg.inv(opened.place(rng, turn=True))
        world = probes @ world_T_chunk[:3, :3].T + world_T_chunk[:3, 3]
        expected = []
        for K, pose in zip(opened.scene.K, opened.scene.world_T_cam, strict=True):
            camera = (world.numpy() - pose[:3, 3]) @ pose[:3, :3]
            with np.errstate(divide="ignore"):
                u, v = (camera @ K.T)[:, :2].T / camera[:, 2]
            inside = (u >= -0.5) & (u < 79.5) & (v >= -0.5) & (v < 59.5)
            expected.append((inside & (camera[:, 2] >= NEAR) & (camera[:, 2] <= 1.5)).mean())
        found = opened.coverage(world_T_chunk, NEAR, 1.5)
        np.testing.assert_allclose(found, expected, atol=0.009)  # one of 125 by rounding
        shares.extend(found)
    assert 0 < np.mean(np.array(shares) > 0.1) < 0.5


def test_a_damaged_image_is_told_with_its_scene(box_scene: Path, tmp_path: Path) -> None:
    broken = tmp_path / "broken"
    shutil.copytree(box_scene, broken)
    for path in (broken / "color").iterdir():
        path.write_bytes(path.read_bytes()[:-400])
    with pytest.raises(TFLabError, match=r"broken.*damaged.*prepare it again"):
        draw(broken, SMALL)
    shutil.rmtree(broken / "color")
    with pytest.raises(TFLabError, match=r"broken/color/00.*prepare it again"):
        ChunkSampler([broken], SMALL, NEAR, FAR).record(0, 1)


def test_moving_a_batch(batch: ChunkBatch) -> None:
    moved = batch.to(torch.device("meta"))
    tensors = [v for v in vars(moved).values() if isinstance(v, Tensor)]
    assert len(tensors) == 9
    assert {v.device.type for v in tensors} == {"meta"}
    assert (moved.keep, moved.rule) == (batch.keep, batch.rule)
    assert moved.images.dtype == torch.uint8


def test_nothing_to_train_on(box_scene: Path, tmp_path: Path) -> None:
    with pytest.raises(TFLabError, match="no training scene"):
        ChunkSampler([], SMALL, NEAR, FAR)
    many = ChunkSettings(chunks=1, images=21, points=8)  # of 20 frames
    with pytest.raises(TFLabError, match="no chunk with 21 images"):
        draw(box_scene, many)
    missing = ChunkSampler([tmp_path / "gone"], SMALL, NEAR, FAR)
    with pytest.raises(TFLabError, match=r"gone.*prepare"):
        missing.record(0, 0)


def test_frames_that_see_most_fill_up_where_too_few_see_enough() -> None:
    share = np.array([0.0, 0.5, 0.1, 0.9, 0.2, 0.45, 0.3, 0.0])
    settings = ChunkSettings(images=5, coverage=0.4, seen_by=3)
    rng = np.random.default_rng(0)
    chosen = [choose_frames(share, settings, rng) for _ in range(20)]
    assert all(sorted(frames) == [1, 3, 4, 5, 6] for frames in chosen)  # type: ignore[type-var]
    assert len({tuple(frames) for frames in chosen}) > 10  # type: ignore[arg-type]
    assert choose_frames(share, replace(settings, seen_by=4), rng) is None
    assert choose_frames(share, replace(settings, images=9), rng) is None  # of 8 frames
    few = [choose_frames(share, replace(settings, images=2), rng) for _ in range(40)]
    pairs = itertools.combinations([1, 3, 5], 2)  # those that see enough, any of them
    assert {tuple(sorted(frames)) for frames in few} == set(pairs)  # type: ignore[type-var]
