"""Depth maps kept beside a scene, and in its chunks."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from tf_lab.data.chunk_sampler import ChunkSampler
from tf_lab.data.chunks import ChunkRecord, make_batch
from tf_lab.data.scene import Scene
from tf_lab.data.settings import CameraNoise, ChunkSettings
from tf_lab.data.stereo_maps import prepare_stereo, read_stereo, stereo_path, write_stereo
from tf_lab.errors import TFLabError
from tf_lab.stereo.depth import DepthSequence

EXACT = CameraNoise()
WRONG = CameraNoise(translation=0.02, rotation=1.0)
SMALL = ChunkSettings(chunks=2, images=3, points=64)


@pytest.fixture(scope="module")
def scene(box_scene: Path, tmp_path_factory: pytest.TempPathFactory) -> Scene:
    directory = tmp_path_factory.mktemp("stereo") / "box_room"
    shutil.copytree(box_scene, directory)
    prepare_stereo([directory], EXACT, 1)
    return Scene(directory)


def test_they_are_those_of_the_frames_one_by_one(scene: Scene) -> None:
    depths = DepthSequence()
    expected = [
        depths.add(scene.image(i), scene.K[i], scene.world_T_cam[i]) for i in range(len(scene))
    ]
    found = read_stereo(scene, EXACT)
    np.testing.assert_array_equal(found, np.stack(expected).astype(np.float16))
    assert (found[:, 0] > 0).mean() > 0.5  # most frames have sources


def test_wrong_cameras_give_other_maps_in_another_file(scene: Scene) -> None:
    write_stereo(scene.directory, WRONG)
    wrong, exact = read_stereo(scene, WRONG), read_stereo(scene, EXACT)
    some = exact[:, 0] > 0
    assert np.median(np.abs(wrong - exact)[:, 0][some]) > 0.01
    before = stereo_path(scene.directory, WRONG).read_bytes()
    stereo_path(scene.directory, WRONG).unlink()
    write_stereo(scene.directory, WRONG)
    assert stereo_path(scene.directory, WRONG).read_bytes() == before


def test_chunks_hold_the_maps_of_their_images(scene: Scene) -> None:
    sampler = ChunkSampler([scene.directory], SMALL, 0.3, 5.0, stereo=True)
    records = [sampler.record(0, i) for i in range(2)]
    maps = read_stereo(scene, EXACT)
    for record in records:
        frames = [scene.frames.index(name) for name in record.frames]
        assert record.stereo is not None
        np.testing.assert_array_equal(record.stereo.numpy(), maps[frames])
    two = replace(SMALL, images=2)  # of three that the record holds
    batch = make_batch(records, two, 0, 0, 0)
    assert batch.stereo is not None
    assert batch.stereo.shape == (2, 2, *maps.shape[1:]) and batch.stereo.dtype == torch.float16
    for b, record in enumerate(records):
        for v in range(2):
            first = record.images[int(np.flatnonzero(_same_image(record, batch.images[b, v]))[0])]
            frame = scene.frames.index(record.frames[record.images.index(first)])
            np.testing.assert_array_equal(batch.stereo[b, v].numpy(), maps[frame])
    plain = ChunkSampler([scene.directory], SMALL, 0.3, 5.0).record(0, 0)
    assert plain.stereo is None
    assert make_batch([plain], SMALL, 0, 0, 0).stereo is None


def test_chunks_of_wrong_cameras_hold_the_maps_of_wrong_cameras(scene: Scene) -> None:
    write_stereo(scene.directory, WRONG)
    settings = replace(SMALL, camera_noise=WRONG)
    record = ChunkSampler([scene.directory], settings, 0.3, 5.0, stereo=True).record(0, 0)
    frames = [scene.frames.index(name) for name in record.frames]
    assert record.stereo is not None
    np.testing.assert_array_equal(record.stereo.numpy(), read_stereo(scene, WRONG)[frames])


def _same_image(record: ChunkRecord, image: torch.Tensor) -> list[bool]:
    found = []
    for i in range(len(record.images)):
        decoded = np.empty((1, *image.shape), np.uint8)
        record.decode([i], decoded)
        found.append(bool((torch.from_numpy(decoded[0]) == image).all()))
    return found


def test_what_is_there_is_kept(scene: Scene) -> None:
    path = stereo_path(scene.directory, EXACT)
    before = path.stat().st_mtime_ns
    prepare_stereo([scene.directory], EXACT, 1)
    assert path.stat().st_mtime_ns == before


def test_damage_is_named(scene: Scene, tmp_path: Path) -> None:
    with pytest.raises(TFLabError, match="missing; delete it and start the training again"):
        read_stereo(scene, CameraNoise(translation=0.5))
    copy = tmp_path / "room"
    shutil.copytree(scene.directory, copy)
    path = stereo_path(copy, EXACT)
    np.save(path, np.load(path)[:-1])
    with pytest.raises(TFLabError, match=r"stereo-.*npy: float16 \[.*\] for \d+ frames"):
        read_stereo(Scene(copy), EXACT)
    path.write_bytes(path.read_bytes()[:1000])
    with pytest.raises(TFLabError, match="cannot be read as an array"):
        read_stereo(Scene(copy), EXACT)


def test_a_scene_that_has_none_is_named_and_the_others_get_theirs(
    scene: Scene, tmp_path: Path
) -> None:
    good, bad = tmp_path / "good", tmp_path / "bad"
    for path in (good, bad):
        shutil.copytree(scene.directory, path, ignore=shutil.ignore_patterns("stereo-*"))
    (bad / "color" / f"{scene.frames[3]}.jpg").write_bytes(b"no image")
    with pytest.raises(TFLabError, match=f"stereo depth of 1 of 2 scenes .* the first: {bad}"):
        prepare_stereo([bad, good], EXACT, 1)
    assert stereo_path(good, EXACT).exists() and not stereo_path(bad, EXACT).exists()
