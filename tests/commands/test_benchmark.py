"""The benchmark as a user runs it, in a minute's size, and what it reports."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from helpers.tiny_jobs import call
from tf_lab.benchmarks.floor import frame_floor
from tf_lab.benchmarks.measure import BenchmarkSettings
from tf_lab.benchmarks.meter import Meter
from tf_lab.benchmarks.rooms import CORNER, SIZE, Rooms, walk
from tf_lab.online.settings import ReconstructionSettings
from tf_lab.reporting import paper

SMALL = (
    "model=tiny",
    "width=64",
    "height=48",
    "frames=3",
    "timed=2",
    "eager_timed=1",
    "views=[2,4]",
    "rooms=[1,2]",
    "counts=[4,8]",
    "resolution=0.1",
    "device=cpu",
    "model.far=2.5",
    "model.width=16",
    "model.blocks=1",
)

SETTINGS = BenchmarkSettings(
    size=(64, 48),
    frames=3,
    timed=2,
    eager_timed=2,
    warm_eager=False,
    rooms=(1,),
    counts=(3,),
    reconstruction=ReconstructionSettings(views=4, resolution=0.1),
)


def test_the_benchmark(tmp_path: Path) -> None:
    done = call("benchmark", *SMALL, "parts=[tables]", f"output={tmp_path}/b")
    assert done.status == 0, done.err
    for title in ("Adding a frame", "Meshing", "scene size", "Floor", "eager fusion over lazy"):
        assert title in done.out
    assert "130.52" in done.out
    text = (tmp_path / "b" / "benchmark.json").read_text()
    assert str(tmp_path) not in text  # it may be published
    found = json.loads(text)
    assert (tmp_path / "b" / "benchmark.png").stat().st_size > 10_000
    assert found["provenance"]["machine"]["cpus"] >= 1
    assert set(found["frame"]) == {
        f"{mode} {k}" for mode in ("lazy", "eager") for k in ("2", "4", "4 without filter")
    }
    for stages in found["frame"].values():
        assert stages["fps"] > 0
        assert stages["fine fusion"] > 0
    assert found["chunk"]["faces"] > 50
    assert all(x["bytes a voxel"] < 256 for x in found["size"])
    assert found["size"][1]["voxels seen"] > found["size"][0]["voxels seen"]
    floor = found["floor"]
    assert floor["eager"]["total"]["flops"] > 2 * floor["lazy"]["total"]["flops"]
    assert floor["chunk"]["occupancy"]["flops"] > 0


@pytest.mark.parametrize(
    "wrong", ["views=[]", "frames=0", "parts=[speed]", "online.precision=int8", "device=cuda"]
)
def test_what_cannot_be_measured(wrong: str) -> None:
    if wrong == "device=cuda" and torch.cuda.is_available():
        pytest.skip("there is one")
    done = call("benchmark", *SMALL, wrong)
    assert done.status == 2
    assert done.err.startswith("error: ")
    assert len(done.err.splitlines()) == 1


def test_the_papers_figures_add_up() -> None:
    for table in (paper.FRAME_MS, paper.CHUNK_MS):
        stages = sum(v for k, v in table.items() if k != "total")
        assert stages == pytest.approx(table["total"], abs=0.02)
    assert 1000 / paper.FRAME_MS["total"] == pytest.approx(paper.FPS[16], abs=0.01)


def test_the_rooms_surface() -> None:
    rooms, corner = Rooms(2), torch.tensor(CORNER).float()
    points = torch.tensor([[2.5, 2.0, 1.3], [7.5, 2, 1.3], [2.5, 2, 0.1], [2.5, 2, -0.2]])
    assert rooms.solid(points + corner).tolist() == pytest.approx([-1.3, -1.3, -0.1, 0.2], abs=1e-6)
    outside = torch.tensor([[-3.0, -4.0, 1.0], [11.0, 2, 1.3]])
    assert rooms.solid(outside + corner).tolist() == pytest.approx([5, 1])
    for image, K, pose in walk(range(1, 2), 5, (64, 48)):
        assert image.shape == (48, 64, 3)
        assert K[0, 2] == 31.5
        assert (pose[:3, 3] > [SIZE[0], 0, 0]).all()
        assert (pose[:3, 3] < CORNER + SIZE * [2, 1, 1]).all()
        np.testing.assert_allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-12)


class Work:
    done = 0

    def outer(self) -> None:
        self.done += 2
        self.inner()
        self.inner()

    def inner(self) -> None:
        self.done += 5


def test_a_stage_does_not_pay_for_the_stages_inside_it() -> None:
    work = Work()
    meter = Meter(lambda: work.done)
    meter.watch(work, "inner", "inner")
    meter.watch(work, "outer", "outer")
    work.outer()
    assert meter.take() == {"inner": 10, "outer": 2}
    assert meter.take() == {}


def test_the_floor_counts_what_convolutions_take(tiny_network: Callable[..., Any]) -> None:
    """2 C k^2 FLOPs for every output of a convolution, and no more, in feature extraction."""
    network = tiny_network(far=2.5).requires_grad_(False)
    found = frame_floor(network, SETTINGS, False, {"flops": 1e9, "bytes": 1e9})
    counted: list[int] = []
    for module in network.encoder.modules():
        if isinstance(module, torch.nn.Conv2d):
            taps = module.weight[0].numel()
            module.register_forward_hook(
                lambda _m, _i, out, taps=taps: counted.append(2 * taps * out.numel())
            )
    network.encode(torch.zeros(1, 3, 48, 64))
    assert found["feature extraction"]["flops"] == pytest.approx(sum(counted), rel=1e-4)
    assert found["total"]["ms"] == pytest.approx(
        sum(found[stage]["ms"] for stage in found if stage != "total")
    )
