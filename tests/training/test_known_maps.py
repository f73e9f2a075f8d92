"""A frozen encoder: it stays as it is, and encodes an image once."""

from collections.abc import Callable
from typing import Any

import pytest
import torch
from torch import Tensor, nn

from tf_lab.training.known_maps import KnownMaps


@pytest.fixture
def network(tiny_network: Callable[..., Any]) -> Any:
    return tiny_network()


def images(n: int, seed: int = 0) -> Tensor:
    generator = torch.Generator().manual_seed(seed)
    return torch.randint(0, 256, (n, 3, 24, 32), dtype=torch.uint8, generator=generator)


class Counting(nn.Module):
    """An encoder that counts the images it meets."""

    def __init__(self, encoder: nn.Module) -> None:
        super().__init__()
        self.encoder, self.met = encoder, 0

    def forward(self, x: Tensor) -> tuple[Tensor, Tensor]:
        self.met += len(x)
        return self.encoder(x)


def test_maps_are_the_encoders(network: Any) -> None:
    known = KnownMaps(network, 1 << 20)
    batch = images(4)
    with torch.no_grad():
        expected = network.encode(batch)
    for _ in range(2):  # encoded, then remembered
        for level, maps in known(batch).items():
            torch.testing.assert_close(maps, expected[level], rtol=1e-3, atol=1e-3)


def test_an_image_is_encoded_once(network: Any) -> None:
    counting = Counting(network.encoder)
    network.encoder = counting
    known = KnownMaps(network, 1 << 20)
    first = known(images(4))
    again = known(images(4).flip(0))
    assert counting.met == 4
    for level in first:
        assert torch.equal(first[level].flip(0), again[level])


def test_maps_do_not_depend_on_what_is_known_or_comes_along(network: Any) -> None:
    """Else a resumed training, which knows no map, would differ from an undisturbed one."""
    batch = images(7)
    expected = KnownMaps(network, 1 << 20)(batch)
    known = KnownMaps(network, 1 << 20)
    known(batch[2:4])
    for level, maps in known(batch).items():
        assert torch.equal(maps, expected[level])


def test_the_budget_bounds_what_is_kept_and_changes_no_map(network: Any) -> None:
    whole = KnownMaps(network, 1 << 20)
    expected = whole(images(6))
    some = KnownMaps(network, whole.nbytes // 2)
    some(images(6))
    assert 0 < some.nbytes <= whole.nbytes // 2
    for level, maps in some(images(6)).items():
        assert torch.equal(maps, expected[level])


def test_the_encoder_gets_no_gradient(network: Any) -> None:
    KnownMaps(network, 0)
    assert not any(p.requires_grad for p in network.encoder.parameters())
    assert any(p.requires_grad for p in network.parameters())
