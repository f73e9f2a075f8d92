"""Streaming shards: every chunk once an epoch, whoever reads; damage is told or left out."""

import functools
import itertools
import logging
import shutil
import tarfile
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import lightning as L
import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader

from helpers import small_shards
from helpers.small_shards import COUNT, FAR, NEAR, SEED, SETTINGS, same, sampler
from tf_lab.data.chunk_sampler import ChunkStream
from tf_lab.data.chunks import ChunkBatch, ChunkSource
from tf_lab.data.shard_stream import ShardSource, ShardStream
from tf_lab.errors import TFLabError
from tf_lab.network.network import Network
from tf_lab.online.settings import ReconstructionSettings
from tf_lab.support.documents import read_json
from tf_lab.training.datamodule import SceneDataModule
from tf_lab.training.module import OptimizerSettings, Training

Write = Callable[..., Path]
OPTIMIZER = OptimizerSettings(
    lr=1e-3, weight_decay=0, schedule="cosine", warmup=1, steps=10, clip=1, encoder_factor=1
)


@pytest.fixture(scope="module")
def write(box_scene: Path, tmp_path_factory: pytest.TempPathFactory) -> Write:
    """Writes the shards of the box room; each way only once."""

    @functools.cache
    def make(per_shard: int = 5, images: int = 3) -> Path:
        directory = tmp_path_factory.mktemp("shards")
        drawn = sampler(box_scene, replace(SETTINGS, images=images))
        small_shards.write(directory, drawn, per_shard=per_shard)
        return directory

    return make


def source(urls: object, shuffle: bool = True, **changes: object) -> ShardSource:
    if isinstance(urls, Path):
        urls = str(urls)
    settings = replace(SETTINGS, **changes)  # type: ignore[arg-type]
    return ShardSource(urls, settings, NEAR, FAR, shuffle)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def number_of(box_scene: Path) -> Callable[[torch.Tensor], int]:
    """Tells a chunk's number by its points."""
    records = [sampler(box_scene).record(SEED, i) for i in range(COUNT)]
    known = {record.points.numpy().tobytes(): i for i, record in enumerate(records)}
    assert len(known) == COUNT
    return lambda points: known[points.numpy().tobytes()]


Numbers = Callable[[Iterator[ChunkBatch], int], list[int]]


@pytest.fixture(scope="module")
def numbers(number_of: Callable[[torch.Tensor], int]) -> Numbers:
    """Of the chunks in so many batches."""
    return lambda stream, steps: [
        number_of(points) for batch in itertools.islice(stream, steps) for points in batch.points
    ]


def loaded(stream: ShardStream, workers: int) -> Iterator[ChunkBatch]:
    return iter(DataLoader(stream, batch_size=None, num_workers=workers))


@pytest.mark.parametrize("per_shard", [3, 4, 16])
def test_two_ranks_with_two_workers_see_every_chunk_once_an_epoch(
    write: Write, numbers: Numbers, per_shard: int
) -> None:
    """With shards that fit, that don't, and fewer shards than processes."""
    of = source(write(per_shard))
    seen = [numbers(loaded(of.stream(0, 0, rank, 2), 2), 12) for rank in range(2)]  # 3 epochs
    epochs = [[n for rank in seen for n in rank[e * 8 : e * 8 + 8]] for e in range(3)]
    for epoch in epochs:
        assert sorted(epoch) == list(range(COUNT))
    assert len({tuple(epoch) for epoch in epochs}) == 3  # shuffled anew


@pytest.mark.parametrize("world", [1, 3, 5, 16])
def test_uneven_parts(write: Write, numbers: Numbers, world: int) -> None:
    of = source(write(), chunks=1)
    for epoch in range(2):
        seen = []
        for rank in range(world):
            size = COUNT * (rank + 1) // world - COUNT * rank // world
            assert size in (COUNT // world, COUNT // world + 1)
            seen += numbers(iter(of.stream(0, epoch * size, rank, world)), size)
        assert sorted(seen) == list(range(COUNT))


def test_batches_run_on_over_the_ends_of_epochs(write: Write, numbers: Numbers) -> None:
    found = numbers(iter(source(write(), chunks=3).stream(0, 0, 0, 1)), 16)
    assert Counter(found) == dict.fromkeys(range(COUNT), 3)
    for epoch in range(3):
        assert sorted(found[epoch * COUNT : (epoch + 1) * COUNT]) == list(range(COUNT))


def test_the_order_is_a_function_of_the_seed(write: Write, numbers: Numbers) -> None:
    of = source(write())
    orders = [numbers(iter(of.stream(seed, 0, 0, 1)), 8) for seed in (0, 0, 1)]
    assert orders[0] == orders[1] != orders[2]
    assert orders[0] != list(range(COUNT))


@pytest.mark.parametrize("workers", [0, 2])
def test_a_resumed_stream_goes_on(write: Write, workers: int) -> None:
    of = source(write(), chunks=3)
    expected = list(itertools.islice(loaded(of.stream(0, 0, 1, 2), workers), 14))  # 4 epochs
    for step in (1, 4, 9):
        resumed = itertools.islice(loaded(of.stream(0, step, 1, 2), workers), 14 - step)
        assert all(same(a, b) for a, b in zip(resumed, expected[step:], strict=True))


def test_in_order_they_are_the_folders_batches(write: Write, box_scene: Path) -> None:
    folders = ChunkStream(sampler(box_scene), SEED)
    shards = source(write(), shuffle=False).stream(SEED, 0, 0, 1)
    for expected, found in itertools.islice(zip(folders, shards, strict=False), 8):
        assert same(found, expected)


@pytest.mark.parametrize("variant", [{}, {"filter": False}, {"refine": False}, {"depth": False}])
def test_whatever_is_trained_gets_a_gradient(
    write: Write, tiny_network: Callable[..., Network], variant: dict[str, Any]
) -> None:
    """Of what gets none, DDP would wait for the gradient."""
    module = Training(tiny_network(**variant).train(), OPTIMIZER, 0.5, ReconstructionSettings())
    module.log_dict = lambda *_, **__: None  # type: ignore[method-assign]
    batch = next(iter(source(write()).stream(SEED, 0, 0, 1)))
    module.training_step(batch, 0)["loss"].backward()
    trained = {n: p.grad is not None for n, p in module.named_parameters() if p.requires_grad}
    assert [name for name, found in trained.items() if not found] == []
    assert any("coarse_mask" in name for name in trained) == variant.get("filter", True)


def test_a_step_keeps_the_views_that_the_batch_says(
    write: Write, tiny_network: Callable[..., Network]
) -> None:
    batch = next(iter(source(write()).stream(SEED, 0, 0, 1)))

    def loss(fusion: str = "transformer", **changes: Any) -> float:
        settings = ReconstructionSettings()
        module = Training(tiny_network(fusion=fusion), OPTIMIZER, 0.0, settings)
        module.log_dict = lambda *_, **__: None  # type: ignore[method-assign]
        return module.training_step(replace(batch, **changes), 0)["loss"].item()

    every = loss(keep=0, rule="random")
    assert loss(keep=0, rule="attention") == every
    two = [loss(keep=2, rule="random"), loss(keep=2, rule="attention")]
    others = loss(keep=2, rule="random", draws=batch.draws + 1)
    assert len({every, *two, others}) == 4
    assert loss("gru", keep=0) != loss("gru", keep=0, times=batch.times.flip(1))


def test_what_adam_is_given(tiny_network: Callable[..., Network]) -> None:
    given = {"lr": 3e-4, "betas": (0.8, 0.99), "eps": 1e-7, "weight_decay": 0.02}
    settings = replace(OPTIMIZER, **given, encoder_factor=0.25)  # type: ignore[arg-type]
    module = Training(tiny_network(), settings, 0.0, ReconstructionSettings())
    others, encoder = module.configure_optimizers()["optimizer"].param_groups  # type: ignore[index,call-overload]
    assert [others["initial_lr"], encoder["initial_lr"]] == pytest.approx([3e-4, 7.5e-5])
    for group in (others, encoder):
        assert (group["betas"], group["eps"], group["weight_decay"]) == ((0.8, 0.99), 1e-7, 0.02)
    expected = {*map(id, module.network.encoder.parameters())}
    assert {*map(id, encoder["params"])} == expected
    assert expected.isdisjoint(map(id, others["params"]))


def first_loss(chunks: ChunkSource, workers: int, network: Network, folder: Path) -> float:
    """Of the first step of a training."""
    module = Training(network.train(), OPTIMIZER, 0.5, ReconstructionSettings())
    trainer = L.Trainer(
        **{"max_steps": 1, "accelerator": "cpu", "devices": 1, "limit_val_batches": 0},
        **{"logger": False, "enable_checkpointing": False, "enable_progress_bar": False},
        **{"enable_model_summary": False, "use_distributed_sampler": False},
        default_root_dir=folder,
    )
    trainer.fit(module, SceneDataModule(chunks, [], SEED, workers))
    assert trainer.global_step == 1
    return float(trainer.callback_metrics["train/loss"])


@pytest.mark.parametrize("workers", [0, 2])
def test_the_first_loss_is_that_of_the_folders(
    write: Write,
    box_scene: Path,
    tiny_network: Callable[..., Network],
    tmp_path: Path,
    workers: int,
) -> None:
    folders = sampler(box_scene)
    expected = first_loss(folders, workers, tiny_network(), tmp_path)
    ordered, shuffled = (source(write(), shuffle=shuffle) for shuffle in (False, True))
    assert first_loss(ordered, workers, tiny_network(), tmp_path) == expected
    assert first_loss(shuffled, workers, tiny_network(), tmp_path) != expected


def test_fewer_images_than_are_stored(write: Write) -> None:
    of = source(write(images=5))
    batches = list(itertools.islice(of.stream(0, 0, 0, 1), 3))
    assert all(batch.images.shape[1] == batch.K.shape[1] == 3 for batch in batches)
    with pytest.raises(TFLabError, match=r"training\.images=5, not 6"):
        source(write(images=5), images=6)


@pytest.mark.parametrize(
    "change", [{"points": 41}, {"near_share": 0.7}, {"coverage": 0.3}, {"augment": False}]
)
def test_other_settings_than_the_shards(write: Write, change: dict[str, object]) -> None:
    (name,) = change
    with pytest.raises(TFLabError, match=rf"written with training\.{name}="):
        source(write(), **change)
    with pytest.raises(TFLabError, match=r"written with model\.far=5\.0, not 4\.0"):
        ShardSource(str(write()), SETTINGS, NEAR, 4.0)
    width, height = read_json(write() / "shards.json", "")["settings"]["width"], 999
    with pytest.raises(TFLabError, match=r"written with data\.height=\d+, not 999"):
        ShardSource(str(write()), SETTINGS, NEAR, FAR, size=(width, height))


def test_more_processes_than_chunks(write: Write) -> None:
    with pytest.raises(TFLabError, match="16 chunks in the shards, fewer than the 17"):
        next(iter(source(write()).stream(0, 0, 0, 17)))


@pytest.fixture
def copied(write: Write, tmp_path: Path) -> Path:
    """Shards to damage."""
    return Path(shutil.copytree(write(), tmp_path / "copied"))


def position(shard: Path, member: str) -> tuple[int, int]:
    """Where in a shard the content of a member begins, and its size."""
    with tarfile.open(shard) as tar:
        found = tar.getmember(member)
        return found.offset_data, found.size


def flip(shard: Path, at: int) -> None:
    data = bytearray(shard.read_bytes())
    data[at] ^= 0x10
    shard.write_bytes(data)


def test_a_damaged_chunk_is_left_out_and_logged(
    copied: Path, numbers: Numbers, caplog: pytest.LogCaptureFixture
) -> None:
    """Wherever in it the damage is; its batch is smaller, the others are as they were."""
    shard = copied / "chunks-000001.tar"
    for member in ("00000005.01.jpg", "00000006.safetensors", "00000008.json"):
        start, size = position(shard, member)
        flip(shard, start + size // 2)
    with caplog.at_level(logging.WARNING):
        found = numbers(iter(source(copied, shuffle=False).stream(0, 0, 0, 1)), 8)
    assert found == [n for n in range(COUNT) if n not in (5, 6, 8)]
    logged = [record.getMessage().split(": chunk ")[1][:8] for record in caplog.records]
    assert logged == ["00000005", "00000006", "00000008"]
    assert "chunks-000001.tar" in caplog.text
    assert "number 3 of this shard" in caplog.text


def test_a_batch_without_a_whole_chunk_is_the_next_one(copied: Path, numbers: Numbers) -> None:
    """Steps and batches stay together, also for one that goes on amid them."""
    shard = copied / "chunks-000001.tar"
    for chunk in (6, 7, 8):
        start, size = position(shard, f"{chunk:08}.safetensors")
        flip(shard, start + size // 2)
    of = source(copied, shuffle=False, chunks=1)
    expected = [*range(6), 9, 9, 9, 9, 10, 11]
    assert numbers(iter(of.stream(0, 0, 0, 1)), 12) == expected
    for step in (6, 7, 9):
        found = numbers(iter(of.stream(0, step, 0, 1)), 12 - step)
        assert found == expected[step:]


def test_nothing_whole(copied: Path) -> None:
    shard = copied / "chunks-000003.tar"  # one chunk
    start, size = position(shard, "00000015.safetensors")
    flip(shard, start + size // 2)
    with pytest.raises(TFLabError, match=r"chunks-000003\.tar: no chunk in an epoch is whole"):
        next(iter(source(shard).stream(0, 0, 0, 1)))


def read_all(urls: object) -> None:
    for _ in itertools.islice(source(urls).stream(0, 0, 0, 1), 8):
        pass


def test_a_broken_shard_is_told_by_its_name(copied: Path) -> None:
    shard = copied / "chunks-000002.tar"
    start, size = position(shard, "00000012.01.jpg")
    original = shard.read_bytes()
    shard.unlink()
    with pytest.raises(TFLabError, match=r"chunks-000002\.tar: No such file"):
        read_all(copied)
    shard.write_bytes(original[:-1000])
    with pytest.raises(TFLabError, match=r"chunks-000002\.tar: has \d+ of \d+ bytes"):
        read_all(copied)
    shard.write_bytes(original)
    flip(shard, start - 512 + 20)  # in the name, of which the header has a checksum
    with pytest.raises(TFLabError, match=r"chunks-000002\.tar: the shard ends before its 5"):
        read_all(copied)
    # elsewhere sizes are not known before
    for cut in (start - 512, start + size // 2, 100, 0):
        shard.write_bytes(original[:cut])
        with pytest.raises(TFLabError, match=r"chunks-000002\.tar: the shard (ends|cannot)"):
            read_all(f"pipe:cat {copied}/chunks-{{000000..000003}}.tar")
    shard.unlink()
    with pytest.raises(TFLabError, match=r"chunks-000002\.tar .*: the shard cannot be read"):
        read_all(f"pipe:cat {copied}/chunks-{{000000..000003}}.tar 2>/dev/null")


def test_damage_never_ends_in_another_error(copied: Path) -> None:
    """200 damaged copies of a shard: its chunks, fewer of them, or tf_lab's error."""
    shard = copied / "chunks-000003.tar"
    original, rng = shard.read_bytes(), np.random.default_rng(0)
    outcomes: Counter[str] = Counter()
    of = source(shard, chunks=1)
    for i in range(200):
        data = bytearray(original)
        if i % 4 == 0:
            data = data[: rng.integers(len(data))]
        elif i % 4 == 1:  # a member that says it is huge, with a header that is right
            data[124:135] = b"77777777777"
            data[148:156] = b" " * 8
            data[148:156] = b"%06o\0 " % sum(data[:512])
        else:
            for at in rng.integers(0, len(data), 1 + rng.integers(5)):
                data[at] = rng.integers(256)
        shard.write_bytes(data)
        try:
            batch = next(iter(of.stream(0, 0, 0, 1)))
            assert batch.images.shape == (1, 3, 3, 60, 80)
            outcomes["whole"] += 1
        except TFLabError as error:
            assert "chunks-000003.tar" in str(error)
            outcomes["error"] += 1
    assert outcomes["whole"] < 40
