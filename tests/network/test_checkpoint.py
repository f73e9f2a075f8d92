"""What is saved comes back exactly; what is no checkpoint is told in one line."""

import json
import shutil
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import pytest
import torch
from safetensors import safe_open
from safetensors.torch import save_file
from torch import Tensor

from helpers.encoders import MAPS
from tf_lab.data.resize import Resized
from tf_lab.data.scene import Scene
from tf_lab.errors import TFLabError
from tf_lab.evaluation.protocol import evaluate_scene
from tf_lab.geometry import VoxelGrid
from tf_lab.network.checkpoint import (
    load_network,
    our_encoder,
    save_network,
    shipped_checkpoint,
)
from tf_lab.network.chunks import Views
from tf_lab.network.encoders.settings import EfficientNetLite0Settings, ResNetSettings
from tf_lab.network.network import Network
from tf_lab.online import ReconstructionSettings, Reconstructor

Factory = Callable[..., Network]
INFO = {"training": {"seed": 0, "scores": {"fscore": 0.5}, "command": "python -m tf_lab.train ü"}}


def outputs(network: Network) -> dict[str, Tensor]:
    """Everything the network says of one chunk seen by two cameras."""
    generator = torch.Generator().manual_seed(0)
    poses = torch.eye(4).repeat(1, 2, 1, 1)
    poses[0, :, :3, 3] = torch.tensor([[0.7, 0.7, -1.0], [0.5, 0.8, -0.8]])
    with torch.inference_mode():
        predictions = network(
            Views(
                torch.randint(0, 256, (1, 2, 3, 24, 32), generator=generator).float(),
                torch.tensor([[30.0, 0, 15.5], [0, 30.0, 11.5], [0, 0, 1]]).expand(1, 2, 3, 3),
                poses,
            ),
            VoxelGrid((-0.3, -0.3, -0.3), 0.3, (7, 7, 7)),
            VoxelGrid((0.0, 0.0, 0.0), 0.1, (15, 15, 15)),
            torch.rand(1, 50, 3, generator=generator) * 1.5,
            torch.ones(1, 7, 7, 7, dtype=torch.bool),
        )
    return vars(predictions)


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"fusion": "avg"},
        {"fusion": "pred", "depth": False},
        {"refine": False, "ray": False},
        {"filter": False, "far": 3.5},
    ],
)
def test_round_trip(tiny_network: Factory, tmp_path: Path, changes: dict[str, Any]) -> None:
    network = tiny_network(seed=1, **changes)
    for name, value in network.named_buffers():  # statistics are part of it
        if "running" in name:
            value.uniform_(0.5, 2)
    path = tmp_path / "new" / "model.safetensors"
    save_network(network, path, INFO)
    torch.manual_seed(99)  # loading must not depend on what the weights start from
    loaded, info = load_network(path)
    assert info == INFO
    assert not loaded.training
    assert json.dumps(asdict(loaded.config)) == json.dumps(asdict(network.config))
    expected, found = outputs(network), outputs(loaded)
    assert expected["coarse_seen"].any()
    for name, value in expected.items():
        assert torch.equal(value, found[name]), name
    assert [p.name for p in path.parent.iterdir()] == ["model.safetensors"]


def test_a_network_in_training_is_loaded_for_evaluation(
    tiny_network: Factory, tmp_path: Path
) -> None:
    path = tmp_path / "model.safetensors"
    save_network(tiny_network().train(), path, {})
    assert not any(module.training for module in load_network(path)[0].modules())


def test_the_file_holds_tensors_and_text_only(tiny_network: Factory, tmp_path: Path) -> None:
    """Loading runs no code: safetensors has no place for any."""
    path = tmp_path / "model.safetensors"
    network = tiny_network()
    save_network(network, path, INFO)
    with safe_open(path, framework="pt") as file:
        assert set(file.keys()) == set(network.state_dict())
        metadata = file.metadata()
    assert json.loads(metadata["info"]) == INFO
    assert json.loads(metadata["config"])["width"] == network.config.width


@pytest.fixture
def whole(tiny_network: Factory, tmp_path: Path) -> Path:
    path = tmp_path / "whole.safetensors"
    save_network(tiny_network(), path, INFO)
    return path


def rewrite(
    path: Path,
    tensors: Callable[[dict[str, Tensor]], object] = lambda _: None,
    config: Callable[[dict[str, Any]], object] = lambda _: None,
    **metadata: str,
) -> None:
    """Change a checkpoint's tensors, its network configuration, or its metadata."""
    with safe_open(path, framework="pt") as file:
        header = dict(file.metadata())
        state = {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118
    tensors(state)
    values = json.loads(header["config"])
    config(values)
    save_file(state, path, {**header, "config": json.dumps(values), **metadata})


def random_bytes(path: Path) -> None:
    path.write_bytes(torch.arange(4096).to(torch.uint8).numpy().tobytes())


def lightning_checkpoint(path: Path) -> None:
    torch.save({"state_dict": {"network.x": torch.zeros(3)}, "global_step": 5}, path)


def truncated(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-1000])


def empty(path: Path) -> None:
    path.write_bytes(b"")


def other_safetensors(path: Path) -> None:
    save_file({"x": torch.zeros(3)}, path)


@pytest.mark.parametrize(
    "damage", [random_bytes, lightning_checkpoint, truncated, empty, other_safetensors]
)
def test_what_is_no_checkpoint(whole: Path, damage: Callable[[Path], None]) -> None:
    damage(whole)
    with pytest.raises(TFLabError) as caught:
        load_network(whole)
    message = str(caught.value)
    assert message.startswith(f"{whole}: ")
    assert "not a checkpoint of tf_lab" in message
    assert "\n" not in message


@pytest.mark.parametrize(
    "change",
    [
        {"config": lambda c: c.update(unheard_of=1)},
        {"config": lambda c: c.pop("width")},
        {"config": lambda c: c.update(width=24)},
        {"config": lambda c: c.update(fusion="foo")},
        {"config": lambda c: c["encoder"].pop("coarse_channels")},
        {"config": lambda c: c["encoder"].update(blocks=3)},
        {"tensors": lambda t: t.pop(sorted(t)[0])},
        {"tensors": lambda t: t.update(extra=torch.zeros(1))},
        {"info": "{cut"},
    ],
)
def test_a_checkpoint_of_another_network_or_version(whole: Path, change: dict[str, Any]) -> None:
    rewrite(whole, **change)
    with pytest.raises(TFLabError) as caught:
        load_network(whole)
    message = str(caught.value)
    assert message.startswith(f"{whole}: ")
    assert "another version or another network" in message
    assert "train it again" in message
    assert len(message) < len(str(whole)) + 300
    assert "\n" not in message


def test_a_missing_checkpoint(tmp_path: Path) -> None:
    for path in (tmp_path / "none.safetensors", tmp_path):
        with pytest.raises(TFLabError, match="no such checkpoint; train one with"):
            load_network(path)


def test_the_folder_of_a_training(tmp_path: Path) -> None:
    """Is taken for the checkpoint in it, as `init` takes it."""
    shutil.copy(shipped_checkpoint(), tmp_path / "model.safetensors")
    network, _ = load_network(tmp_path)
    named, _ = load_network(shipped_checkpoint())
    assert all(map(torch.equal, network.state_dict().values(), named.state_dict().values()))


def test_other_stereo_than_it_was_trained_with(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Depth maps are then not what the weights are for; that of the shipped one is the same."""
    network, info = load_network(shipped_checkpoint())
    assert not caplog.records
    info["training"]["config"]["content"]["stereo"] = "another"
    save_network(network, tmp_path / "model.safetensors", info)
    load_network(tmp_path)
    assert "trained with depth by another stereo" in caplog.text


def test_where_shipped_files_lie() -> None:
    """In the package itself, so that an installed wheel has them."""
    import tf_lab

    package = Path(tf_lab.__file__).parent
    assert shipped_checkpoint() == package / "weights" / "tiny.safetensors"
    maps = {k: v for k, v in MAPS.items() if k != "pyramid_channels"} | {"weights": "rooms"}
    lite0, resnet = EfficientNetLite0Settings(**maps), ResNetSettings(**maps)
    weights = package / "weights"
    assert our_encoder(lite0, "small") == weights / "efficientnet_lite0-encoder.safetensors"
    assert our_encoder(resnet, "small") == weights / "small-encoder.safetensors"
    assert our_encoder(replace(lite0, weights="shipped"), "small") == shipped_checkpoint()


def test_a_checkpoint_of_another_version_reconstructs_as_it_did(box_scene: Path) -> None:
    """Its file was written, and these numbers found, by the code of commit 4e34998.

    With images whose sides the strides divide: in others that code sampled beside the features.
    """
    network, info = load_network(Path(__file__).parent / "of_4e34998.safetensors")
    assert info == {"commit": "4e34998"}
    assert network.config.fusion == {"strategy": "transformer"}
    scene = Scene(box_scene)
    images = Resized(scene, (80, 64))
    for select, faces, area, fscore in (
        ("attention", 11073, 9.406441471454329, 0.10622796815616982),
        ("random", 9861, 8.394265368002056, 0.09742011608737107),
    ):
        settings = ReconstructionSettings(views=4, select=select, resolution=0.05, logits="float32")
        r = Reconstructor(network, settings)
        for i in range(20):
            r.add_frame(images.image(i), images.K[i], images.world_T_cam[i])
        mesh = r.mesh()
        assert len(mesh.faces) == pytest.approx(faces, rel=1e-3)  # another CPU rounds otherwise
        assert mesh.area == pytest.approx(area, rel=1e-3)
        assert evaluate_scene(mesh, scene.groundtruth)["fscore"] == pytest.approx(fscore, abs=1e-3)
