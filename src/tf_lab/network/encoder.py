"""The 2D convolutional encoder Theta: an image to coarse and fine feature maps (paper, Sec. 3).

A ResNet (He et al. 2016) of basic blocks with torchvision's state-dict keys, so that torchvision's
ImageNet weights load as they are, and a light top-down pyramid (Lin et al. 2017). The paper does
not say which layers give the features; the strides are config values (1/16 and 1/4 at paper size).
"""

from __future__ import annotations

import functools
import hashlib
import os
from collections.abc import Sequence
from pathlib import Path

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from tf_lab.errors import TFLabError

IMAGENET_URL = "https://download.pytorch.org/models/resnet18-f37072fd.pth"
MEAN, STD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)


@functools.cache  # sent to a GPU once
def _statistics(device: torch.device) -> tuple[Tensor, Tensor]:
    with torch.inference_mode(False):
        mean, std = (torch.tensor(x, device=device).view(3, 1, 1) for x in (MEAN, STD))
        return mean, std


def normalise_images(images: Tensor) -> Tensor:
    """uint8 or float RGB in 0..255 [N, 3, H, W] to ImageNet's mean 0 and deviation 1."""
    mean, std = _statistics(images.device)
    return (images.float() / 255 - mean) / std


def _norm(kind: str, channels: int) -> nn.Module:
    if kind == "batch":
        return nn.BatchNorm2d(channels)
    return nn.GroupNorm(max(1, channels // 8), channels)


class BasicBlock(nn.Module):
    """Two 3x3 convolutions with a residual connection; names as in torchvision."""

    def __init__(self, inputs: int, channels: int, stride: int, norm: str) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(inputs, channels, 3, stride, 1, bias=False)
        self.bn1 = _norm(norm, channels)
        self.conv2 = nn.Conv2d(channels, channels, 3, 1, 1, bias=False)
        self.bn2 = _norm(norm, channels)
        self.downsample: nn.Module | None = None
        if stride != 1 or inputs != channels:
            self.downsample = nn.Sequential(
                nn.Conv2d(inputs, channels, 1, stride, bias=False), _norm(norm, channels)
            )

    def forward(self, x: Tensor) -> Tensor:
        """[N, inputs, h, w] -> [N, channels, h / stride, w / stride]."""
        identity = x if self.downsample is None else self.downsample(x)
        out = F.relu(self.bn1(self.conv1(x)))
        return F.relu(self.bn2(self.conv2(out)) + identity)


class Encoder(nn.Module):
    """ResNet and pyramid.

    Args:
        width: channels of the stem (64 in ResNet-18); doubled at every stage.
        blocks: basic blocks of the four stages ((2, 2, 2, 2) is ResNet-18).
        stem_stride: stride of the first convolution (2 in ResNet-18).
        stem_pool: whether a 3x3 max-pooling of stride 2 follows (True in ResNet-18).
        norm: "batch" (as ImageNet weights need it) or "group" (for small batches).
        coarse_stride, fine_stride: strides of the two outputs; must be strides that a stage has.
        coarse_channels, fine_channels: their channels.
        unit_norm: scale every feature vector to length sqrt(channels).
    """

    def __init__(
        self,
        width: int,
        blocks: Sequence[int],
        stem_stride: int,
        stem_pool: bool,
        norm: str,
        coarse_stride: int,
        fine_stride: int,
        coarse_channels: int,
        fine_channels: int,
        unit_norm: bool,
    ) -> None:
        super().__init__()
        self.unit_norm = unit_norm
        self.conv1 = nn.Conv2d(3, width, 7, stem_stride, 3, bias=False)
        self.bn1 = _norm(norm, width)
        self.pool = nn.MaxPool2d(3, 2, 1) if stem_pool else nn.Identity()
        stride = stem_stride * (2 if stem_pool else 1)
        self.strides: list[int] = []
        channels = [width]
        for i, count in enumerate(blocks):
            step = 1 if i == 0 else 2
            stride *= step
            self.strides.append(stride)
            layers = [BasicBlock(channels[-1], width * 2**i, step, norm)]
            layers += [BasicBlock(width * 2**i, width * 2**i, 1, norm) for _ in range(count - 1)]
            channels.append(width * 2**i)
            self.add_module(f"layer{i + 1}", nn.Sequential(*layers))
        for name, wanted in (("coarse_stride", coarse_stride), ("fine_stride", fine_stride)):
            if wanted not in self.strides:
                raise TFLabError(f"encoder.{name}={wanted}: the stages have {self.strides}")
        self.coarse_level = self.strides.index(coarse_stride)
        self.fine_level = self.strides.index(fine_stride)
        if self.fine_level > self.coarse_level:
            raise TFLabError("encoder.fine_stride must not exceed encoder.coarse_stride")
        pyramid = max(fine_channels, coarse_channels)
        self.lateral = nn.ModuleList(
            nn.Conv2d(c, pyramid, 1) for c in channels[self.fine_level + 1 :]
        )
        self.coarse_head = nn.Conv2d(pyramid, coarse_channels, 3, padding=1)
        self.fine_head = nn.Conv2d(pyramid, fine_channels, 3, padding=1)

    def forward(self, images: Tensor) -> tuple[Tensor, Tensor]:
        """Normalised images [N, 3, H, W] -> coarse [N, Cc, h, w] and fine [N, Cf, h', w'] maps."""
        x = self.pool(F.relu(self.bn1(self.conv1(images))))
        stages = []
        for i in range(len(self.strides)):
            x = getattr(self, f"layer{i + 1}")(x)
            stages.append(x)
        top: Tensor | None = None
        coarse = fine = x
        for level in reversed(range(self.fine_level, len(stages))):
            side = self.lateral[level - self.fine_level](stages[level])
            if top is not None:
                side = side + F.interpolate(top, size=side.shape[-2:], mode="nearest")
            top = side
            if level == self.coarse_level:
                coarse = self.coarse_head(top)
            if level == self.fine_level:
                fine = self.fine_head(top)
        if self.unit_norm:
            coarse = F.normalize(coarse, dim=1) * coarse.shape[1] ** 0.5
            fine = F.normalize(fine, dim=1) * fine.shape[1] ** 0.5
        return coarse, fine


def load_encoder_weights(encoder: Encoder, source: str, shipped: Path) -> None:
    """Initialise an encoder.

    Args:
        encoder: changed in place.
        source: "none" (random), "imagenet" (torchvision's ResNet-18, downloaded once into torch's
            hub cache), "rooms" (ours, pre-trained on the rooms' train split, ``shipped``), or a
            path to a state dict (.pth with torchvision's keys, or .safetensors).
        shipped: the file behind "rooms" for this model size.

    Raises:
        TFLabError: no weights can be had, or they are of another architecture.
    """
    if source == "none":
        return
    if source == "imagenet":
        state = _imagenet_weights()
    elif source == "rooms":
        if not shipped.is_file():
            raise TFLabError(
                f"encoder.weights=rooms: {shipped.name} does not ship with tf_lab; make it with "
                f"`python -m tf_lab.pretrain model={shipped.stem.removesuffix('-encoder')}` and "
                "give the file that it names (encoder.weights=FILE), or use encoder.weights=none"
            )
        state = read_state_dict(shipped)
    else:
        state = read_state_dict(Path(source))
    state = {k: v for k, v in state.items() if not k.startswith("fc.")}
    own = encoder.state_dict()
    unknown = [k for k, v in state.items() if k not in own or own[k].shape != v.shape]
    if unknown:
        raise TFLabError(
            f"encoder.weights={source}: {len(unknown)} tensors do not fit this encoder "
            f"(first: {unknown[0]}); use weights of the same encoder, or encoder.weights=none"
        )
    optional = ("lateral.", "coarse_head.", "fine_head.")  # the pyramid is ours
    missing = [k for k in own if k not in state and not k.startswith(optional)]
    missing = [k for k in missing if not k.endswith("num_batches_tracked")]
    if missing:
        raise TFLabError(
            f"encoder.weights={source}: {len(missing)} tensors of this encoder are missing "
            f"(first: {missing[0]}); use weights of the same encoder, or encoder.weights=none"
        )
    encoder.load_state_dict(state, strict=False)


def read_state_dict(path: Path) -> dict[str, Tensor]:
    """Tensors of a .safetensors file or of a weights-only torch file.

    Raises:
        TFLabError: the file is missing or is neither.
    """
    from safetensors.torch import load_file

    if not path.is_file():
        raise TFLabError(f"{path}: no such weights file")
    try:
        if path.suffix == ".safetensors":
            return load_file(path)
        state = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # both loaders raise many kinds
        raise TFLabError(f"{path}: not a weights file ({type(error).__name__})") from error
    if not isinstance(state, dict) or not all(isinstance(v, Tensor) for v in state.values()):
        raise TFLabError(f"{path}: not a weights file (it holds no dictionary of tensors)")
    return state


def _imagenet_weights() -> dict[str, Tensor]:
    """ResNet-18 weights of torchvision from torch's hub cache, else downloaded and verified."""
    from urllib.error import URLError

    path = Path(torch.hub.get_dir()) / "checkpoints" / IMAGENET_URL.rsplit("/", 1)[1]
    if not path.is_file():
        path.parent.mkdir(parents=True, exist_ok=True)
        partial = path.with_suffix(f".{os.getpid()}.partial")
        try:
            torch.hub.download_url_to_file(IMAGENET_URL, str(partial))
            digest = hashlib.sha256(partial.read_bytes()).hexdigest()
            if not digest.startswith(path.stem.rsplit("-", 1)[1]):
                raise TFLabError(f"{IMAGENET_URL}: the download is damaged; try again")
            partial.replace(path)
        except (URLError, OSError) as error:
            raise TFLabError(
                f"encoder.weights=imagenet: {IMAGENET_URL} cannot be downloaded ({error}); put the "
                f"file at {path}, or use encoder.weights=none"
            ) from error
        finally:
            partial.unlink(missing_ok=True)
    return read_state_dict(path)
