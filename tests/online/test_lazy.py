"""What is computed when: regions, what changed, memory, and stopping and going on."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from helpers.online.scenes import (
    FRAMES,
    Factory,
    add,
    assert_same_surface,
    balanced,
    reconstruct,
    settings_of,
    trained_to_match,
)
from tf_lab.data.scene import Scene
from tf_lab.errors import TFLabError
from tf_lab.geometry import CHUNK
from tf_lab.network.fusion.weights import weights_from_logits
from tf_lab.online import Reconstructor, frames as frames_module
from tf_lab.support.devices import free_memory
from tf_lab.support.memory import total_memory

FIRST = (0, 0, 0)
REGION = ([0.2, 0.3, 0.1], [1.2, 1.1, 1.3])  # within one chunk


def fused_by(network: Any) -> dict[str, int]:
    """Counts, from now on, the voxels that each level's transformer fuses."""
    count = {"coarse": 0, "fine": 0}

    def watch(level: str) -> None:
        def hook(_module: Any, _inputs: Any, out: Any) -> None:
            count[level] += len(out[0])

        network.fusion[level].register_forward_hook(hook)

    watch("coarse")
    watch("fine")
    return count


def parts_of(r: Reconstructor) -> dict[Any, tuple[bytes, bytes]]:
    return {c: (v.tobytes(), f.tobytes()) for c, (v, f) in r.surface.parts.items()}


@pytest.mark.parametrize("masks", [True, False])
def test_a_region_is_that_part_of_the_whole(
    tiny_network: Factory, scene: Scene, masks: bool
) -> None:
    network = balanced(tiny_network(filter=masks), scene)
    whole = reconstruct(network, scene)
    whole.mesh(color=False)
    r = reconstruct(network, scene)
    part = r.mesh(REGION)
    assert set(r.surface.parts) == {FIRST}
    vertices, faces = whole.surface.parts[FIRST]
    assert len(part.faces) == len(faces) > 100
    np.testing.assert_allclose(part.vertices, (vertices + 0.5) * 0.05, atol=1e-4)
    np.testing.assert_array_equal(part.faces, faces)
    assert_same_surface(r.mesh(color=False), whole.mesh(color=False))  # and the rest follows
    far_away = r.mesh(([50, 50, 50], [51, 51, 51]))
    assert len(far_away.faces) == 0


def test_a_region_costs_less_than_the_whole(tiny_network: Factory, scene: Scene) -> None:
    network = balanced(tiny_network(refine=False), scene)  # a reach of one voxel
    r = reconstruct(network, scene)
    for i in FRAMES:  # a second room, 9 m off
        pose = scene.world_T_cam[i].copy()
        pose[0, 3] += 9
        r.add_frame(scene.image(i), scene.K[i], pose)
    count = fused_by(network)
    one = r.mesh(([-1.5, -1.5, 0], [1.5, 1.5, 2.5]))
    some = dict(count)
    both = r.mesh()
    assert some["coarse"] == 0.5 * count["coarse"]
    assert some["fine"] == pytest.approx(0.5 * count["fine"], rel=0.1)
    assert len(one.faces) == pytest.approx(0.5 * len(both.faces), rel=0.1)


def test_nothing_is_computed_twice(tiny_network: Factory, scene: Scene) -> None:
    network = balanced(tiny_network(), scene)
    r = reconstruct(network, scene)
    count = fused_by(network)
    first = r.mesh()
    assert count == {
        "coarse": int((r.coarse.store.seen > 0).sum()),
        "fine": int(r.fine.active.sum()),
    }
    assert r.update() == 0
    assert_same_surface(first, r.mesh())
    assert count["coarse"] == int((r.coarse.store.seen > 0).sum())
    before = dict(count)
    r.add_frame(scene.image(0), scene.K[0], scene.world_T_cam[0])
    changed = int(r.coarse.store.dirty.sum())
    assert 0 < changed < (r.coarse.store.seen > 0).sum()
    r.mesh()
    assert count["coarse"] - before["coarse"] == changed


@pytest.mark.parametrize("select", [{"select": "attention"}, {"select": "random", "seed": 2}])
@pytest.mark.parametrize(
    ("masks", "inputs"),
    [(True, {}), (False, {}), (True, {"matching": True}), (True, {"stereo": True})],
)
def test_meshing_in_between_changes_nothing(
    tiny_network: Factory,
    scene: Scene,
    select: dict[str, Any],
    masks: bool,
    inputs: dict[str, bool],
) -> None:
    """Dirty chunks only, regions in any order, frames in between: the same as all at once."""
    network = tiny_network(filter=masks, **inputs)
    network = balanced(trained_to_match(network), scene)
    expected = reconstruct(network, scene, **select, views=2)
    often = Reconstructor(network, settings_of(views=2, **select))
    rng = np.random.default_rng(0)
    for frame in FRAMES:
        add(often, scene, [frame])
        low = rng.uniform(-1.5, 1.5, 3)
        often.mesh((low, low + rng.uniform(0, 1, 3)))
        if frame == FRAMES[2]:
            often.mesh()
    assert_same_surface(often.mesh(color=False), expected.mesh(color=False))
    rows = often.fine.blocks.row_of(
        expected.fine.blocks.voxels(torch.arange(expected.fine.blocks.rows))
    )
    known = rows >= 0
    assert known.all()
    assert torch.equal(often.fine.store.frames[rows], expected.fine.store.frames)
    active = expected.fine.active
    assert torch.equal(often.fine.active[rows], active)
    for column in ("psi", "refined"):
        a, b = often.fine.features[column][rows[active]], expected.fine.features[column][active]
        torch.testing.assert_close(a, b, atol=1e-4, rtol=1e-4)


def test_what_is_rough_is_made_good(tiny_network: Factory, scene: Scene) -> None:
    """Around a region nothing is fused, new voxels neither; once all is updated nothing tells."""
    network = balanced(tiny_network(), scene)
    fused = {}
    for roughly in (False, True):
        r = Reconstructor(network, settings_of(views=2))
        add(r, scene, FRAMES[:4])
        r.update()
        add(r, scene, FRAMES[4:])
        count = fused_by(network)
        r.update((np.array(REGION[0]), np.array(REGION[1])), roughly=roughly)
        fused[roughly] = dict(count)
        chunk = r.coarse.blocks.voxels(r.coarse.store.dirty.nonzero()[:, 0]) // 5  # of 1.5 m
        assert not (chunk == torch.tensor(FIRST)).all(1).any()
    assert 0 < fused[True]["coarse"] < fused[False]["coarse"]
    assert 0 < fused[True]["fine"] < fused[False]["fine"]
    assert_same_surface(r.mesh(), reconstruct(network, scene, views=2).mesh())


@pytest.mark.parametrize("far", [100.0, 1e20, np.inf])
def test_a_region_may_be_without_end(tiny_network: Factory, scene: Scene, far: float) -> None:
    """Also when it is the first that is asked for: all below a height, say."""
    network = balanced(tiny_network(), scene)
    region = ([-far] * 3, [far, far, 1.0])
    first = reconstruct(network, scene).mesh(region, color=False)
    whole = reconstruct(network, scene)
    whole.update()
    assert len(first.faces) > 100
    assert_same_surface(first, whole.mesh(region, color=False))


def test_a_camera_too_far_away_is_refused(tiny_network: Factory, scene: Scene) -> None:
    """Keys of voxels have room for so much; beyond, they would be those of others."""
    r = reconstruct(tiny_network(), scene)
    frames, pose = len(r.frames), scene.world_T_cam[0].copy()
    pose[0, 3] += 450_000.0  # as in UTM
    with pytest.raises(TFLabError, match=r"450,\d+ m from the origin.*subtract the same offset"):
        r.add_frame(scene.image(0), scene.K[0], pose)
    assert len(r.frames) == frames


def test_only_chunks_that_changed_are_meshed(tiny_network: Factory, scene: Scene) -> None:
    network = balanced(tiny_network(refine=False), scene)
    r = reconstruct(network, scene)
    r.mesh()
    before = parts_of(r)
    r.add_frame(scene.image(0), scene.K[0], scene.world_T_cam[0])
    meshed = r.update()
    after = parts_of(r)
    same = [c for c in before if after.get(c) == before[c]]
    assert 0 < meshed < len(before) + 5
    assert len(same) > 0
    changed = {c for c in before.keys() | after.keys() if after.get(c) != before.get(c)}
    pose = scene.world_T_cam[0]
    for chunk in changed:  # the camera sees no farther than this
        centre = (np.array(chunk) + 0.5) * CHUNK
        assert np.linalg.norm(centre - pose[:3, 3]) < 2.5 + CHUNK


def test_few_maps_in_memory_give_the_same_mesh(tiny_network: Factory, scene: Scene) -> None:
    network = balanced(tiny_network(), scene)
    expected = reconstruct(network, scene, views=3)
    for frames in (1, 3):
        budget = expected.frames.nbytes * frames // len(FRAMES)
        r = reconstruct(network, scene, views=3, maps_budget=budget)
        assert_same_surface(r.mesh(color=False), expected.mesh(color=False))
        assert r.frames.nbytes <= budget
        frames_held = on_all(r), on_all(expected)
        assert torch.equal(*frames_held)


def test_by_default_maps_take_half_of_what_is_free(
    tiny_network: Factory, scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    network = balanced(tiny_network(), scene)
    expected = reconstruct(network, scene, views=3)
    assert not expected.frames.crowded and expected.frames.budget > expected.frames.nbytes
    monkeypatch.setattr(frames_module, "free_memory", lambda device: expected.frames.nbytes)
    r = reconstruct(network, scene, views=3)
    assert r.frames.crowded and r.frames.nbytes <= expected.frames.nbytes // 2
    assert_same_surface(r.mesh(color=False), expected.mesh(color=False))


def test_what_is_free_is_a_part_of_what_there_is() -> None:
    assert 2**20 < free_memory(torch.device("cpu")) < total_memory()


def on_all(r: Reconstructor) -> torch.Tensor:
    return r.fine.store.frames


@pytest.mark.parametrize("dtype", ["float16", "bfloat16"])
def test_half_precision_is_close(tiny_network: Factory, scene: Scene, dtype: str) -> None:
    network = balanced(tiny_network(), scene)
    exact = reconstruct(network, scene)
    exact.update()
    maps = reconstruct(network, scene, maps=dtype)
    maps.update()
    assert maps.frames.nbytes * 2 == exact.frames.nbytes
    computed = reconstruct(network, scene, maps=dtype, precision="bfloat16")
    computed.update()
    for r, tolerance in ((maps, 0.02), (computed, 0.1)):
        assert torch.equal(r.coarse.store.seen, exact.coarse.store.seen)  # geometry stays exact
        psi = r.coarse.features["psi"], exact.coarse.features["psi"]
        assert (psi[0] - psi[1]).abs().mean() < tolerance * psi[1].abs().mean()


@pytest.mark.slow
def test_compiled_networks_give_the_same_mesh(tiny_network: Factory, scene: Scene) -> None:
    network = balanced(tiny_network(), scene)
    expected = reconstruct(network, scene).mesh(color=False)
    network.compile_parts()
    assert_same_surface(reconstruct(network, scene).mesh(color=False), expected)


def test_view_weights(tiny_network: Factory, scene: Scene) -> None:
    network = trained_to_match(tiny_network(matching=True))
    r = reconstruct(network, scene, views=4, select="random", seed=0)
    points = np.random.default_rng(0).uniform([-1.2, -1.2, 0], [1.2, 1.2, 2.4], (40, 3))
    frames, weights = r.view_weights(points, "coarse")
    held = frames >= 0
    assert held.any()
    np.testing.assert_allclose(weights.sum(1), held.any(1), atol=1e-5)
    assert (weights[~held] == 0).all()
    rows = r.coarse.blocks.row_of(torch.from_numpy(np.floor(points / 0.3)).long())
    for i in held.any(1).nonzero()[0][:5]:
        kept, filled = r.coarse.measurements(rows[i][None], 4)
        logits = network.selection_logits("coarse", network.embed_kept("coarse", kept))
        expected = weights_from_logits(logits, filled)[0].detach()
        np.testing.assert_allclose(weights[i], expected, atol=1e-5)
    nowhere = r.view_weights(np.full((2, 3), 99.0))
    assert (nowhere[0] == -1).all()
    assert (nowhere[1] == 0).all()


@pytest.mark.parametrize(
    ("select", "inputs"),
    [
        ({"select": "attention"}, {}),
        ({"select": "random", "seed": 5}, {}),
        ({"select": "diverse", "seed": 6}, {"matching": True, "stereo": True}),
    ],
)
def test_save_and_go_on(
    tiny_network: Factory,
    scene: Scene,
    tmp_path: Path,
    select: dict[str, Any],
    inputs: dict[str, bool],
) -> None:
    """Depth by stereo is not stored, but found anew from the images."""
    network = balanced(trained_to_match(tiny_network(**inputs)), scene)
    expected = reconstruct(network, scene, **select, views=3)
    half = reconstruct(network, scene, FRAMES[:3], **select, views=3)
    half.mesh()
    path = tmp_path / "half.safetensors"
    half.save(path)
    assert_same_surface(Reconstructor.load(path, network).mesh(), half.mesh())
    r = add(Reconstructor.load(path, network), scene, FRAMES[3:])
    assert r.settings == half.settings
    assert r.policy == half.policy
    assert_same_surface(r.mesh(), expected.mesh())
    assert [p.name for p in tmp_path.iterdir()] == [path.name]
    with pytest.raises(TFLabError, match="another network"):
        Reconstructor.load(path, tiny_network(seed=1))


def test_maps_that_lay_on_a_device_that_is_not_here(
    tiny_network: Factory, scene: Scene, tmp_path: Path
) -> None:
    """Where maps lie changes no number, so that a file from a machine with a GPU can be read."""
    network, path = balanced(tiny_network(), scene), tmp_path / "r.safetensors"
    r = reconstruct(network, scene, views=3)
    missing = f"cuda:{torch.cuda.device_count()}"
    object.__setattr__(r.settings, "maps_device", missing)
    r.save(path)
    loaded = Reconstructor.load(path, network)
    assert loaded.settings.maps_device is None
    assert_same_surface(loaded.mesh(), r.mesh())


def test_an_empty_reconstruction_can_be_saved(tiny_network: Factory, tmp_path: Path) -> None:
    network = tiny_network()
    Reconstructor(network).save(tmp_path / "a.safetensors")
    assert len(Reconstructor.load(tmp_path / "a.safetensors", network).mesh().faces) == 0


def test_files_that_are_no_reconstruction(tiny_network: Factory, tmp_path: Path) -> None:
    network = tiny_network()
    with pytest.raises(TFLabError, match="no such"):
        Reconstructor.load(tmp_path / "b.safetensors", network)
    path = tmp_path / "c.safetensors"
    Reconstructor(network).save(path)
    content = path.read_bytes()
    for damaged in (
        b"",
        b"text",
        content[:40],
        content[:-8],
        content.replace(b"format", b"formal"),
    ):
        path.write_bytes(damaged)
        with pytest.raises(TFLabError, match=r"c\.safetensors"):
            Reconstructor.load(path, network)


@pytest.mark.parametrize("fault", ["lost", "skewed", "shape", "floats", "size", "focal"])
def test_a_frame_that_cannot_be_used_changes_nothing(
    tiny_network: Factory, scene: Scene, fault: str
) -> None:
    network = balanced(tiny_network(), scene)
    expected = reconstruct(network, scene, views=3).mesh()
    r = reconstruct(network, scene, FRAMES[:3], views=3)
    image, K, pose = scene.image(0), scene.K[0].copy(), scene.world_T_cam[0].copy()
    if fault == "lost":
        pose[:] = np.nan
    elif fault == "skewed":
        pose[0, :3] *= 2
    elif fault == "shape":
        image = image[..., 0]
    elif fault == "floats":
        image = image.astype(np.float32)
    elif fault == "size":
        image = image[:-1]
    else:
        K[0, 0] = np.inf
    with pytest.raises(TFLabError):
        r.add_frame(image, K, pose)
    add(r, scene, FRAMES[3:])
    assert_same_surface(r.mesh(), expected)
