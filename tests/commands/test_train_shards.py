"""train data.urls=: what is in the shards makes the training, not where they lie."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from helpers import small_shards
from helpers.tiny_jobs import Result, tiny_config
from tf_lab.data.chunk_sampler import ChunkSampler


@pytest.fixture
def shards(rooms: Callable[[str], list[Path]], tmp_path: Path) -> Path:
    """Six chunks of the tiny rooms, in two shards."""
    config = tiny_config()
    near, far = config.model.near, config.model.far
    drawn = ChunkSampler(rooms("train"), config.training.chunk, near, far)
    small_shards.write(tmp_path / "shards", drawn, count=6, per_shard=3)
    return tmp_path / "shards"


def test_training_from_shards(train: Callable[..., Result], shards: Path) -> None:
    first = train(f"data.urls={shards}")
    assert first.status == 0, first.err
    assert "Ours" in first.out
    run = json.loads((first.path("run") / "run.json").read_text())
    stored = run["training"]["config"]
    assert len(stored["content"]["shards"]) == 16
    assert "urls" not in stored["data"]
    # elsewhere, and named in another way
    moved = shutil.move(shards, shards.parent / "moved")
    again = train(f'data.urls="{moved}/chunks-{{000000..000001}}.tar"')
    assert "reusing the identical finished evaluation" in again.out
    assert again.path("run") == first.path("run")
    half = train(f"data.urls={moved}/chunks-000000.tar")
    assert half.path("training") != first.path("training")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("data.urls=[]",), "error: data.urls is empty"),
        (("data.urls=",), "data.urls=: is empty"),
        (("data.urls=gone",), "gone: not a shard"),
        (("data.urls={0}", "inputs=stereo"), "inputs.stereo=true: shards hold no depth maps"),
        (("data.urls={0}", "training.points=100"), "written with training.points=200, not 100"),
    ],
)
def test_errors(
    train: Callable[..., Result], shards: Path, arguments: tuple[str, ...], message: str
) -> None:
    result = train(*(a.format(shards) for a in arguments))
    assert result.status == 2
    assert message in result.err
    assert "Traceback" not in result.err
