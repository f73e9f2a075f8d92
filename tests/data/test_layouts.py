"""One room in every source's own layout: the same cameras, images, depth and mesh."""

from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest

from helpers.layouts import LAYOUTS, room_frames
from tf_lab.data.capture import Capture
from tf_lab.data.groundtruth import GroundTruthSettings, write_groundtruth
from tf_lab.data.readers import open_capture
from tf_lab.data.scene import write_scene
from tf_lab.evaluation.protocol import evaluate_scene
from tf_lab.network.checkpoint import load_network, shipped_checkpoint
from tf_lab.network.network import Network
from tf_lab.online.reconstruction import reconstruct
from tf_lab.online.settings import ReconstructionSettings

every_layout = pytest.mark.parametrize("layout", list(LAYOUTS))
NO_DEPTH = ("colmap_text", "colmap_binary", "transforms_splits", "arkit", "video")


def opened(layout: str, tmp_path: Path) -> Capture:
    module = LAYOUTS[layout]
    return open_capture(module.write(tmp_path / "room", room_frames()), module.OPTIONS)


@every_layout
def test_the_layout_is_recognised_and_gives_the_same_capture(layout: str, tmp_path: Path) -> None:
    capture, frames = opened(layout, tmp_path), room_frames()
    assert len(capture.frames) == len(frames)
    assert capture.skipped == []
    expected = np.stack([frame.world_T_cam for frame in frames])
    np.testing.assert_allclose(capture.world_T_cam, expected, atol=1e-5)
    np.testing.assert_allclose(capture.K, np.stack([frame.K for frame in frames]), atol=1e-5)
    for i in range(len(frames)):
        difference = np.abs(capture.image(i).astype(float) - frames[i].image)
        assert difference.mean() < 0.01
        depth, truth = capture.depth(i), frames[i].depth
        if layout in NO_DEPTH:
            assert depth is None
        else:
            np.testing.assert_allclose(depth, truth, atol=0.0011)


@lru_cache(maxsize=1)
def network() -> Network:
    return load_network(shipped_checkpoint())[0]


def fscore(capture: Capture, groundtruth: Path) -> float:
    settings = ReconstructionSettings(views=8, resolution=0.05)
    return evaluate_scene(reconstruct(network(), capture, settings).mesh, groundtruth)["fscore"]


@pytest.fixture(scope="module")
def reference(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, float]:
    """The room's ground truth, and the score of its reconstruction without any reader."""
    scene = write_scene(tmp_path_factory.mktemp("room") / "room", room_frames(), {}, "room")
    write_groundtruth(scene, scene.groundtruth, GroundTruthSettings())
    scene.image = lambda i: room_frames()[i].image  # type: ignore[method-assign]  # before JPEG
    return scene.groundtruth, fscore(scene, scene.groundtruth)


@pytest.mark.parametrize("layout", ["plain", "colmap_text"])  # the others give the same capture
def test_the_layout_gives_the_same_mesh(
    layout: str, tmp_path: Path, reference: tuple[Path, float]
) -> None:
    groundtruth, expected = reference
    assert expected > 0.1
    assert fscore(opened(layout, tmp_path), groundtruth) == pytest.approx(expected, abs=0.01)
