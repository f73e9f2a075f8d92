import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh

from tf_lab.errors import TFLabError
from tf_lab.evaluation import PAPER
from tf_lab.evaluation.protocol import evaluate, evaluate_scene, samples, scene_names
from tf_lab.meshes.files import read_mesh

PLY = """ply
format ascii 1.0
element vertex {vertices}
property float x
property float y
property float z
element face {faces}
property list uchar int vertex_indices
end_header
"""
SQUARE = "0 0 0\n1 0 0\n1 1 0\n0 1 0\n"
WORST: dict[str, float] = {
    "acc": 100,
    "compl": 100,
    "chamfer": 100,
    "prec": 1,
    "recall": 0,
    "fscore": 0,
}


def grid_plane(height: float = 0.0, n: int = 41) -> trimesh.Trimesh:
    """A unit square in a grid of n x n vertices (2.5 cm apart by default)."""
    axis = np.linspace(0, 1, n)
    x, y = np.meshgrid(axis, axis, indexing="ij")
    vertices = np.stack([x, y, np.full_like(x, height)], axis=-1).reshape(-1, 3)
    i = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).reshape(-1)
    faces = np.concatenate([np.stack([i, i + n, i + 1], 1), np.stack([i + n, i + n + 1, i + 1], 1)])
    return trimesh.Trimesh(vertices, faces, process=False)


def write_truth(
    directory: Path,
    mesh: trimesh.Trimesh,
    mask: np.ndarray | None = None,
    world2grid: np.ndarray | None = None,
) -> Path:
    directory.mkdir(parents=True, exist_ok=True)
    mesh.export(directory / "mesh_gt.ply")
    np.save(directory / "occlusion_mask.npy", np.zeros((3, 4, 5)) if mask is None else mask)
    if world2grid is None:  # 1 m voxels, the scene well inside
        world2grid = np.eye(4)
        world2grid[:3, 3] = 0.5
    np.savetxt(directory / "world2grid.txt", world2grid)
    return directory


@pytest.fixture
def folders(tmp_path: Path) -> tuple[Path, Path]:
    """Two scenes: one predicted 7 cm off, one exactly."""
    predictions, truth = tmp_path / "predictions", tmp_path / "groundtruth"
    predictions.mkdir()
    for name, height in (("far", 0.07), ("near", 0.0)):
        write_truth(truth / name, grid_plane())
        grid_plane(height).export(predictions / f"{name}.ply")
    return predictions, truth


def brute_force(
    mesh: trimesh.Trimesh, truth: np.ndarray, mask: np.ndarray, w2g: np.ndarray
) -> dict:
    """The whole protocol, written apart: own area-weighted samples, loops, dense distances."""
    rng = np.random.default_rng(1234)
    corners = mesh.vertices[mesh.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(normals, axis=1)
    face = rng.choice(len(area), 200_000, p=area / area.sum())
    u, v = rng.random((2, len(face), 1))
    flip = u + v > 1
    u, v = np.where(flip, 1 - u, u), np.where(flip, 1 - v, v)
    a, b, c = corners[face].transpose(1, 0, 2)
    points = a + u * (b - a) + v * (c - a)
    homogeneous = np.concatenate([points, np.ones((len(points), 1))], axis=1)
    index = (homogeneous @ w2g.T)[:, :3]
    seen = np.zeros(len(index))
    for corner in np.ndindex(2, 2, 2):
        voxel = np.floor(index).astype(int) + corner
        inside = ((voxel >= 0) & (voxel < mask.shape)).all(1)
        x, y, z = np.where(inside[:, None], voxel, 0).T
        weight = (1 - np.abs(index - voxel)).prod(1)
        seen += np.where(inside & ~mask[x, y, z], weight, 0)
    visible = seen >= 1 - 1e-5
    dense = np.concatenate(
        [np.linalg.norm(part[:, None] - truth, axis=-1) for part in np.split(points, 50)]
    )
    to_truth = np.minimum(dense.min(1), 1)[visible]
    to_mesh = np.minimum(dense.min(0), 1)
    prec, recall = (to_truth <= 0.05).mean(), (to_mesh <= 0.05).mean()
    acc, compl = 100 * to_truth.mean(), 100 * to_mesh.mean()
    f = 2 * prec * recall / (prec + recall) if prec + recall else 0.0
    values = (acc, compl, (acc + compl) / 2, prec, recall, f)
    return dict(zip(PAPER, values, strict=True)) | {"visible": float(visible.mean())}


@pytest.mark.parametrize("seed", range(3))
def test_agrees_with_a_brute_force_version_on_random_meshes(tmp_path: Path, seed: int) -> None:
    rng = np.random.default_rng(seed)
    box = np.array([1.0, 2.0, 3.0]) + rng.random(3)
    offset = rng.uniform(-3, 3, 3)
    truth = trimesh.creation.icosphere(subdivisions=2, radius=0.5)
    truth.apply_scale(box)
    truth.apply_translation(offset)
    prediction = truth.copy()
    prediction.apply_translation(rng.normal(0, 0.05, 3))
    prediction.update_faces(prediction.triangles_center[:, 1] < offset[1] + 0.5)  # half is missing
    shape = (6, 9, 14)
    mask = rng.random(shape) < 0.02
    world2grid = np.eye(4)
    scale = (np.array(shape) - 1) / (1.05 * box)  # the axes differ; the grid just holds the truth
    world2grid[:3, :3] = np.diag(scale)
    world2grid[:3, 3] = (np.array(shape) - 1) / 2 - scale * offset
    write_truth(tmp_path, truth, mask, world2grid)

    result = evaluate_scene(prediction, tmp_path)
    expected = brute_force(prediction, truth.vertices, mask, world2grid)
    assert 0.2 < expected.pop("visible") < 0.9  # the mask matters
    for key in ("acc", "compl", "chamfer"):  # other random samples: close, not equal
        assert result[key] == pytest.approx(expected[key], abs=0.15)
    for key in ("prec", "recall", "fscore"):
        assert result[key] == pytest.approx(expected[key], abs=0.01)


def test_known_planes(folders: tuple[Path, Path]) -> None:
    predictions, truth = folders
    result = evaluate(predictions, truth)
    assert result["protocol"] == "transformerfusion"
    assert set(result["scenes"]) == {"near", "far"}
    near, far = result["scenes"]["near"], result["scenes"]["far"]
    # Uniform in a square of 2.5 cm, the nearest corner is 0.3826 sides away on average.
    assert near["acc"] == pytest.approx(0.3826 * 2.5, rel=0.01)
    assert near["fscore"] == 1
    assert far["compl"] == pytest.approx(7, abs=0.02)
    assert (far["prec"], far["recall"], far["fscore"]) == (0, 0, 0)
    assert result["mean"]["fscore"] == 0.5
    assert result["settings"] == {"seed": 0, "threshold_cm": 5.0, "n_points": 200_000}
    assert result["missing"] == [] and result["failed"] == {}


def test_a_point_cloud_is_scored_by_its_points(tmp_path: Path) -> None:
    """Half of the truth's vertices, 3 cm above them: distances by hand."""
    truth = write_truth(tmp_path / "scene", grid_plane(n=3))  # 50 cm apart
    vertices = grid_plane(0.03, n=3).vertices[:6]  # x = 0 and x = 0.5, not x = 1
    cloud = trimesh.PointCloud(vertices)
    cloud.export(tmp_path / "p.ply")
    scores = evaluate_scene(tmp_path / "p.ply", truth)
    same = evaluate_scene(trimesh.Trimesh(vertices, process=False), truth)
    assert scores == pytest.approx(same, abs=1e-5)  # the file holds float32
    assert scores == evaluate_scene(str(tmp_path / "p.ply"), str(truth))
    assert same == evaluate_scene(cloud, truth)
    compl = 100 * (6 * 0.03 + 3 * np.hypot(0.5, 0.03)) / 9
    expected = {"acc": 3, "compl": compl, "chamfer": (3 + compl) / 2, "prec": 1, "recall": 2 / 3}
    assert scores == pytest.approx({**expected, "fscore": 0.8}, abs=1e-5)


def test_of_a_large_point_cloud_some_points_count(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tf_lab.evaluation.protocol.SAMPLES", 100)
    cloud = trimesh.Trimesh(np.random.default_rng(0).random((1000, 3)), process=False)
    (first, faces), (again, _) = samples(cloud), samples(cloud)
    assert faces is None
    assert len(np.unique(first, axis=0)) == 100
    np.testing.assert_array_equal(first, again)
    assert {*map(tuple, first)} <= {*map(tuple, np.asarray(cloud.vertices))}


@pytest.mark.parametrize(
    ("factor", "expected"),
    [
        (1000, "about 1000 times as large as the ground truth, as if in millimetres"),
        (100, "about 100 times as large as the ground truth, as if in centimetres"),
        (39.37, "about 39.37 times as large as the ground truth, as if in inches"),
        (3.28, "about 3.28 times as large as the ground truth, as if in feet"),
        (7, r"about (6\.[5-9]|7) times as large as the ground truth; both must be in metres"),
        (0.01, r"about 0\.(009[5-9]|01) times as large as the ground truth; both must"),
        (1.0, None),
        (1.9, None),
        (0.6, None),
    ],
)
def test_a_wrong_scale_is_told(
    folders: tuple[Path, Path],
    factor: float,
    expected: str | None,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Of a mesh and of a point cloud, outliers or not."""
    monkeypatch.setattr("tf_lab.evaluation.protocol.SAMPLES", 2000)
    predictions, truth = folders
    for path in predictions.iterdir():
        mesh = trimesh.load(path, process=False)
        mesh.apply_scale(factor)
        if path.stem == "far":
            points = np.concatenate([mesh.vertices, factor * np.array([[90, 90, 90.0]])])
            mesh = trimesh.PointCloud(points)
        mesh.export(path)
    result = evaluate(predictions, truth)
    assert result["point_clouds"] == ["far"]
    told = result["wrong_scale"]
    assert set(told) == (set() if expected is None else {"far", "near"})
    assert all(re.match(str(expected), text) for text in told.values()), told


def test_samples_follow_area_not_faces(tmp_path: Path) -> None:
    """A fine patch at the right height and one coarse square of the same area 20 cm off."""
    coarse = trimesh.Trimesh(
        [[0, 1, 0.2], [1, 1, 0.2], [1, 2, 0.2], [0, 2, 0.2]], [[0, 1, 2], [0, 2, 3]]
    )
    right = grid_plane()
    right.apply_translation((0, 1, 0))
    write_truth(tmp_path, grid_plane() + right)
    result = evaluate_scene(grid_plane() + coarse, tmp_path)
    assert result["prec"] == pytest.approx(0.5, abs=0.01)


def test_the_seed_alone_decides(folders: tuple[Path, Path]) -> None:
    predictions, truth = folders
    again = evaluate_scene(predictions / "near.ply", truth / "near", seed=0)
    assert evaluate_scene(predictions / "near.ply", truth / "near", seed=0) == again
    other = evaluate_scene(predictions / "near.ply", truth / "near", seed=1)
    assert other != again
    assert evaluate(predictions, truth, seed=1)["scenes"]["near"] == other


@pytest.mark.parametrize(
    "content",
    [
        PLY.format(vertices=0, faces=0),
        PLY.format(vertices=4, faces=1) + SQUARE + "3 0 0 1\n",  # no area
    ],
)
def test_empty_meshes_score_as_missing_ones(tmp_path: Path, content: str) -> None:
    truth = write_truth(tmp_path / "scene", grid_plane())
    (tmp_path / "p.ply").write_text(content)
    assert evaluate_scene(tmp_path / "p.ply", truth) == WORST
    assert evaluate_scene(tmp_path / "none.ply", truth) == WORST
    assert evaluate_scene(None, truth) == WORST


@pytest.mark.parametrize(("file", "cure"), [("far.obj", "convert"), ("far.PLY", "rename")])
def test_a_prediction_in_another_format_is_told(
    folders: tuple[Path, Path], file: str, cure: str
) -> None:
    predictions, groundtruth = folders
    (predictions / "far.ply").rename(predictions / file)
    result = evaluate(predictions, groundtruth)
    assert result["missing"] == []  # which are scored
    assert f"{file}: predictions are read from far.ply; {cure} it" in result["failed"]["far"]


def test_a_mesh_with_a_vertex_that_is_no_number(tmp_path: Path) -> None:
    truth = write_truth(tmp_path / "scene", grid_plane(n=3))
    broken = grid_plane(n=3)
    broken.vertices[0] = np.nan
    with pytest.raises(TFLabError, match="NaN"):
        evaluate_scene(broken, truth)


def test_a_texture_that_is_not_there_is_not_missed(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    truth = write_truth(tmp_path / "scene", grid_plane(n=3))
    grid_plane(n=3).export(tmp_path / "p.ply", encoding="ascii")
    text = (tmp_path / "p.ply").read_text()
    (tmp_path / "p.ply").write_text(
        text.replace("ascii 1.0\n", "ascii 1.0\ncomment TextureFile t.png\n")
    )
    assert evaluate_scene(tmp_path / "p.ply", truth) == evaluate_scene(grid_plane(n=3), truth)
    assert "Traceback" not in "".join(capfd.readouterr())


def test_a_missing_prediction_counts_in_the_mean_and_is_told(folders: tuple[Path, Path]) -> None:
    predictions, truth = folders
    (predictions / "far.ply").unlink()
    result = evaluate(predictions, truth)
    assert (result["missing"], result["empty"]) == (["far"], [])
    assert result["scenes"]["far"] == WORST
    assert result["mean"]["prec"] == 1 and result["mean"]["recall"] == 0.5


def test_the_command_says_what_is_missing_empty_or_of_no_scene(
    folders: tuple[Path, Path], tmp_path: Path
) -> None:
    predictions, _ = folders
    (predictions / "far.ply").rename(predictions / "Far.ply")
    (predictions / "near.ply").write_text(PLY.format(vertices=0, faces=0))
    done = run("predictions=predictions", "groundtruth=groundtruth", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-3:] == [
        "no prediction, scored as empty: far",
        "of no scene: 1 other file, such as Far.ply",
        "no surface in it, scored as empty: near",
    ]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "not a readable PLY"),
        (b"junk", "not a readable PLY"),
        (grid_plane().export(file_type="ply")[:-30], "not a readable PLY"),
        (PLY.format(vertices=4, faces=2).encode() + SQUARE.encode() + b"3 0 1 2\n", "fewer"),
        (PLY.format(vertices=4, faces=1).encode() + SQUARE.encode() + b"3 0 1 9\n", "refers"),
        (PLY.format(vertices=1, faces=0).encode() + b"nan 0 0\n", "NaN"),
    ],
)
def test_damaged_meshes_are_errors_that_name_the_file(
    tmp_path: Path, content: bytes, message: str
) -> None:
    path = tmp_path / "broken.ply"
    path.write_bytes(content)
    with pytest.raises(TFLabError, match=rf"broken\.ply: .*{message}"):
        read_mesh(path)


def test_vertices_and_quads_are_read_as_stored(tmp_path: Path) -> None:
    """Ground-truth points are the stored vertices: none merged, none dropped."""
    path = tmp_path / "quad.ply"
    path.write_text(PLY.format(vertices=6, faces=1) + SQUARE + "1 1 0\n5 5 5\n4 0 1 2 3\n")
    mesh = read_mesh(path)
    assert len(mesh.vertices) == 6 and mesh.area == pytest.approx(1)


def damage(scene: Path, file: str) -> None:
    path = scene / file
    if file == "mesh_gt.ply":
        path.write_text(PLY.format(vertices=0, faces=0))
    elif file == "occlusion_mask.npy":
        np.save(path, np.zeros((3, 4)))
    else:
        np.savetxt(path, np.eye(3))


@pytest.mark.parametrize("file", ["mesh_gt.ply", "occlusion_mask.npy", "world2grid.txt"])
@pytest.mark.parametrize("how", ["missing", "garbage", "wrong"])
def test_a_broken_scene_is_named_and_the_others_go_on(
    folders: tuple[Path, Path], file: str, how: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tf_lab.evaluation.protocol.SAMPLES", 2000)
    predictions, truth = folders
    if how == "missing":
        (truth / "far" / file).unlink()
    elif how == "garbage":
        (truth / "far" / file).write_bytes(b"\x00\x01garbage")
    else:
        damage(truth / "far", file)
    result = evaluate(predictions, truth)
    assert set(result["scenes"]) == {"near"}
    assert str(truth / "far" / file) in result["failed"]["far"]
    assert result["mean"] == result["scenes"]["near"]


@pytest.mark.parametrize("matrix", [np.zeros((4, 4)), np.full((4, 4), np.nan), np.eye(4) + 1])
def test_impossible_matrices_are_refused(tmp_path: Path, matrix: np.ndarray) -> None:
    with pytest.raises(TFLabError, match=r"world2grid\.txt"):
        evaluate_scene(grid_plane(), write_truth(tmp_path, grid_plane(), None, matrix))


def test_folders_that_make_no_sense(folders: tuple[Path, Path], tmp_path: Path) -> None:
    predictions, truth = folders
    (truth / ".partial-x").mkdir()
    (truth / "notes.txt").touch()
    assert scene_names(truth) == ["far", "near"]
    with pytest.raises(TFLabError, match="no such folder"):
        evaluate(tmp_path / "typo", truth)
    with pytest.raises(TFLabError, match="no such folder"):
        evaluate(predictions, tmp_path / "typo")
    with pytest.raises(TFLabError, match="no scene folder"):
        evaluate(predictions, truth / "far")
    for name in ("far", "near"):
        (truth / name / "mesh_gt.ply").unlink()
    with pytest.raises(TFLabError, match="no scene could be evaluated"):
        evaluate(predictions, truth)


def run(*arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "tf_lab.evaluate", *arguments],
        cwd=cwd,
        capture_output=True,
        text=True,
        timeout=120,
    )


def test_the_command(folders: tuple[Path, Path], tmp_path: Path) -> None:
    done = run(
        "predictions=predictions", "groundtruth=groundtruth", "output=out/m.json", cwd=tmp_path
    )
    assert done.returncode == 0, done.stderr
    assert [line.split()[0] for line in done.stdout.splitlines()[2:]] == ["far", "near", "mean"]
    written = json.loads((tmp_path / "out" / "m.json").read_text())
    assert {"protocol", "mean", "scenes", "settings"} <= set(written)
    assert written == evaluate(*folders)
    assert {p.name for p in tmp_path.iterdir()} == {"predictions", "groundtruth", "out"}


def test_the_command_ends_with_2_and_keeps_the_good_scenes(
    folders: tuple[Path, Path], tmp_path: Path
) -> None:
    (folders[0] / "far.ply").write_bytes(b"junk")
    done = run(
        f"predictions={folders[0]}", f"groundtruth={folders[1]}", "output=m.json", cwd=tmp_path
    )
    assert done.returncode == 2
    assert "near" in done.stdout and "far.ply" in done.stderr and "Traceback" not in done.stderr
    assert set(json.loads((tmp_path / "m.json").read_text())["scenes"]) == {"near"}


def test_the_command_without_a_folder(tmp_path: Path) -> None:
    done = run("predictions=typo", "groundtruth=typo", cwd=tmp_path)
    assert done.returncode == 2 and "typo: no such folder" in done.stderr
    assert "Traceback" not in done.stderr
