"""`python -m tf_lab.reconstruct`: posed images to a mesh and a picture."""

import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import trimesh
from PIL import Image

from helpers.tiny_jobs import TINY, Result, call, start
from tf_lab.cli.command import TRAINING_DATA
from tf_lab.online.reconstructor import Reconstructor

# all cells are decoded, so that a hardly trained network gives some surface
SETTINGS = ("resolution=0.05", "threshold=0", "device=cpu")
ROOM = tuple(
    option
    for option in TINY
    if option.startswith("data.") and option.partition("=")[0] not in TRAINING_DATA
)


@pytest.fixture
def mine(posed_images: Path, tmp_path: Path) -> Path:
    """A copy of the capture, to damage."""
    return Path(shutil.copytree(posed_images, tmp_path / "mine"))


@pytest.fixture(scope="session")
def reconstruct(checkpoint: Path) -> Callable[..., Result]:
    """Runs the command with the main job's checkpoint."""

    def run(*arguments: str) -> Result:
        return call("reconstruct", f"checkpoint={checkpoint}", *SETTINGS, *arguments)

    return run


def load(path: Path) -> trimesh.Trimesh:
    mesh = trimesh.load(path, process=False)
    assert isinstance(mesh, trimesh.Trimesh)
    return mesh


def test_by_a_process(posed_images: Path, checkpoint: Path, tmp_path: Path) -> None:
    """Mesh and picture are written to the default place under the directory it is started in."""
    (tmp_path / "capture").symlink_to(posed_images)
    result = start(
        "reconstruct", "input=capture", f"checkpoint={checkpoint}", *SETTINGS, cwd=tmp_path
    )
    assert (result.status, result.err) == (0, "")
    mesh = load(tmp_path / "outputs" / "reconstructions" / "capture.ply")
    assert len(mesh.faces) > 100
    assert np.isfinite(mesh.vertices).all()
    visual: Any = mesh.visual
    assert visual.kind == "vertex"
    assert np.ptp(visual.vertex_colors[:, :3], axis=0).min() > 20
    with Image.open(tmp_path / "outputs" / "reconstructions" / "capture.png") as picture:
        assert np.asarray(picture.convert("L")).std() > 10
    assert "keyframes of 24 frames" in result.out
    assert ", 0 frames skipped" in result.out
    assert f"{len(mesh.vertices)} vertices, {len(mesh.faces)} faces" in result.out
    assert "F-score" not in result.out  # there is no depth to compare with


def test_a_bad_frame_is_skipped_and_counted(reconstruct: Callable[..., Result], mine: Path) -> None:
    """A truncated keyframe (the first frame always is one), and a lost one."""
    image = mine / "images" / "000000.jpg"
    image.write_bytes(image.read_bytes()[:300])
    lines = (mine / "poses.txt").read_text().splitlines()
    lines[5] = " ".join(["nan"] * 16)
    (mine / "poses.txt").write_text("\n".join(lines) + "\n")
    result = reconstruct("input=mine", "output=a/b.ply")
    assert result.status == 0, result.err
    assert "keyframes of 23 frames" in result.out
    assert ", 2 frames skipped" in result.out
    lines = [line for line in result.out.splitlines() if "skipped" in line]
    assert len(lines) == 3  # each frame once, and their number
    assert lines[0].startswith(f"frame 000000 skipped: {Path('mine/images/000000.jpg')}")
    assert lines[2].startswith("  skipped 000005: the pose has NaN")
    assert len(load(Path("a/b.ply")).faces) > 0
    assert Path("a/b.png").exists()


def test_more_views_than_frames_are_told(reconstruct: Callable[..., Result], mine: Path) -> None:
    result = reconstruct("input=mine", "views=1000")
    assert result.status == 0, result.err
    assert re.search(r"views=1000 of only \d+ keyframes: each point keeps all", result.out)
    for image in sorted((mine / "images").iterdir())[1:]:
        image.write_bytes(b"")
    result = reconstruct("input=mine", "views=1")
    assert result.status == 0, result.err
    assert "mine: 1 keyframe of 24 frames" in result.out
    assert "views=" not in result.out
    assert "of one keyframe no distance can be seen" in result.err


def test_memory_options_change_no_vertex(
    reconstruct: Callable[..., Result], posed_images: Path
) -> None:
    """Two frames' maps at a time, few voxels at a time; half precision moves the surface a bit."""
    less = ("online.maps_budget=0.0001", "online.maps_device=cpu", "online.batch=50")
    meshes = []
    for name, options in (("a", ()), ("b", less), ("c", ("online.precision=bfloat16",))):
        result = reconstruct(f"input={posed_images}", f"output={name}.ply", *options)
        assert result.status == 0, result.err
        meshes.append(load(Path(f"{name}.ply")))
    whole, small, half = meshes
    np.testing.assert_allclose(small.vertices, whole.vertices, atol=1e-4)
    np.testing.assert_array_equal(small.faces, whole.faces)
    assert half.vertices.shape != whole.vertices.shape or (half.vertices != whole.vertices).any()


def test_jobs_of_a_sweep_keep_a_mesh_each(posed_images: Path, checkpoint: Path) -> None:
    given = (f"checkpoint={checkpoint}", f"input={posed_images}", *SETTINGS)
    result = call("reconstruct", "-m", *given, "views=2,8")
    assert result.status == 0, result.err
    meshes = sorted(Path("outputs/reconstructions").glob("*.ply"))
    assert [path.stem[-2:] for path in meshes] == ["-0", "-1"]
    few, many = (load(path).vertices for path in meshes)
    assert few.shape != many.shape or (few != many).any()


def test_without_an_input_a_test_room_is_scored(reconstruct: Callable[..., Result]) -> None:
    result = reconstruct(*ROOM)
    assert (result.status, result.err) == (0, "")
    row = next(x for x in result.out.splitlines() if x.startswith("room_2000000  ")).split()
    assert len(row) == 7
    assert 0 <= float(row[-1]) <= 1
    assert Path("outputs/reconstructions/room_2000000.ply").exists()


def test_poses_are_refined_where_that_explains_much(reconstruct: Callable[..., Result]) -> None:
    """Another mesh of wrong cameras; and good ones are said to be kept."""
    wrong = ("camera_noise.translation=0.01", "camera_noise.rotation=0.5")
    faces = []
    for refine in ("true", "false"):
        result = reconstruct(*ROOM, *wrong, f"refine_poses={refine}", f"output={refine}.ply")
        assert result.status == 0, result.err
        assert ("poses refined: points are seen where they are to " in result.out) == (
            refine == "true"
        )
        faces.append(len(load(Path(f"{refine}.ply")).faces))
    assert faces[0] != faces[1]
    kept = reconstruct(*ROOM, "refine_poses=true", "output=kept.ply")
    assert "poses as given: " in kept.out


def test_a_capture_with_depth_is_scored_too(
    reconstruct: Callable[..., Result], rooms: Callable[[str], list[Path]], mine: Path
) -> None:
    """Against the mesh fused from its depth: the same that the rooms' ground truth is made of."""
    shutil.copytree(rooms("test")[0] / "depth", mine / "depth")
    result = reconstruct("input=mine")
    room = reconstruct(*ROOM)
    assert result.status == 0
    scores = [
        next(x for x in r.out.splitlines() if x.startswith(f"{name}  ")).split()[1:]
        for r, name in ((result, "mine"), (room, "room_2000000"))
    ]
    assert scores[0] == scores[1]


def test_a_score_that_nobody_asks_for(reconstruct: Callable[..., Result]) -> None:
    result = reconstruct(*ROOM, "score=false", "output=fast.ply")
    assert (result.status, result.err) == (0, "")
    assert "F-score" not in result.out
    assert Path("fast.png").exists()


def test_frames_without_depth_are_no_part_of_the_truth(
    reconstruct: Callable[..., Result], rooms: Callable[[str], list[Path]], mine: Path
) -> None:
    """Whichever they are: here the first has none, and another is damaged."""
    shutil.copytree(rooms("test")[0] / "depth", mine / "depth")
    (mine / "depth" / "000000.png").unlink()
    damaged = mine / "depth" / "000003.png"
    damaged.write_bytes(damaged.read_bytes()[:100])
    result = reconstruct("input=mine", "output=a.ply")
    assert (result.status, result.err) == (0, "")
    assert f"1 depth maps are left out; the first: {Path('mine/depth/000003.png')}" in result.out
    assert "F-score" in result.out


def test_depth_that_cannot_be_fused_costs_the_score_only(
    reconstruct: Callable[..., Result], rooms: Callable[[str], list[Path]], mine: Path
) -> None:
    shutil.copytree(rooms("test")[0] / "depth", mine / "depth")
    for path in (mine / "depth").iterdir():
        with Image.open(path) as image:
            Image.new(image.mode, image.size).save(path)  # no reading
    result = reconstruct("input=mine", "output=a.ply")
    assert (result.status, result.err) == (0, "")
    assert "not scored, because the depth cannot be fused: no depth reading" in result.out
    assert Path("a.ply").exists()
    assert Path("a.png").exists()


@pytest.mark.parametrize("when", ["add_frame", "mesh"])
def test_too_little_memory_is_an_error_in_a_line(
    reconstruct: Callable[..., Result], mine: Path, monkeypatch: pytest.MonkeyPatch, when: str
) -> None:
    """No frame is skipped for it."""

    def full(*_: Any, **__: Any) -> None:
        raise torch.OutOfMemoryError("CUDA out of memory. Tried to allocate 2 GiB. See elsewhere.")

    monkeypatch.setattr(Reconstructor, when, full)
    result = reconstruct("input=mine", "output=a.ply")
    assert result.status == 2
    (line,) = result.err.splitlines()
    assert line.startswith("error: mine: too little memory (CUDA out of memory. Tried to allocate")
    assert "online.maps_budget" in line and "skipped" not in line and "elsewhere" not in line
    assert not Path("a.ply").exists()


def test_a_prepared_scene_is_an_input(
    reconstruct: Callable[..., Result], rooms: Callable[[str], list[Path]]
) -> None:
    result = reconstruct(f"input={rooms('test')[0]}")
    assert (result.status, result.err) == (0, "")
    assert "F-score" in result.out


def test_images_of_another_size_are_brought_to_the_networks(
    reconstruct: Callable[..., Result], mine: Path
) -> None:
    """Twice as large with K to match: nearly the same mesh as of the original images."""
    reconstruct("input=mine", "output=small.ply")
    for path in (mine / "images").iterdir():
        with Image.open(path) as image:
            image.resize((160, 120), Image.Resampling.NEAREST).save(path, quality=100)
    K = np.loadtxt(mine / "K.txt")
    K[:2] *= 2
    K[:2, 2] += 0.5  # pixel centres at integers
    np.savetxt(mine / "K.txt", K)
    result = reconstruct("input=mine", "output=large.ply")
    assert result.status == 0, result.err
    small, large = load(Path("small.ply")), load(Path("large.ply"))
    np.testing.assert_allclose(large.bounds, small.bounds, atol=0.15)
    assert len(large.faces) == pytest.approx(len(small.faces), rel=0.2)


def test_the_sources_world(reconstruct: Callable[..., Result], mine: Path) -> None:
    """A capture whose y axis points down: the mesh stands up, or lies as its source does."""
    upright = reconstruct("input=mine", "output=before.ply")
    assert upright.status == 0
    turn = np.array([[1, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1.0]])  # z to -y
    poses = np.loadtxt(mine / "poses.txt").reshape(-1, 4, 4)
    np.savetxt(mine / "poses.txt", (turn @ poses).reshape(-1, 16))
    (mine / "gravity-direction.txt").write_text("0 1 0\n")
    assert reconstruct("input=mine", "output=up.ply").status == 0
    assert reconstruct("input=mine", "output=source.ply", "source_frame=true").status == 0
    before, up, source = (load(Path(f"{name}.ply")) for name in ("before", "up", "source"))
    np.testing.assert_allclose(up.bounds, before.bounds, atol=0.05)
    back = np.asarray(source.vertices) @ turn[:3, :3]
    np.testing.assert_allclose(back, up.vertices, atol=1e-5)
    np.testing.assert_array_equal(source.faces, up.faces)


def test_a_world_far_from_its_origin(reconstruct: Callable[..., Result], mine: Path) -> None:
    """As of a survey (UTM): the mesh near the origin, or where the poses are, to the millimetre."""
    place = np.array([688123.0, 5334567.0, 512.0])
    assert reconstruct("input=mine", "output=near.ply").status == 0
    poses = np.loadtxt(mine / "poses.txt").reshape(-1, 4, 4)
    poses[:, :3, 3] += place
    np.savetxt(mine / "poses.txt", poses.reshape(-1, 16))
    assert reconstruct("input=mine", "output=up.ply").status == 0
    assert reconstruct("input=mine", "output=source.ply", "source_frame=true").status == 0
    near, up, source = (load(Path(f"{name}.ply")) for name in ("near", "up", "source"))
    assert len(up.faces) == pytest.approx(len(near.faces), rel=0.2)
    np.testing.assert_allclose(source.bounds - place, near.bounds, atol=0.1)
    np.testing.assert_allclose(source.edges_unique_length, up.edges_unique_length, atol=1e-4)


def test_wrong_cameras_are_warned_of(mine: Path, reconstruct: Callable[..., Result]) -> None:
    poses = np.loadtxt(mine / "poses.txt").reshape(-1, 4, 4)
    np.savetxt(mine / "poses.txt", np.linalg.inv(poses).reshape(-1, 16))
    result = reconstruct("input=mine", "output=a.ply")
    assert result.status == 0
    (line,) = result.err.splitlines()
    assert line.startswith("warning: mine: ")
    assert "poses=world_to_camera" in line
    assert reconstruct("input=mine", "output=b.ply", "check=false").err == ""
