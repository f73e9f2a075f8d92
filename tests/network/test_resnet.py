"""The ResNet encoder against ResNet-18's definition (He et al. 2016), and loading of weights."""

import json
from pathlib import Path
from typing import Any
from urllib.error import URLError

import pytest
import torch
import torch.nn.functional as F
from safetensors import safe_open
from safetensors.torch import load_file, save_file
from torch import Tensor

from tf_lab.config.build import build_network
from tf_lab.config.compose import compose_config
from tf_lab.errors import TFLabError
from tf_lab.network.checkpoint import load_network, save_network
from tf_lab.network.encoders import resnet
from tf_lab.network.encoders.pyramid import Encoder
from tf_lab.network.encoders.resnet import IMAGENET_URL, ResNet
from tf_lab.network.encoders.weights import load_encoder_weights, read_state_dict
from tf_lab.network.settings import NetworkConfig

RESNET18: dict[str, Any] = {
    "width": 64,
    "blocks": [2, 2, 2, 2],
    "stem_stride": 2,
    "stem_pool": True,
    "norm": "batch",
    "coarse_stride": 16,
    "fine_stride": 4,
    "coarse_channels": 32,
    "fine_channels": 24,
    "unit_norm": False,
}
SMALL: dict[str, Any] = {**RESNET18, "width": 8, "blocks": [1, 1, 1, 1]}
NOWHERE = Path("no such file")


def resnet18_shapes() -> dict[str, tuple[int, ...]]:
    """Name -> shape of every tensor of ResNet-18 but the classifier."""
    shapes: dict[str, tuple[int, ...]] = {}

    def norm(name: str, channels: int) -> None:
        for key in ("weight", "bias", "running_mean", "running_var"):
            shapes[f"{name}.{key}"] = (channels,)
        shapes[f"{name}.num_batches_tracked"] = ()

    shapes["conv1.weight"] = (64, 3, 7, 7)
    norm("bn1", 64)
    inputs = 64
    for stage, channels in enumerate((64, 128, 256, 512), 1):
        for block in range(2):
            prefix = f"layer{stage}.{block}"
            shapes[f"{prefix}.conv1.weight"] = (channels, inputs, 3, 3)
            norm(f"{prefix}.bn1", channels)
            shapes[f"{prefix}.conv2.weight"] = (channels, channels, 3, 3)
            norm(f"{prefix}.bn2", channels)
            if inputs != channels:
                shapes[f"{prefix}.downsample.0.weight"] = (channels, inputs, 1, 1)
                norm(f"{prefix}.downsample.1", channels)
            inputs = channels
    return shapes


def backbone(encoder: Encoder) -> dict[str, Tensor]:
    extra = ("lateral.", "coarse_head.", "fine_head.")
    return {k: v for k, v in encoder.state_dict().items() if not k.startswith(extra)}


def noise(encoder: Encoder) -> dict[str, Tensor]:
    """A state dict that fits the encoder's backbone and isn't what it has."""
    torch.manual_seed(11)
    return {
        k: torch.randn_like(v) if v.is_floating_point() else v + 1
        for k, v in backbone(encoder).items()
    }


def assert_loaded(encoder: Encoder, expected: dict[str, Tensor]) -> None:
    for key, value in backbone(encoder).items():
        assert torch.equal(value, expected[key]), key


def test_the_backbone_is_resnet18_by_name_and_shape() -> None:
    shapes = {k: tuple(v.shape) for k, v in backbone(ResNet(**RESNET18)).items()}
    assert shapes == resnet18_shapes()
    # 11,689,512 parameters are published for ResNet-18, of which 512 x 1000 + 1000 classify
    buffers = ("running_mean", "running_var", "num_batches_tracked")
    learnt = [torch.Size(s).numel() for k, s in shapes.items() if not k.endswith(buffers)]
    assert sum(learnt) == 11_689_512 - 513_000


def test_the_stages_compute_resnet18() -> None:
    """The forward pass, written out with functional calls on the state dict."""
    torch.manual_seed(0)
    encoder = ResNet(**{**SMALL, "blocks": [2, 1, 1, 1]}).eval()
    state = encoder.state_dict()

    def norm(x: Tensor, name: str) -> Tensor:
        s = [state[f"{name}.{k}"] for k in ("running_mean", "running_var", "weight", "bias")]
        return F.batch_norm(x, *s)

    def block(x: Tensor, name: str, stride: int) -> Tensor:
        out = F.conv2d(x, state[f"{name}.conv1.weight"], stride=stride, padding=1)
        out = F.conv2d(norm(out, f"{name}.bn1").relu(), state[f"{name}.conv2.weight"], padding=1)
        if f"{name}.downsample.0.weight" in state:
            x = F.conv2d(x, state[f"{name}.downsample.0.weight"], stride=stride)
            x = norm(x, f"{name}.downsample.1")
        return (norm(out, f"{name}.bn2") + x).relu()

    seen: dict[str, Tensor] = {}
    for i in range(1, 5):
        encoder.get_submodule(f"layer{i}").register_forward_hook(
            lambda _m, _i, out, key=f"layer{i}": seen.update({key: out})
        )
    images = torch.randn(2, 3, 64, 96)
    with torch.no_grad():
        encoder.stages(images)
        x = F.conv2d(images, state["conv1.weight"], stride=2, padding=3)
        x = F.max_pool2d(norm(x, "bn1").relu(), 3, 2, 1)
        for name, count in (("layer1", 2), ("layer2", 1), ("layer3", 1), ("layer4", 1)):
            for i in range(count):
                x = block(x, f"{name}.{i}", 2 if name != "layer1" and i == 0 else 1)
            torch.testing.assert_close(seen[name], x)


@pytest.mark.parametrize(
    ("changes", "coarse", "fine"),
    [
        ({}, 16, 4),
        ({"coarse_stride": 32}, 32, 4),
        ({"coarse_stride": 8, "fine_stride": 8}, 8, 8),
        ({"stem_pool": False, "coarse_stride": 8, "fine_stride": 2}, 8, 2),
        ({"stem_pool": False, "stem_stride": 1, "coarse_stride": 4, "fine_stride": 1}, 4, 1),
        ({"norm": "group", "unit_norm": True}, 16, 4),
    ],
)
def test_strides_and_channels(changes: dict[str, Any], coarse: int, fine: int) -> None:
    torch.manual_seed(0)
    encoder = ResNet(**{**SMALL, **changes})
    maps = encoder(torch.rand(2, 3, 64, 96) * 255)
    assert maps[0].shape == (2, 32, 64 // coarse, 96 // coarse)
    assert maps[1].shape == (2, 24, 64 // fine, 96 // fine)
    if changes.get("unit_norm"):
        torch.testing.assert_close(
            maps[1].square().sum(1), torch.full((2, 16, 24), 24.0), rtol=1e-4, atol=0
        )


def test_sizes_that_the_stride_does_not_divide() -> None:
    maps = ResNet(**SMALL)(torch.rand(1, 3, 60, 81) * 255)
    assert maps[0].shape[-2:] == (4, 6)  # a convolution of stride 2 rounds up
    assert maps[1].shape[-2:] == (15, 21)


@pytest.mark.parametrize("changes", [{"coarse_stride": 5}, {"fine_stride": 2}, {"fine_stride": 32}])
def test_strides_that_no_stage_has(changes: dict[str, int]) -> None:
    with pytest.raises(TFLabError, match="stride"):
        ResNet(**{**SMALL, **changes})


def test_images_are_normalised_as_imagenets() -> None:
    images = torch.tensor([0, 255], dtype=torch.uint8).view(2, 1, 1, 1).expand(2, 3, 2, 2)
    black, white = ResNet(**SMALL).normalise(images)[:, :, 0, 0].tolist()
    assert black == pytest.approx([-0.485 / 0.229, -0.456 / 0.224, -0.406 / 0.225])
    assert white == pytest.approx([0.515 / 0.229, 0.544 / 0.224, 0.594 / 0.225])


def test_none_changes_nothing() -> None:
    encoder = ResNet(**SMALL)
    before = {k: v.clone() for k, v in backbone(encoder).items()}
    load_encoder_weights(encoder, "none", NOWHERE)
    assert_loaded(encoder, before)


@pytest.mark.parametrize("suffix", [".pth", ".safetensors"])
def test_a_file_of_weights(tmp_path: Path, suffix: str) -> None:
    encoder, path = ResNet(**SMALL), tmp_path / f"weights{suffix}"
    state = noise(encoder)
    classifier = {"fc.weight": torch.zeros(1000, 64), "fc.bias": torch.zeros(1000)}
    if suffix == ".pth":
        torch.save({**state, **classifier}, path)  # the classifier is passed over
    else:
        save_file(state, path)
    load_encoder_weights(encoder, str(path), NOWHERE)
    assert_loaded(encoder, state)


def test_the_shipped_file(tmp_path: Path) -> None:
    encoder, path = ResNet(**SMALL), tmp_path / "rooms.safetensors"
    with pytest.raises(TFLabError, match=r"rooms\.safetensors does not ship"):
        load_encoder_weights(encoder, "rooms", path)
    state = noise(encoder)
    save_file(state, path)
    load_encoder_weights(encoder, "rooms", path)
    assert_loaded(encoder, state)


def test_weights_of_another_architecture(tmp_path: Path) -> None:
    path = tmp_path / "wide.pth"
    torch.save(noise(ResNet(**{**SMALL, "width": 16})), path)
    with pytest.raises(TFLabError, match="do not fit"):
        load_encoder_weights(ResNet(**SMALL), str(path), NOWHERE)
    deep = tmp_path / "deep.pth"
    torch.save(noise(ResNet(**{**SMALL, "blocks": [2, 1, 1, 1]})), deep)
    with pytest.raises(TFLabError, match=r"do not fit.*layer1\.1"):
        load_encoder_weights(ResNet(**SMALL), str(deep), NOWHERE)


@pytest.mark.parametrize("name", ["weights.pth", "weights.safetensors"])
def test_a_file_that_holds_no_weights(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    with pytest.raises(TFLabError, match="no such weights file"):
        read_state_dict(path)
    path.write_bytes(b"this is not a file of weights" * 10)
    with pytest.raises(TFLabError, match=f"{name}: not a weights file"):
        load_encoder_weights(ResNet(**SMALL), str(path), NOWHERE)


def test_a_torch_file_of_something_else(tmp_path: Path) -> None:
    path = tmp_path / "tensor.pth"
    torch.save(torch.zeros(3), path)
    with pytest.raises(TFLabError, match=r"tensor\.pth: not a weights file"):
        load_encoder_weights(ResNet(**SMALL), str(path), NOWHERE)


def test_weights_that_lack_layers(tmp_path: Path) -> None:
    """Nothing but the pyramid may stay random without a word."""
    state = noise(ResNet(**SMALL))
    path = tmp_path / "part.pth"
    torch.save({k: v for k, v in state.items() if not k.startswith("layer3")}, path)
    with pytest.raises(TFLabError, match="layer3"):
        load_encoder_weights(ResNet(**SMALL), str(path), NOWHERE)


@pytest.fixture
def hub(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty hub cache and no network; returns where the file of weights belongs."""

    def offline(url: str, *_args: Any, **_kwargs: Any) -> None:
        raise URLError("no network")

    monkeypatch.setattr(torch.hub, "get_dir", lambda: str(tmp_path))
    monkeypatch.setattr(torch.hub, "download_url_to_file", offline)
    return tmp_path / "checkpoints" / IMAGENET_URL.rsplit("/", 1)[1]


def test_imagenet_offline(hub: Path) -> None:
    with pytest.raises(TFLabError) as caught:
        load_encoder_weights(ResNet(**RESNET18), "imagenet", NOWHERE)
    message = str(caught.value)
    assert IMAGENET_URL in message  # what is missing,
    assert str(hub) in message  # where to put it,
    assert "encoder.weights=none" in message  # and what else to do
    assert not list(hub.parent.iterdir())


def test_imagenet_from_the_cache(hub: Path) -> None:
    encoder = ResNet(**RESNET18)
    state = noise(encoder)
    hub.parent.mkdir()
    torch.save({**state, "fc.weight": torch.zeros(1000, 512)}, hub)
    load_encoder_weights(encoder, "imagenet", NOWHERE)
    assert_loaded(encoder, state)


def test_a_damaged_download_is_not_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its name says how the hash of its content begins."""
    source = tmp_path / "resnet18-f37072fd.pth"
    source.write_bytes(b"half of it")
    monkeypatch.setattr(torch.hub, "get_dir", lambda: str(tmp_path / "hub"))
    monkeypatch.setattr(resnet, "IMAGENET_URL", source.as_uri())
    with pytest.raises(TFLabError, match="invalid hash"):
        load_encoder_weights(ResNet(**RESNET18), "imagenet", NOWHERE)
    assert not list((tmp_path / "hub" / "checkpoints").iterdir())


def test_a_checkpoint_from_before_encoders_had_names(tmp_path: Path) -> None:
    """Bit by bit what the encoder of its time made, written out here."""
    path = tmp_path / "model.safetensors"
    made = build_network(compose_config("train", "encoder.weights=rooms"))
    save_network(made, path, {})
    with safe_open(path, framework="pt") as file:
        config = json.loads(file.metadata()["config"])
    assert config["encoder"].pop("name") == "resnet"
    save_file(load_file(path), path, {"config": json.dumps(config), "info": "{}"})
    network, _ = load_network(path)
    state = network.encoder.state_dict()
    images = torch.randint(
        0, 256, (2, 3, 60, 80), dtype=torch.uint8, generator=torch.Generator().manual_seed(0)
    )

    def convolve(x: Tensor, name: str, stride: int = 1, padding: int = 1) -> Tensor:
        return F.conv2d(x, state[f"{name}.weight"], state.get(f"{name}.bias"), stride, padding)

    def norm(x: Tensor, name: str) -> Tensor:
        groups = x.shape[1] // 8
        return F.group_norm(x, groups, state[f"{name}.weight"], state[f"{name}.bias"])

    def block(x: Tensor, name: str, stride: int) -> Tensor:
        out = F.relu(norm(convolve(x, f"{name}.conv1", stride), f"{name}.bn1"))
        if stride > 1:
            x = norm(convolve(x, f"{name}.downsample.0", stride, 0), f"{name}.downsample.1")
        return F.relu(norm(convolve(out, f"{name}.conv2"), f"{name}.bn2") + x)

    with torch.no_grad():
        mean, std = (
            torch.tensor(x).view(3, 1, 1) for x in ((0.485, 0.456, 0.406), (0.229, 0.224, 0.225))
        )
        x = ((images.float() / 255 - mean) / std).contiguous(memory_format=torch.channels_last)
        x = F.relu(norm(convolve(x, "conv1", 2, 3), "bn1"))
        stages = []
        for i in range(4):
            x = block(x, f"layer{i + 1}.0", 1 if i == 0 else 2)
            stages.append(x)
        tops = [convolve(stages[3], "lateral.3", padding=0)]
        for i in (2, 1, 0):
            side = convolve(stages[i], f"lateral.{i}", padding=0)
            tops.append(side + F.interpolate(tops[-1], size=side.shape[-2:], mode="nearest"))
        found = network.encode(images)
        for level, top in (("coarse", tops[1]), ("fine", tops[3])):
            expected = F.normalize(convolve(top, f"{level}_head"), dim=1) * 32**0.5
            assert torch.equal(found[level], expected)


@pytest.mark.parametrize("pool", [True, False])
@pytest.mark.parametrize("stage", range(4))
def test_a_pixel_of_a_stage_looks_at_its_own_place(stage: int, pool: bool) -> None:
    """By the centre of the image pixels that it depends on: within a quarter of its stride.

    Torchvision's padding looks (stride - 1) / 2 beside it.
    """

    def centre(centered: bool) -> float:
        encoder = ResNet(**{**SMALL, "coarse_stride": stride, "fine_stride": stride,
                            "stem_pool": pool, "centered": centered}).eval()  # fmt: skip
        for module in encoder.modules():
            if isinstance(module, torch.nn.Conv2d):  # an average
                torch.nn.init.constant_(module.weight, 1 / module.weight[0].numel())
        images = torch.rand(1, 3, 256, 256, requires_grad=True)
        row = 128 // stride
        encoder.stages(images)[stage][0, :, row, row].sum().backward()
        assert images.grad is not None
        touched = images.grad[0].abs().sum((0, 1)).nonzero()
        assert touched.min() > 0 and touched.max() < 255
        return float(touched.min() + touched.max()) / 2 - ((row + 0.5) * stride - 0.5)

    stride = 2 ** (stage + 1 + pool)
    assert centre(False) == pytest.approx((1 - stride) / 2, abs=1)  # of a pool one pixel has it all
    assert abs(centre(True)) <= stride / 4 + pool


def test_a_checkpoint_of_before_is_not_centered() -> None:
    config = NetworkConfig(
        width=8, blocks=1, heads=1, expansion=1, hidden=8, refine_blocks=1, encoder=SMALL
    )
    assert config.encoder == {**SMALL, "centered": False}
