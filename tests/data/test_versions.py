"""Embedded scenes and ground truth are known by a version: it is raised when what is made changes.

A cache keeps what is made, and a training is found again by the version. The kept numbers are of
the code of that version (``python tests/data/test_versions.py`` writes them, once it was raised).
"""

import json
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tf_lab.data import flats, groundtruth, rooms
from tf_lab.data.flats import generate_flat
from tf_lab.data.groundtruth import GroundTruthSettings, write_groundtruth
from tf_lab.data.rooms import RoomSettings, generate_room
from tf_lab.data.scene import Frame, write_scene
from tf_lab.meshes.files import read_mesh
from tf_lab.support.layout import GROUNDTRUTH_MESH

KEPT = Path(__file__).parents[1] / "fixtures" / "versions.json"
FILM = RoomSettings(width=48, height=36, frames=12)
SEEDS = (0, 3)
SETS: dict[str, tuple[int, Callable[[int, RoomSettings], Iterator[Frame]]]] = {
    "rooms": (rooms.VERSION, generate_room),
    "flats": (flats.VERSION, generate_flat),
}
# of a machine's rounding; half a grey value, half a centimetre
TOLERANCE = {"color": 0.5, "contrast": 0.5, "depth": 0.005, "place": 1e-4, "K": 1e-2}


def summary(frame: Frame) -> dict[str, Any]:
    """What tells a frame from another, in a few numbers."""
    assert frame.depth is not None
    return {
        "color": frame.image.mean((0, 1)).round(2).tolist(),
        "contrast": frame.image.std((0, 1)).round(2).tolist(),
        "depth": round(float(frame.depth.mean()), 4),
        "place": frame.world_T_cam[:3].round(5).ravel().tolist(),
        "K": frame.K[:2].round(3).ravel().tolist(),
    }


def made(name: str) -> dict[str, Any]:
    """The frames of the seeds."""
    version, generate = SETS[name]
    frames = {str(seed): [summary(frame) for frame in generate(seed, FILM)][::4] for seed in SEEDS}
    return {"version": version, "frames": frames}


def made_groundtruth() -> dict[str, Any]:
    """How much surface and solid there is in a room's ground truth."""
    with tempfile.TemporaryDirectory() as place:
        scene = write_scene(Path(place) / "scene", generate_room(0, FILM), {}, "room")
        write_groundtruth(scene, scene.groundtruth, GroundTruthSettings())
        mesh = read_mesh(scene.groundtruth / GROUNDTRUTH_MESH)
        seen = np.load(scene.groundtruth / "occlusion_mask.npy")
        size = mesh.vertices.max(0) - mesh.vertices.min(0)
    return {
        "version": groundtruth.VERSION,
        "area": float(mesh.area),
        "size": size.tolist(),
        "hidden": float(seen.mean()),
    }


@pytest.mark.parametrize("name", SETS)
def test_other_scenes_are_of_another_version(name: str) -> None:
    kept, now = json.loads(KEPT.read_text())[name], made(name)
    assert now["version"] == kept["version"], f"write {KEPT.name} anew"
    for seed, frames in kept["frames"].items():
        assert len(now["frames"][seed]) == len(frames)
        for frame, before in zip(now["frames"][seed], frames, strict=True):
            for key, tolerance in TOLERANCE.items():
                np.testing.assert_allclose(
                    frame[key], before[key], rtol=0, atol=tolerance, err_msg=f"raise {name}.VERSION"
                )


def test_other_ground_truth_is_of_another_version() -> None:
    kept, now = json.loads(KEPT.read_text())["groundtruth"], made_groundtruth()
    assert now["version"] == kept["version"], f"write {KEPT.name} anew"
    for key in ("area", "size", "hidden"):
        np.testing.assert_allclose(
            now[key], kept[key], rtol=1e-3, err_msg="raise groundtruth.VERSION"
        )


if __name__ == "__main__":
    found = {**{name: made(name) for name in SETS}, "groundtruth": made_groundtruth()}
    KEPT.write_text(json.dumps(found, indent=1) + "\n")
