"""GLB files: upright, in true colours, far from the origin too; and smaller meshes."""

import json
import struct
from pathlib import Path

import numpy as np
import pytest
import trimesh

from tf_lab.errors import TFLabError
from tf_lab.meshes.decimate import decimated
from tf_lab.meshes.files import read_mesh, write_mesh
from tf_lab.meshes.glb import glb_of, read_glb, to_linear, vertex_colors


def ball(center: tuple[float, float, float] = (1, 2, 3)) -> trimesh.Trimesh:
    """Blue below its middle, orange above."""
    mesh = trimesh.creation.icosphere(4).apply_translation(center)
    above = mesh.vertices[:, 2] > center[2]
    colors = np.where(above[:, None], [230, 120, 20], [20, 60, 230]).astype(np.uint8)
    return trimesh.Trimesh(mesh.vertices, mesh.faces, vertex_colors=colors, process=False)


def chunks(content: bytes) -> tuple[dict, bytes]:
    """The JSON and the binary part, by the format's own description."""
    magic, version, length = struct.unpack("<4sII", content[:12])
    assert (magic, version, length) == (b"glTF", 2, len(content))
    size, kind = struct.unpack("<I4s", content[12:20])
    assert kind == b"JSON"
    return json.loads(content[20 : 20 + size]), content[20 + size + 8 :]


def test_a_reader_of_the_format_finds_it_upright() -> None:
    """As the standard has it: y is up, colours are linear, and the node's matrix is by columns."""
    mesh = ball()
    tree, data = chunks(glb_of(mesh))

    def values(accessor: int, dtype: type, width: int) -> np.ndarray:
        found = tree["accessors"][accessor]
        view = tree["bufferViews"][found["bufferView"]]
        start = view.get("byteOffset", 0) + found.get("byteOffset", 0)
        count = found["count"] * width
        return np.frombuffer(data, dtype, count, start).reshape(-1, width)

    (primitive,) = tree["meshes"][0]["primitives"]
    points = values(primitive["attributes"]["POSITION"], np.float32, 3)
    (node,) = [n for n in tree["nodes"] if "mesh" in n]
    matrix = np.array(node["matrix"]).reshape(4, 4).T
    x, y, z = (matrix[:3, :3] @ points.T + matrix[:3, 3:]).astype(float)
    np.testing.assert_allclose(np.stack([x, -z, y], 1), mesh.vertices, atol=1e-5)
    colors = values(primitive["attributes"]["COLOR_0"], np.uint8, 4)
    top = y > 3.5
    # 230, 120, 20 by the formula of sRGB, worked out by hand
    assert abs(colors[top].astype(int) - [201, 48, 2, 255]).max() <= 1
    material = tree["materials"][primitive["material"]]["pbrMetallicRoughness"]
    assert material["metallicFactor"] == 0


@pytest.mark.parametrize("center", [(1, 2, 3), (5e5, -4e6, 100)])
def test_what_is_written_is_read(center: tuple[float, float, float], tmp_path: Path) -> None:
    mesh = ball(center)
    (tmp_path / "a.glb").write_bytes(glb_of(mesh))
    read = read_glb(tmp_path / "a.glb")
    np.testing.assert_allclose(read.vertices, mesh.vertices, atol=1e-4)
    np.testing.assert_array_equal(read.faces, mesh.faces)
    ours, theirs = vertex_colors(mesh), vertex_colors(read)
    assert ours is not None and theirs is not None
    assert abs(ours.astype(int) - theirs).max() < 12  # 8 bits of linear light are few in the dark


@pytest.mark.parametrize("center", [(1, 2, 3), (5e5, -4e6, 100)])
def test_a_ply_keeps_places_and_colours(center: tuple[float, float, float], tmp_path: Path) -> None:
    """For our reader, and for trimesh's."""
    mesh = ball(center)
    write_mesh(mesh, tmp_path / "a.ply")
    for read in (
        read_mesh(tmp_path / "a.ply"),
        trimesh.load_mesh(tmp_path / "a.ply", process=False),
    ):
        np.testing.assert_allclose(read.vertices, mesh.vertices, rtol=0, atol=1e-5)
        np.testing.assert_array_equal(read.faces, mesh.faces)
        np.testing.assert_array_equal(vertex_colors(read), vertex_colors(mesh))


def test_no_glb(tmp_path: Path) -> None:
    (tmp_path / "a.glb").write_bytes(b"glTF nonsense")
    with pytest.raises(TFLabError, match="not a readable GLB"):
        read_glb(tmp_path / "a.glb")
    (tmp_path / "empty.glb").write_bytes(glb_of(trimesh.Trimesh()))
    assert len(read_glb(tmp_path / "empty.glb").faces) == 0


def test_fewer_faces_of_the_same_shape_and_colours() -> None:
    pytest.importorskip("fast_simplification", reason="needs pip install 'tf_lab[decimate]'")
    mesh = ball()
    small = decimated(mesh, 0.2)
    assert len(small.faces) == pytest.approx(0.2 * len(mesh.faces), rel=0.05)
    radius = np.linalg.norm(small.vertices - [1, 2, 3], axis=1)
    np.testing.assert_allclose(radius, 1, atol=0.02)
    colors = vertex_colors(small)
    assert colors is not None
    clear = np.abs(small.vertices[:, 2] - 3) > 0.1
    above = small.vertices[:, 2] > 3
    expected = np.where(above[:, None], [230, 120, 20], [20, 60, 230])
    np.testing.assert_array_equal(colors[clear], expected[clear])
    assert decimated(mesh, 1.0) is mesh


def test_linear_light() -> None:
    """A middle grey of sRGB is a fifth of the light of white."""
    assert to_linear(np.array([0, 118, 255], np.uint8)).tolist() == [0, 46, 255]
