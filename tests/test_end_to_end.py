"""Checks with known answers on the way from data to score: before any training, and of it."""

from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from torch import Tensor

from helpers.online.scenes import surface_of
from tf_lab.data.chunk_sampler import ChunkSampler, ChunkStream
from tf_lab.data.chunks import COARSE_GRID, FINE_GRID
from tf_lab.data.groundtruth import GroundTruth
from tf_lab.data.keyframes import select_keyframes
from tf_lab.data.scene import Scene
from tf_lab.data.settings import ChunkSettings
from tf_lab.data.sources.embedded import FlatSource, RoomSource
from tf_lab.data.sources.settings import FlatsData, RoomsData
from tf_lab.data.visibility import scene_visibility
from tf_lab.evaluation.protocol import evaluate_scene
from tf_lab.geometry import FINE, VoxelGrid
from tf_lab.network.chunks import Views
from tf_lab.network.network import Network
from tf_lab.training.losses import losses


@pytest.fixture(scope="module")
def test_room(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    """The first room of the test split, as the default renders it."""
    root = str(tmp_path_factory.mktemp("rooms"))
    source = RoomSource(RoomsData(root=root, test_size=1, workers=1))
    (room,) = source.scenes("test")["test"].values()
    return Scene(room)


def score_of_truth(scene: Scene, network: Network) -> dict[str, float]:
    """What follows the network gives with the truth in the network's place."""
    truth = GroundTruth(scene.groundtruth)
    upper = [
        o + n * truth.grid.voxel for o, n in zip(truth.grid.origin, truth.grid.shape, strict=True)
    ]
    grid = VoxelGrid.covering(truth.grid.origin, upper, FINE, 3)
    distance = truth.surface_distance(grid.centers().reshape(-1, 3)).view(grid.shape)

    def decode(points: Tensor) -> Tensor:
        return torch.nan_to_num(-truth.signed_distance(points), nan=0.1)  # unknown: solid

    online = surface_of(decode, distance < FINE, grid, network, 5)
    return evaluate_scene(online.surface.assemble(None), scene.groundtruth)


def test_true_occupancy_gives_the_true_mesh(
    test_room: Scene, tiny_network: Callable[..., Network]
) -> None:
    scores = score_of_truth(test_room, tiny_network())
    assert scores["fscore"] > 0.97
    assert scores["chamfer"] < 2.0  # cm


@pytest.mark.slow
def test_true_occupancy_gives_the_true_mesh_of_a_flat(
    tmp_path: Path, tiny_network: Callable[..., Network]
) -> None:
    source = FlatSource(FlatsData(root=str(tmp_path), test_size=1, test_frames=60, workers=1))
    (flat,) = source.scenes("test")["test"].values()
    assert score_of_truth(Scene(flat), tiny_network())["fscore"] > 0.95


def test_the_median_point_is_seen_by_many_keyframes(test_room: Scene) -> None:
    """K = 4, 8 and 16 and the choice of views can matter only if there is a choice."""
    keyframes = select_keyframes(test_room.world_T_cam, 0.1)
    assert scene_visibility(test_room, keyframes).median >= 25


def test_one_chunk_overfits(box_scene: Path, tiny_network: Callable[..., Network]) -> None:
    """Occupancy accuracy > 0.98 on the chunk that is trained on, from its images alone."""
    torch.manual_seed(0)
    network = tiny_network(width=24, hidden=48)
    settings = ChunkSettings(chunks=1, images=8, coverage=0.2, augment=False)
    sampler = ChunkSampler([box_scene], settings, near=0.1, far=5.0)
    batches = iter(ChunkStream(sampler, seed=0))
    batch = next(batches)
    while (batch.sdf < 0).float().mean() < 0.25:  # a chunk with something in it
        batch = next(batches)
    adam = torch.optim.Adam(network.parameters(), 3e-3)
    accuracy = 0.0
    for step in range(400):
        p = network(
            Views(batch.images, batch.K, batch.world_T_cam),
            COARSE_GRID,
            FINE_GRID,
            batch.points,
            batch.coarse_target,
        )
        terms = losses(p, batch.coarse_target, batch.fine_target, batch.sdf, True, 0.0)
        adam.zero_grad()
        terms["loss"].backward()
        adam.step()
        where = p.seen & ~torch.isnan(batch.sdf)
        accuracy = float(((p.occupancy > 0) == (batch.sdf < 0))[where].float().mean())
        if accuracy > 0.99 and step > 50:
            break
    assert accuracy > 0.98
