"""The paper's literal procedure and lazy fusion come to the same."""

from typing import Any

import pytest
import torch

from helpers.online.scenes import (
    FRAMES,
    Factory,
    add,
    assert_same_surface,
    balanced,
    settings_of,
    trained_to_match,
)
from tf_lab.benchmarks.eager import EagerReconstructor
from tf_lab.data.scene import Scene
from tf_lab.online.reconstructor import Reconstructor

BOTH = {"matching": True, "stereo": True}


@pytest.mark.parametrize(
    ("select", "views", "logits", "inputs"),
    [
        ({"select": "attention"}, 3, "float32", {}),
        ({"select": "attention"}, 3, "float16", {}),
        ({"select": "attention"}, 16, "float32", {"matching": True}),
        ({"select": "attention"}, 3, "float32", {"matching": True}),
        ({"select": "random", "seed": 4}, 3, "float32", {}),
        ({"select": {"policy": "diverse", "spread": 0.5}, "seed": 1}, 3, "float16", BOTH),
    ],
)
def test_lazy_equals_eager(
    tiny_network: Factory,
    scene: Scene,
    select: dict[str, Any],
    views: int,
    logits: str,
    inputs: dict[str, bool],
) -> None:
    network = balanced(trained_to_match(tiny_network(**inputs)), scene)
    settings = settings_of(views=views, logits=logits, **select)
    lazy = add(Reconstructor(network, settings), scene)
    eager = add(EagerReconstructor(network, settings), scene)
    a, b = lazy.mesh(color=False), eager.mesh(color=False)

    assert torch.equal(lazy.coarse.blocks.coords, eager.coarse.blocks.coords)
    assert torch.equal(lazy.coarse.store.frames, eager.coarse.store.frames)
    assert lazy.coarse.store.seen.max() == len(FRAMES)
    every = lazy.fine.blocks.voxels(torch.arange(lazy.fine.blocks.rows))
    rows = eager.fine.blocks.row_of(every)
    assert (rows >= 0).all()  # what is near now was near at the last frame
    assert torch.equal(eager.fine.store.frames[rows], lazy.fine.store.frames)

    shown = lazy.fine.features["shown"]
    assert torch.equal(eager.fine.features["shown"][rows], shown)
    assert eager.fine.features["shown"].sum() == shown.sum()
    values = [lazy.fine.features["values"], eager.fine.features["values"][rows]]
    probability = [torch.sigmoid(v[shown]) for v in values]
    assert len(probability[0]) > 300
    assert (probability[0] - probability[1]).abs().max() < 1e-4
    assert_same_surface(a, b)


def test_eager_fuses_at_every_frame(tiny_network: Factory, scene: Scene) -> None:
    """The transformer has nothing left to do when the mesh is asked for."""
    network = balanced(tiny_network(), scene)
    eager = add(EagerReconstructor(network, settings_of(views=3)), scene)
    fused: list[int] = []
    network.fusion["coarse"].register_forward_hook(lambda _m, _i, out: fused.append(len(out[0])))
    eager.mesh(color=False)
    assert sum(fused) == 0
    lazy = add(Reconstructor(network, settings_of(views=3)), scene)
    assert sum(fused) == 0
    lazy.mesh(color=False)
    assert sum(fused) == (lazy.coarse.store.seen > 0).sum()
