"""Processes share the scenes of an evaluation, and report together what one reports alone."""

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import lightning as L
import numpy as np
import pytest
import torch
import trimesh
from rich.progress import Progress, TaskID

from tf_lab.data.scene import Scene
from tf_lab.errors import TFLabError
from tf_lab.evaluation import PAPER
from tf_lab.evaluation.protocol import evaluate_scene
from tf_lab.evaluation.scores import mean_scores
from tf_lab.evaluation.settings import NormalsSettings
from tf_lab.meshes.files import read_mesh
from tf_lab.online.reconstruction import Reconstruction
from tf_lab.online.settings import ReconstructionSettings
from tf_lab.training import evaluation
from tf_lab.training.datamodule import SceneDataModule
from tf_lab.training.evaluation import SceneEvaluation, evaluate_network, scene_loader

Evaluate = Callable[..., tuple[SceneEvaluation, Path]]
MORE = [NormalsSettings()]
SETTINGS = ReconstructionSettings(views=3, threshold=0.4, select="random")


class Shared:
    """What a scene loader asks of a trainer."""

    def __init__(self, rank: int, world: int) -> None:
        self.global_rank, self.world_size = rank, world


@pytest.mark.parametrize("count", range(1, 8))
@pytest.mark.parametrize("world", [1, 2, 3])
def test_each_scene_is_one_processs(count: int, world: int) -> None:
    scenes = [Path(f"scene{i}") for i in range(count)]
    shares = [[*scene_loader(scenes, Shared(rank, world))] for rank in range(world)]  # type: ignore[arg-type]
    assert all(shares)  # none is without a batch, with which Lightning would leave it behind
    own = [scene for share in shares for scene in share if scene is not None]
    assert sorted(own) == scenes
    assert max(map(len, shares)) - min(map(len, shares)) <= 1


@pytest.fixture
def scenes(box_scene: Path, tmp_path: Path) -> list[Path]:
    """Five scenes, which are the same room under names of their own."""
    found = []
    for i in range(5):
        directory = tmp_path / "scenes" / f"room{i}"
        directory.mkdir(parents=True)
        for path in box_scene.iterdir():
            (directory / path.name).symlink_to(path)
        meta = json.loads((box_scene / "scene.json").read_text())
        (directory / "scene.json").unlink()
        (directory / "scene.json").write_text(json.dumps({**meta, "name": directory.name}))
        found.append(directory)
    return found


def prediction(scene: Scene) -> trimesh.Trimesh:
    """The ground truth, twice the scene's number of centimetres off; of room 3 nothing."""
    mesh = read_mesh(scene.groundtruth / "mesh_gt.ply")
    number = int(scene.name[-1])
    mesh.apply_translation((0.02 * number,) * 3)
    return trimesh.Trimesh() if number == 3 else mesh


@pytest.fixture
def evaluate(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, scenes: list[Path]) -> Evaluate:
    """Evaluates some of the scenes by so many processes; returns the module and the run."""

    def reconstruct(
        network: object,
        scene: Scene,
        settings: object,
        progress: Callable[[int, int], None],
        color: bool,
    ) -> Reconstruction:
        assert settings is SETTINGS
        for done in (1, 2):
            progress(done, 2)
        return Reconstruction(prediction(scene), [0, 1], [f"by {os.getpid()}"])

    monkeypatch.setattr("tf_lab.training.evaluation.reconstruct", reconstruct)
    monkeypatch.setattr("tf_lab.evaluation.scenes.draw", lambda *_: None)
    monkeypatch.setattr("tf_lab.evaluation.protocol.SAMPLES", 2000)

    def run(
        name: str, count: int, groundtruth: Path | None = None, **devices: Any
    ) -> tuple[SceneEvaluation, Path]:
        network: Any = torch.nn.Identity()
        module = SceneEvaluation(network, SETTINGS, MORE, tmp_path / name, "Ours", groundtruth)
        evaluate_network(module, scenes[:count], accelerator="cpu", **devices)
        return module, tmp_path / name

    return run


@pytest.fixture
def published(scenes: list[Path], tmp_path: Path) -> Path:
    """The ground truth of the first two scenes, whose world is a turned one, in their source's."""
    source_T_world = trimesh.transformations.rotation_matrix(1.0, (1, 2, 3))
    source_T_world[:3, 3] = (5, -6, 7)
    for scene in scenes[:2]:
        cameras = {**np.load(scene / "cameras.npz"), "source_T_world": source_T_world}
        (scene / "cameras.npz").unlink()
        np.savez(scene / "cameras.npz", **cameras)
        own, given = scene / "groundtruth", tmp_path / "published" / scene.name
        given.mkdir(parents=True)
        read_mesh(own / "mesh_gt.ply").apply_transform(source_T_world).export(given / "mesh_gt.ply")
        (given / "occlusion_mask.npy").symlink_to(own / "occlusion_mask.npy")
        world2grid = np.loadtxt(own / "world2grid.txt") @ np.linalg.inv(source_T_world)
        np.savetxt(given / "world2grid.txt", world2grid)
    return tmp_path / "published"


def stored(run: Path) -> dict[str, Any]:
    return json.loads((run / "metrics.json").read_text())


def test_scenes_of_one_name_are_refused_not_mixed(evaluate: Evaluate, scenes: list[Path]) -> None:
    meta = (scenes[0] / "scene.json").read_text()
    (scenes[1] / "scene.json").write_text(meta)
    with pytest.raises(TFLabError, match="room1: a second test scene that calls itself room0"):
        evaluate("same", 2, devices=1)


def test_given_ground_truth_is_in_the_sources_world(evaluate: Evaluate, published: Path) -> None:
    """The scores are those by the scenes' own, of which it is a copy there."""
    own, given = (
        stored(evaluate(*words, devices=1)[1]) for words in [("own", 2), ("given", 2, published)]
    )
    assert own["scenes"]["room0"]["acc"] < own["scenes"]["room1"]["acc"] < 5
    for name, scores in given["scenes"].items():
        assert scores == pytest.approx(own["scenes"][name], rel=1e-3, abs=1e-3)


def test_given_ground_truth_is_what_scores(
    evaluate: Evaluate, published: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn: list[Any] = []
    monkeypatch.setattr("tf_lab.evaluation.scenes.draw", lambda *given: drawn.append(given))
    path = published / "room0" / "mesh_gt.ply"
    read_mesh(path).apply_translation((0, 0, 9)).export(path)
    module, _ = evaluate("given", 1, published, devices=1)
    assert module.results["room0"].scores["fscore"] == 0
    ((result, _, truth, *_),) = drawn
    off = truth.vertices - result.mesh.vertices
    assert np.linalg.norm(off, axis=1) == pytest.approx(9, abs=1e-3)


def test_the_bar_says_where_in_a_scene_the_work_is(
    evaluate: Evaluate, monkeypatch: pytest.MonkeyPatch
) -> None:
    shown: list[str] = []
    update = Progress.update

    def noted(bar: Progress, task: TaskID, **what: Any) -> None:
        shown.append(what["description"])
        update(bar, task, **what)

    monkeypatch.setattr(Progress, "update", noted)
    module, _ = evaluate("shown", 2, devices=1)
    first = f", last F {module.results['room0'].scores['fscore']:.3f}"
    second = f", last F {module.results['room1'].scores['fscore']:.3f}"
    assert shown == [
        *("testing room0 1/2", "testing room0 meshing", f"testing{first}"),
        *(f"testing room1 1/2{first}", f"testing room1 meshing{first}", f"testing{second}"),
    ]


def test_one_process_writes_what_the_protocol_says(evaluate: Evaluate, scenes: list[Path]) -> None:
    _, run = evaluate("one", 5, devices=1)
    metrics = stored(run)
    assert [*metrics] == ["protocol", "label", "mean", "scenes", "details"]
    assert (metrics["protocol"], metrics["label"]) == ("transformerfusion", "Ours")
    expected = {
        scene.name: evaluate_scene(prediction(scene), scene.groundtruth, metrics=MORE)
        for scene in map(Scene, scenes)
    }
    assert metrics["scenes"] == expected
    assert [*metrics["scenes"]] == [*metrics["details"]] == [scene.name for scene in scenes]
    for scores in (metrics["mean"], *metrics["scenes"].values()):
        assert [*scores] == [*PAPER, "normals"]
    assert metrics["mean"] == pytest.approx(mean_scores(expected.values()), abs=1e-12)
    assert len({scores["acc"] for scores in expected.values()}) == 5
    assert [*metrics["details"]["room0"]] == ["seconds", "keyframes", "skipped", "median_views"]
    assert sorted(path.name for path in (run / "meshes").iterdir()) == [
        f"{scene.name}.ply" for scene in scenes
    ]


def test_a_stopped_test_goes_on(evaluate: Evaluate, monkeypatch: pytest.MonkeyPatch) -> None:
    """Scenes that it came to the end of count, and are done again by other code only."""
    whole, done = stored(evaluate("whole", 4, devices=1)[1]), list[str]()
    reconstruct = evaluation.reconstruct

    def stop_at_two(network: Any, scene: Scene, *rest: Any) -> Reconstruction:
        if done.count("room2") == 0:
            done.append(scene.name)
            if scene.name == "room2":
                raise TFLabError("stopped")
        else:
            done.append(scene.name)
        return reconstruct(network, scene, *rest)

    monkeypatch.setattr(evaluation, "reconstruct", stop_at_two)
    for code, again in (("this", ["room2", "room3"]), ("other", ["room0", "room1", "room2"])):
        monkeypatch.setattr(evaluation, "code_version", lambda: "this")
        done.clear()
        with pytest.raises(TFLabError, match="stopped"):
            evaluate(code, 4, devices=1)
        monkeypatch.setattr(evaluation, "code_version", lambda code=code: code)
        _, run = evaluate(code, 4, devices=1)
        assert done[3 : 3 + len(again)] == again
        found = stored(run)
        assert found["scenes"] == whole["scenes"] and [*found["scenes"]] == [*whole["scenes"]]
        assert found["mean"] == pytest.approx(whole["mean"], abs=1e-12)
        assert not (run / "scenes").exists()


@pytest.mark.parametrize("count", [5, 1])
def test_two_processes_report_what_one_does(evaluate: Evaluate, count: int) -> None:
    """Also of fewer scenes than processes, one of which then has none."""
    one, two = (
        stored(evaluate(name, count, devices=devices, strategy=strategy)[1])
        for name, devices, strategy in (("one", 1, "auto"), ("two", 2, "ddp_fork"))
    )
    assert two["mean"] == pytest.approx(one["mean"], abs=1e-6)
    assert two["scenes"] == one["scenes"]
    assert [*two["scenes"]] == [*one["scenes"]]  # in the same order
    workers = [details["skipped"][0] for details in two["details"].values()]
    assert len({*workers}) == min(2, count)
    assert workers == [workers[i % 2] for i in range(count)]  # every other one each


def test_a_resumed_training_asks_for_its_next_batch() -> None:
    """Which is not its next step, where a step takes several."""
    asked: list[tuple[int, ...]] = []

    class Chunks:
        def stream(self, *of: int) -> list[int]:
            asked.append(of)
            return [0]

    data = SceneDataModule(Chunks(), [], seed=7, workers=0)  # type: ignore[arg-type]
    trainer: Any = Shared(1, 3)
    trainer.global_step, trainer.accumulate_grad_batches = 5, 2
    data.trainer = trainer
    data.train_dataloader()
    assert asked == [(7, 10, 1, 3)]


class Validated(L.LightningDataModule):
    """Scenes as those of a val split."""

    def __init__(self, scenes: list[Path]) -> None:
        super().__init__()
        self.scenes = scenes

    def val_dataloader(self) -> Any:
        return scene_loader(self.scenes, self.trainer)


def test_validation_is_shared_as_well(evaluate: Evaluate, scenes: list[Path]) -> None:
    module, run = evaluate("one", 3, devices=1)
    trainer = L.Trainer(
        accelerator="cpu",
        devices=2,
        strategy="ddp_fork",
        logger=False,
        enable_progress_bar=False,
        use_distributed_sampler=False,
    )
    (logged,) = trainer.validate(module, datamodule=Validated(scenes[:3]), verbose=False)
    assert logged == pytest.approx({f"val/{k}": v for k, v in stored(run)["mean"].items()})
