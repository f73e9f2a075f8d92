from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import hypothesis
import pytest
import torch
from hydra.core.config_store import ConfigStore

from helpers import box_room, network
from tf_lab.data.groundtruth import GroundTruthSettings, write_groundtruth
from tf_lab.data.scene import write_scene
from tf_lab.network.network import Network
from tf_lab.network.settings import NetworkConfig

# The same examples at every run: a failure is a change of the code, never of the dice.
hypothesis.settings.register_profile("tf_lab", deadline=None, max_examples=50, derandomize=True)
hypothesis.settings.load_profile("tf_lab")

# The tests' tensors are small: a second thread costs more than it gives, above all beside others.
torch.set_num_threads(1)

REPOSITORY = Path(__file__).resolve().parents[1]


def pytest_addoption(parser: pytest.Parser) -> None:
    """Of tests/reliability."""
    parser.addoption(
        "--mutations", type=int, default=2000, help="damaged inputs a kind, of the slow campaigns"
    )


TINY = NetworkConfig(
    width=12,
    blocks=2,
    heads=2,
    expansion=2.0,
    hidden=16,
    refine_blocks=1,
    encoder={
        "width": 8,
        "blocks": (1, 1, 1),
        "stem_stride": 2,
        "stem_pool": False,
        "norm": "group",
        "coarse_stride": 8,
        "fine_stride": 2,
        "coarse_channels": 8,
        "fine_channels": 6,
        "unit_norm": True,
    },
)


@pytest.fixture(autouse=True, scope="session")
def no_network() -> Iterator[None]:
    """No test reaches beyond this machine: whatever it runs (train, report, ...) needs no network.

    What fails the test is no Exception, so that nobody takes it for a network that is down.
    """
    with pytest.MonkeyPatch.context() as patch:
        for (owner, name), value in network.closed(pytest.fail).items():
            patch.setattr(owner, name, value)
        yield


@pytest.fixture(scope="session")
def redkitchen() -> Path:
    """100 frames of a real RGB-D sequence, kept beside the repository and not part of it."""
    directory = REPOSITORY.parent / "shared" / "data" / "redkitchen"
    if not directory.is_dir():
        pytest.skip(f"the real sequence is not here ({directory})")
    return directory


@pytest.fixture(scope="session")
def box_scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The analytic room of box_room.py as a scene with ground truth. Don't write to it."""
    directory = tmp_path_factory.mktemp("scenes") / "box_room"
    scene = write_scene(directory, box_room.frames(), {"source": "analytic"}, "box_room")
    write_groundtruth(scene, scene.groundtruth, GroundTruthSettings())
    return directory


@pytest.fixture(scope="session")
def tiny_network() -> Callable[..., Network]:
    """Makes small networks with random, seeded weights; keywords replace the config's values."""

    def make(seed: int = 0, **changes: Any) -> Network:
        torch.manual_seed(seed)
        return Network(replace(TINY, **changes)).eval()

    return make


@pytest.fixture
def any_launcher() -> None:
    """Ray's launcher pins old packages, so that it is not installed with the tests."""
    node = {"_target_": "ray", "ray": {"init": {"address": None}, "remote": {}}}  # as its own
    ConfigStore.instance().store(group="hydra/launcher", name="ray", node=node)
