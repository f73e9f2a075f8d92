"""That nothing strays to another device, and how often adding a frame waits for the GPU."""

from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from helpers.online.pretended_gpu import CUDA, PretendedGpu, on_gpu
from helpers.online.scenes import FRAMES, Factory, add, assert_same_surface, balanced, settings_of
from helpers.toy_views import toy
from tf_lab.benchmarks.eager import EagerReconstructor
from tf_lab.config.groups import OptimizerSettings
from tf_lab.data.chunks import ChunkBatch
from tf_lab.data.scene import Scene
from tf_lab.network.agreement import Agreement
from tf_lab.network.tokens import Measurements
from tf_lab.online.reconstructor import Reconstructor
from tf_lab.online.views import POLICIES, make_policy
from tf_lab.online.views.batch import BatchSelection
from tf_lab.training.module import Training


@pytest.mark.parametrize(
    ("kind", "select", "masks"),
    [
        (Reconstructor, {"select": "attention"}, True),
        (Reconstructor, {"select": "random", "seed": 1}, False),
        (EagerReconstructor, {"select": "attention"}, True),
    ],
)
def test_all_work_is_done_on_the_networks_device(
    tiny_network: Factory,
    scene: Scene,
    kind: type[Reconstructor],
    select: dict[str, Any],
    masks: bool,
) -> None:
    network = balanced(tiny_network(filter=masks), scene)
    settings = settings_of(views=3, resolution=0.1, **select)
    expected = add(kind(network, settings), scene).mesh()
    with PretendedGpu():
        r = add(kind(on_gpu(network), settings), scene)
        assert r.device.type == "cuda"
        mesh = r.mesh()
        weights = r.view_weights(np.zeros((2, 3)), "coarse")[1]
    assert_same_surface(mesh, expected)
    assert weights.shape == (2, 3)


@pytest.mark.parametrize(
    "select", [{"select": "attention"}, {"select": "random", "seed": 1}, {"select": "diverse"}]
)
def test_adding_a_frame_waits_for_list_lengths_only(
    tiny_network: Factory, scene: Scene, select: dict[str, Any]
) -> None:
    """Known fine blocks, coarse voxels in view, new blocks, fine voxels in view: four lists."""
    network = balanced(tiny_network(), scene)
    with PretendedGpu() as gpu:
        r = add(Reconstructor(on_gpu(network), settings_of(views=3, **select)), scene)
        r.update()
        gpu.waits.clear()
        add(r, scene, FRAMES[:1])
        assert gpu.waits == {"__getitem__": 4}


@pytest.mark.parametrize("name", [policy.name for policy in POLICIES])
def test_choosing_and_comparing_views_in_training_waits_for_nothing(name: str) -> None:
    torch.manual_seed(0)
    valid, rays = torch.rand(30, 9) < 0.7, torch.randn(30, 9, 3)
    views = [torch.randn(30, 9, 8), torch.rand(30, 9), valid, rays, torch.zeros(30, 9, 0)]
    with PretendedGpu() as gpu:
        logits, *parts = (x.to(CUDA) for x in (torch.randn(30, 9, 2), *views))
        keys = torch.zeros(30, 3, dtype=torch.int64).to(CUDA)
        draws = torch.ones(1, dtype=torch.int64).to(CUDA)
        agreement = on_gpu(Agreement(8, 12))
        gpu.waits.clear()  # what follows is on the GPU
        kept, _ = BatchSelection(make_policy(name, 0), 4, draws)(logits, parts[2], parts[3], keys)
        told = agreement(Measurements(*parts))
        assert kept.device.type == told.device.type == "cuda"
        assert not gpu.waits


@pytest.mark.parametrize("rule", ["attention", "random", "diverse"])
def test_a_training_step_waits_for_list_lengths_only(tiny_network: Factory, rule: str) -> None:
    """What is near, and which voxels of how many chunks have views: the data alone says it."""
    network, inputs = tiny_network(), toy()
    batch = ChunkBatch(
        images=inputs["views"].images.byte(),
        K=inputs["views"].K,
        world_T_cam=inputs["views"].world_T_cam,
        times=torch.arange(3).expand(2, 3),
        coarse_target=inputs["coarse_target"],
        fine_target=torch.rand(2, 15, 15, 15) < 0.3,
        points=inputs["points"],
        sdf=torch.randn(2, 40),
        draws=torch.ones(2, dtype=torch.int64),
        keep=2,
        rule=rule,
    )
    rates: dict[str, Any] = {"lr": 1e-3, "weight_decay": 0.0, "schedule": "cosine", "warmup": 0}
    optimizer = OptimizerSettings(**rates, steps=9, clip=0.0, encoder_factor=1.0)
    with PretendedGpu() as gpu:
        module = Training(on_gpu(network), optimizer, 0.5, settings_of(views=2))
        module.log_dict = lambda *_, **__: None  # type: ignore[method-assign]
        moved = batch.pin_memory().to(CUDA)
        assert {x.device.type for x in vars(moved).values() if isinstance(x, Tensor)} == {"cuda"}
        loss = module.training_step(moved, 0)["loss"]
        assert gpu.waits == {"nonzero": 6, "__int__": 1, "__setitem__": 1}
    assert torch.isfinite(loss)


def test_the_pretended_gpu_is_strict() -> None:
    with PretendedGpu() as gpu:
        here, there = torch.ones(3), torch.ones(3, device="cuda")
        with pytest.raises(AssertionError, match="mixes"):
            here + there
        assert (there + 1).device.type == "cuda"
        assert not gpu.waits
        assert there.sum().item() == 3
        here.to(torch.device("cuda"))
        assert gpu.waits == {"item": 1, "to": 1}
