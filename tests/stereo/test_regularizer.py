"""What reads depth from a volume of scores: by hand where it can be, and on a known wall."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import save_file

from helpers.textured_wall import frame, wall_depth
from tf_lab.errors import TFLabError
from tf_lab.stereo import regularizer
from tf_lab.stereo.depth import SETTINGS, scores_of, small_view
from tf_lab.stereo.regularizer import (
    SHARPNESS,
    Regularizer,
    read_depth,
    shipped_regularizer,
)

INVERSE = torch.linspace(0.2, 2.5, 48)


def test_an_untrained_one_says_what_the_scores_say() -> None:
    scores = torch.rand(2, 48, 13, 19) * 2 - 1
    torch.testing.assert_close(Regularizer()(scores), SHARPNESS * scores)


@pytest.mark.parametrize("size", [(16, 24), (15, 20), (9, 7)])
def test_any_size_of_image(size: tuple[int, int]) -> None:
    """Rows and columns that fill up the network's scales go again."""
    torch.manual_seed(0)
    network = Regularizer()
    torch.nn.init.normal_(network.out.weight, std=0.1)
    scores = torch.rand(1, 8, *size)
    assert network(scores).shape == scores.shape


def test_a_pixel_stays_at_its_place() -> None:
    """What is said of a pixel depends most on its own scores."""
    torch.manual_seed(0)
    network = Regularizer()
    torch.nn.init.normal_(network.out.weight, std=0.1)
    scores = torch.rand(1, 8, 24, 32, requires_grad=True)
    for row, column in [(5, 9), (12, 20), (17, 13)]:
        (grad,) = torch.autograd.grad(network(scores)[0, 4, row, column], scores)
        reach = grad[0].abs().sum(0)
        assert reach.argmax() == row * 32 + column


def test_depth_is_read_about_the_likeliest_plane() -> None:
    likely = torch.full((48,), 1e-6)
    likely[[10, 11, 12, 30]] = torch.tensor([0.1, 0.5, 0.1, 0.3])
    depth, confidence = read_depth(likely.log().view(1, 48, 1, 1), INVERSE)
    mean = (0.1 * INVERSE[10] + 0.5 * INVERSE[11] + 0.1 * INVERSE[12]) / 0.7
    assert depth.item() == pytest.approx(1 / mean.item(), rel=1e-4)
    assert confidence.item() == pytest.approx(0.7, abs=1e-3)


def test_a_surface_between_two_planes() -> None:
    likely = torch.full((48,), 1e-9)
    likely[[20, 21]] = torch.tensor([0.25, 0.75])
    depth, _ = read_depth(likely.log().view(1, 48, 1, 1), INVERSE)
    between = 0.25 * INVERSE[20] + 0.75 * INVERSE[21]
    assert depth.item() == pytest.approx(1 / between.item(), rel=1e-4)


def test_the_shipped_one_fills_what_windows_leave_open() -> None:
    """A wall with a blank patch: scores there say nothing, depth is that of what is around it."""
    images = []
    for i in range(4):
        image, K, pose = frame(0.12 * i, 0.0, 80)
        left = round(40 + 80 * (0.2 - 0.12 * i) / 2)  # of a patch at 0.2 to 0.5 m, on the wall
        image[20:32, left : left + 12] = 128
        images.append(small_view(image, K, pose, 80))
    scores = torch.from_numpy(scores_of(images[3], images[:3], SETTINGS))[None]
    inverse = torch.from_numpy(SETTINGS.inverse).float()
    left = round(40 + 80 * (0.2 - 0.36) / 2)
    patch = (slice(22, 30), slice(left + 2, left + 10))
    truth = wall_depth(0.36, 0.0, 80)[patch]
    with torch.inference_mode():
        depth, _ = read_depth(shipped_regularizer()(scores), inverse)
    error = np.abs(depth[0].numpy()[patch] - truth) / truth
    raw = 1 / inverse[scores[0].argmax(0)].numpy()[patch]
    assert np.median(error) < 0.05 < np.median(np.abs(raw - truth) / truth)


def nothing(path: Path) -> None:
    assert not path.exists()


def text(path: Path) -> None:
    path.write_text("weights")


def of_another_network(path: Path) -> None:
    save_file({"weight": torch.ones(1)}, path)


@pytest.mark.parametrize("make", [nothing, text, of_another_network])
def test_weights_that_do_not_fit_are_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, make: Callable[[Path], None]
) -> None:
    path = tmp_path / "stereo.safetensors"
    make(path)
    monkeypatch.setattr(regularizer, "SHIPPED", path)
    with pytest.raises(TFLabError, match="install tf_lab again, or train it again") as caught:
        shipped_regularizer.__wrapped__()
    assert str(caught.value).startswith(f"{path}: ")
