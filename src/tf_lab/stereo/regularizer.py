"""The scores of a plane sweep made whole by a small 3D CNN (cost volume regularisation, learnt).

A window that matches at many depths, or at none, says nothing; its neighbours do. MVSNet (Yao et
al. 2018) lets a 3D CNN read the whole volume of scores. This one sees scores alone, no image: what
photographs and rendered rooms look like differs more than how their scores do.
"""

from __future__ import annotations

import functools
import textwrap
from pathlib import Path

import torch
import torch.nn.functional as F
from safetensors import SafetensorError
from safetensors.torch import load_file
from torch import Tensor, nn

from tf_lab.errors import TFLabError

SHIPPED = Path(__file__).resolve().parents[1] / "weights" / "stereo.safetensors"
CHANNELS = (16, 32, 48)  # of the three scales
FOLD = 2  # pixels a side that become channels of one
MULTIPLE = FOLD * 4  # of rows and columns (and 4 of planes) at the coarsest scale
WINDOW = 2  # planes to each side of the best one that are still the same surface
SHARPNESS = 3.0  # of the scores themselves, before anything is learnt


def _convolution(inputs: int, outputs: int, stride: int = 1) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv3d(inputs, outputs, 3, stride, padding=1, bias=False),
        nn.GroupNorm(outputs // 8, outputs),
        nn.ReLU(inplace=True),
    )


class Regularizer(nn.Module):
    """A 3D U-Net over planes, rows and columns, beside the scores as they are.

    Its finest scale has a quarter of the pixels, as channels (pixel unshuffle): most of what
    convolutions at the full size would cost.
    """

    def __init__(self) -> None:
        super().__init__()
        fine, middle, coarse = CHANNELS
        pixels = FOLD * FOLD
        self.fine = nn.Sequential(_convolution(pixels, fine), _convolution(fine, fine))
        self.middle = nn.Sequential(_convolution(fine, middle, 2), _convolution(middle, middle))
        self.coarse = nn.Sequential(
            _convolution(middle, coarse, 2),
            _convolution(coarse, coarse),
            _convolution(coarse, coarse),
        )
        self.up_middle = _convolution(coarse + middle, middle)
        self.up_fine = _convolution(middle + fine, fine)
        self.out = nn.Conv3d(fine, pixels, 3, padding=1)
        nn.init.zeros_(self.out.weight)
        nn.init.zeros_(self.out.bias)  # type: ignore[arg-type]
        self.sharpness = nn.Parameter(torch.tensor(SHARPNESS))

    def forward(self, scores: Tensor) -> Tensor:
        """Scores [B, P, H, W] in -1..1 of P planes (a multiple of 4) -> logits of that shape."""
        height, width = scores.shape[-2:]
        padding = (0, -width % MULTIPLE, 0, -height % MULTIPLE)
        volume = _fold(F.pad(scores, padding, mode="replicate"))
        fine = self.fine(volume)
        middle = self.middle(fine)
        coarse = self.coarse(middle)
        middle = self.up_middle(torch.cat([_upsampled(coarse, middle), middle], dim=1))
        fine = self.up_fine(torch.cat([_upsampled(middle, fine), fine], dim=1))
        change = _unfold(self.out(fine))[..., :height, :width]
        return change + self.sharpness * scores


def _fold(scores: Tensor) -> Tensor:
    """[B, P, H, W] -> [B, 4, P, H / 2, W / 2]."""
    return F.pixel_unshuffle(scores.unsqueeze(2), FOLD).transpose(1, 2)


def _unfold(volume: Tensor) -> Tensor:
    return F.pixel_shuffle(volume.transpose(1, 2), FOLD).squeeze(2)


def _upsampled(volume: Tensor, like: Tensor) -> Tensor:
    return F.interpolate(volume, size=like.shape[-3:], mode="nearest")


def read_depth(logits: Tensor, inverse: Tensor) -> tuple[Tensor, Tensor]:
    """What logits of planes say.

    Args:
        logits: [B, P, H, W].
        inverse: inverse depths [P] of the planes, 1 / metres.

    Returns:
        Depth [B, H, W], metres: the mean inverse depth about the likeliest plane; and its
        confidence: the probability of the planes that the mean is over. Where no source sees a
        pixel, both are what its surroundings make likely.
    """
    likely = logits.float().softmax(dim=1)
    planes = torch.arange(len(inverse), device=logits.device).view(1, -1, 1, 1)
    near = (planes - likely.argmax(dim=1, keepdim=True)).abs() <= WINDOW
    likely = likely * near
    confidence = likely.sum(dim=1)
    return confidence / torch.einsum("bphw,p->bhw", likely, inverse), confidence


@functools.cache
def shipped_regularizer() -> Regularizer:
    """The one that comes with the package (`python -m tf_lab.pretrain_stereo` makes it).

    Raises:
        TFLabError: the file is missing, or of another network.
    """
    network = Regularizer()
    try:
        network.load_state_dict(load_file(SHIPPED))
    except (OSError, SafetensorError, RuntimeError) as error:
        reason = textwrap.shorten(str(error), 160)
        raise TFLabError(
            f"{SHIPPED}: not what `python -m tf_lab.pretrain_stereo` makes ({reason}); install "
            "tf_lab again, or train it again"
        ) from error
    return network.eval().requires_grad_(False)
