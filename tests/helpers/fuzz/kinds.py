"""The kinds of files that are read, small, and how all of each is read."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import ModuleType

import numpy as np
import torch
import trimesh

from helpers import box_room, made_up_runs, small_shards
from helpers.layouts import LAYOUTS, room_frames
from tf_lab.commands.runs import details, listing
from tf_lab.data.digests import read_sources
from tf_lab.data.groundtruth import GroundTruth, GroundTruthSettings, write_groundtruth
from tf_lab.data.readers import open_capture
from tf_lab.data.scene import Frame, Scene, write_scene
from tf_lab.data.shard_set import open_shards
from tf_lab.data.shard_stream import read_records
from tf_lab.errors import TFLabError
from tf_lab.evaluation.protocol import evaluate
from tf_lab.experiments.inventory import find_runs, find_trainings
from tf_lab.meshes.files import read_mesh
from tf_lab.network.checkpoint import load_network, save_network
from tf_lab.network.encoders.weights import read_state_dict
from tf_lab.network.network import Network
from tf_lab.network.settings import NetworkConfig
from tf_lab.online import ReconstructionSettings, Reconstructor
from tf_lab.reporting.gallery import draw_pictures
from tf_lab.reporting.orderings import summary
from tf_lab.reporting.report import tables_page
from tf_lab.reporting.studies import open_study
from tf_lab.reporting.tables import main_table, runs_table, scene_table, seed_table
from tf_lab.training.state import PARTS, read_state


@dataclass(frozen=True)
class Kind:
    """Files of a kind.

    Attributes:
        write: makes them in a folder.
        read: reads all that is in the folder; whether a part of it was refused.
    """

    write: Callable[[Path], None]
    read: Callable[[Path], bool]


def small_frames() -> list[Frame]:
    return [
        Frame(f.name, f.image[::4, ::4], f.K / [[4], [4], [1]], f.world_T_cam, f.depth[::4, ::4])
        for f in room_frames()[:5]
        if f.depth is not None
    ]


def layout_kind(module: ModuleType) -> Kind:
    """Of captures in a layout."""

    def write(folder: Path) -> None:
        opened = module.write(folder / "whole", small_frames())
        (folder.parent / f"{folder.name}.opened").write_text(str(opened.relative_to(folder)))

    def read(folder: Path) -> bool:
        notes = [*folder.parent.glob("*.opened")]
        return read_capture(folder / notes[0].read_text(), module)

    return Kind(write, read)


def read_capture(source: Path, module: ModuleType) -> bool:
    """Open a capture and read all of it, as reconstruct and prepare do: each frame on its own."""
    capture = open_capture(source, module.OPTIONS)
    refused = bool(capture.skipped)
    for i in range(len(capture.frames)):
        refused |= refuses(lambda i=i: (capture.image(i), capture.depth(i)))  # type: ignore[misc]
    assert np.isfinite(capture.world_T_cam).all()
    assert np.isfinite(capture.K).all()
    return refused


def refuses(work: Callable[[], object]) -> bool:
    """Whether work ends in a clear error."""
    try:
        work()
    except TFLabError as error:
        assert str(error)
        return True
    return False


def write_a_scene(folder: Path) -> None:
    frames = [
        Frame(f.name, f.image, f.K, f.world_T_cam, f.depth) for f in list(box_room.frames())[:6]
    ]
    scene = write_scene(folder / "scene", frames, {"source": "analytic"}, "scene")
    write_groundtruth(scene, scene.groundtruth, GroundTruthSettings(voxel=0.1, truncation=0.3))


def read_a_scene(folder: Path) -> bool:
    refused = refuses(lambda: GroundTruth(folder / "scene" / "groundtruth"))
    read_sources(folder / "scene")
    scene = Scene(folder / "scene")
    for i in range(len(scene)):
        refused |= refuses(lambda i=i: (scene.image(i), scene.depth(i), scene.jpeg(i)))  # type: ignore[misc]
    return refused


@cache
def network() -> Network:
    torch.manual_seed(0)
    encoder = {
        "width": 4, "blocks": [1, 1, 1], "stem_stride": 2, "stem_pool": False, "norm": "group",
        "coarse_stride": 8, "fine_stride": 2, "coarse_channels": 4, "fine_channels": 4,
        "unit_norm": True,
    }  # fmt: skip
    sizes = {"width": 4, "blocks": 1, "heads": 2, "expansion": 1.0, "hidden": 4, "refine_blocks": 1}
    return Network(NetworkConfig(**sizes, encoder=encoder, fusion="gru", far=1.2)).eval()  # type: ignore[arg-type]


def write_checkpoint(folder: Path) -> None:
    save_network(network(), folder / "model.safetensors", {"training": {"commit": "1" * 40}})


def write_reconstruction(folder: Path) -> None:
    scene = Reconstructor(network(), ReconstructionSettings(resolution=0.1))
    for frame in list(box_room.frames())[:2]:
        scene.add_frame(frame.image[::2, ::2], frame.K / [[2], [2], [1]], frame.world_T_cam)
    scene.save(folder / "reconstruction.safetensors")


def read_reconstruction(folder: Path) -> bool:
    scene = Reconstructor.load(folder / "reconstruction.safetensors", network())
    return refuses(scene.mesh)


def write_torch(folder: Path) -> None:
    state = {f"{name}.weight": torch.rand(3, 4) for name in "abc"}
    torch.save(state, folder / "weights.pth")
    training: dict[str, object] = {name: kind() for name, kind in PARTS.items()}
    training |= {"global_step": 5, "hyper_parameters": {"network": {}}, "state_dict": state}
    torch.save(training, folder / "last.ckpt")


def read_torch(folder: Path) -> bool:
    paths = folder / "weights.pth", folder / "last.ckpt"
    return refuses(lambda: read_state_dict(paths[0])) | refuses(lambda: read_state(paths[1]))


def write_runs(folder: Path) -> None:
    output = folder / "outputs"
    for row, seed in (("", 0), ("fusion=avg", 0), ("fusion=avg", 1)):
        run = made_up_runs.write_run(output, row, seed, [0.5, 0.6])
        (run / "meshes").mkdir()
        trimesh.creation.box().export(run / "meshes" / f"{made_up_runs.SCENES[0]}.ply")
    training = output / "trainings" / "tiny-seed0-abc"
    training.mkdir(parents=True)
    save_network(network(), training / "model.safetensors", {"training": {"seconds": 3.5}})


def read_runs(folder: Path) -> bool:
    """As report, runs list and runs show do."""
    output = folder / "outputs"
    refused = refuses(lambda: listing(output))
    for entry in [*find_trainings(output), *find_runs(output)]:
        refused |= refuses(lambda entry=entry: details(entry))  # type: ignore[misc]
    study, remarks = open_study([output / "runs"])
    tables = main_table(study), scene_table(study), seed_table(study), runs_table(study)
    assert tables_page(study, remarks, tables)
    summary(study)
    drawn = draw_pictures(study, folder / "report" / "pictures", size=(40, 30))
    return refused or bool(remarks) or not drawn


def write_a_shard(folder: Path) -> None:
    write_a_scene(folder / "made")
    drawn = small_shards.sampler(folder / "made" / "scene")
    small_shards.write(folder / "shards", drawn, 4, 2)
    for path in sorted((folder / "made").rglob("*"), reverse=True):
        path.rmdir() if path.is_dir() else path.unlink()


def read_a_shard(folder: Path) -> bool:
    shards = open_shards(str(folder / "shards"))
    refused = False
    for shard in shards.shards:
        records = [*read_records(shard, range(min(shard.records, 100)))]
        refused |= None in records
        for record in records:
            if record is not None:
                width, height = record.size
                count = len(record.images)
                images = lambda w=width, h=height, n=count: np.empty((n, 3, h, w), np.uint8)  # noqa: E731
                refused |= refuses(lambda r=record, n=count, i=images: r.decode(range(n), i()))  # type: ignore[misc]
    return refused


def write_meshes(folder: Path) -> None:
    for name, encoding in (("ascii", "ascii"), ("binary", "binary")):
        trimesh.creation.icosphere(1).export(folder / f"{name}.ply", encoding=encoding)


def read_meshes(folder: Path) -> bool:
    return refuses(lambda: read_mesh(folder / "ascii.ply")) | refuses(
        lambda: read_mesh(folder / "binary.ply")
    )


def write_evaluation(folder: Path) -> None:
    for scene in ("a", "b"):
        truth = folder / "truth" / scene
        truth.mkdir(parents=True)
        trimesh.creation.box().export(truth / "mesh_gt.ply")
        np.save(truth / "occlusion_mask.npy", np.zeros((8, 8, 8), np.uint8))
        np.savetxt(truth / "world2grid.txt", np.diag([4.0, 4, 4, 1]))
        (folder / "predictions").mkdir(exist_ok=True)
        trimesh.creation.box().export(folder / "predictions" / f"{scene}.ply")


def read_evaluation(folder: Path) -> bool:
    result = evaluate(folder / "predictions", folder / "truth")
    json.dumps(result, allow_nan=False)
    return bool(result["failed"] or result["missing"] or result["wrong_scale"])


KINDS: dict[str, Kind] = {
    **{name: layout_kind(module) for name, module in LAYOUTS.items()},
    "scene": Kind(write_a_scene, read_a_scene),
    "checkpoint": Kind(
        write_checkpoint, lambda folder: refuses(lambda: load_network(folder / "model.safetensors"))
    ),
    "reconstruction": Kind(write_reconstruction, read_reconstruction),
    "torch": Kind(write_torch, read_torch),
    "runs": Kind(write_runs, read_runs),
    "shards": Kind(write_a_shard, read_a_shard),
    "meshes": Kind(write_meshes, read_meshes),
    "evaluation": Kind(write_evaluation, read_evaluation),
}
