"""What an earlier version wrote (2026-11, kept in tests/fixtures) is read as it was meant.

The numbers are those that the version gave that wrote the files. A format that has to change gets
another number, and its files a line that says so, instead of other results.
"""

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from tf_lab.data.shard_set import open_shards
from tf_lab.data.shard_stream import read_records
from tf_lab.errors import TFLabError
from tf_lab.network.checkpoint import load_network
from tf_lab.network.network import Network
from tf_lab.online import Reconstructor
from tf_lab.reporting.results import read_run

FIXTURES = Path(__file__).resolve().parents[1] / "fixtures"


def test_a_checkpoint() -> None:
    network, info = load_network(FIXTURES / "model.safetensors")
    assert info == {"training": {"commit": "1" * 40}}
    with torch.inference_mode():
        maps = network.encode(torch.arange(3 * 24 * 32).float().view(1, 3, 24, 32) % 256)
    found = {name: [*value.shape[1:], float(value.abs().mean())] for name, value in maps.items()}
    assert found["coarse"] == pytest.approx([4, 3, 4, 0.877962], abs=1e-4)
    assert found["fine"] == pytest.approx([4, 12, 16, 0.866115], abs=1e-4)


def test_a_saved_reconstruction() -> None:
    network, _ = load_network(FIXTURES / "model.safetensors")
    scene = Reconstructor.load(FIXTURES / "reconstruction.safetensors", network)
    assert (len(scene.frames), len(scene.coarse.blocks)) == (2, 12)
    mesh = scene.mesh()
    assert len(mesh.faces) == pytest.approx(37, abs=3)  # random weights: rounding moves a few
    lower, upper = [0.35, -0.7986, 0.35], [2.05, 0.85, 0.8097]
    assert mesh.bounds.ravel().tolist() == pytest.approx([*lower, *upper], abs=0.1)


def test_a_saved_reconstruction_of_an_encoder_that_looks_elsewhere() -> None:
    """Its maps are others, although its weights are the same."""
    old, _ = load_network(FIXTURES / "model.safetensors")
    new = Network(replace(old.config, encoder={**old.config.encoder, "centered": True}))
    new.load_state_dict(old.state_dict())
    with pytest.raises(TFLabError, match=r"reconstruction\.safetensors: made with another network"):
        Reconstructor.load(FIXTURES / "reconstruction.safetensors", new.eval())


def test_a_run() -> None:
    run = read_run(next((FIXTURES / "runs").iterdir()))
    assert (run.row, run.seed, run.config.optimizer.steps) == ("Ours", 0, 2500)
    fscores = {name: scores["fscore"] for name, scores in run.scenes.items()}
    assert fscores == {"room_2000000": 0.5, "room_2000001": 0.6}


def test_shards() -> None:
    shards = open_shards(str(FIXTURES / "shards"))
    assert shards.identity == "86cbf306715741ab"
    first, second = read_records(shards.shards[0], [0, 1])
    assert first is not None
    assert second is not None
    assert (first.scene, first.frames, first.size) == ("scene", ["0000", "0001", "0003"], (80, 60))
    assert [len(image) for image in second.images] == [6633, 6631, 6662]
    assert float(first.points.sum()) == pytest.approx(95.7613, abs=1e-3)
    assert int(second.fine_target.sum()) == 213
