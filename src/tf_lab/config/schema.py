"""The schema: every command's settings, typed and documented, as Hydra composes them.

A group whose parts are interchangeable (data, encoder, fusion, select) is typed by the part that
is chosen.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any, ClassVar

from omegaconf import MISSING

from tf_lab.config.groups import (
    InputSettings,
    LauncherSettings,
    LoggerSettings,
    ModelSettings,
    OnlineSettings,
    OptimizerSettings,
    TrainerSettings,
    TrainingSettings,
)
from tf_lab.data.reading import ReadSettings
from tf_lab.data.settings import MOST_SIDE, CameraNoise, PhotometricSettings
from tf_lab.data.sources import SOURCES
from tf_lab.data.sources.settings import SPLITS, Content
from tf_lab.errors import TFLabError
from tf_lab.network.encoders import ENCODERS
from tf_lab.network.fusion import FUSIONS
from tf_lab.online.settings import InferenceSettings
from tf_lab.online.views import POLICIES
from tf_lab.support.registry import Registry
from tf_lab.support.settings import MOST_SEED, setting

FIGURES = (
    *("views", "selected", "comparison", "ablations", "errors", "room"),
    *("fscore_k", "fscore_rows", "runtimes"),
)
"""The figures there are, by name; see `tf_lab.reporting.figures.catalog`."""


def check_figures(names: Sequence[str]) -> None:
    """That there are figures of these names. Raises TFLabError: one there is not."""
    if unknown := [name for name in names if name not in FIGURES]:
        given = f"figures=[{','.join(unknown)}]"
        raise TFLabError(f"{given}: there is no such figure; there are {', '.join(FIGURES)}")


PARTS: tuple[Registry[Any], ...] = (SOURCES, ENCODERS, FUSIONS, POLICIES)
TEST_ON = "test_on"
GROUPS: dict[str, Registry[Any]] = {**{parts.group: parts for parts in PARTS}, TEST_ON: SOURCES}
"""The groups that choose a part, and of which kind; of `TEST_ON` none need be chosen."""


@dataclass(frozen=True)
class NetworkSettings:
    """What a network is made of."""

    encoder: Any = MISSING
    model: ModelSettings = MISSING
    fusion: Any = MISSING
    inputs: InputSettings = field(default_factory=InputSettings)
    refine: bool = setting(True, "spatial refinement by 3D CNNs", shapes="weights")
    filter: bool = setting(True, "coarse-to-fine filtering by near-surface masks", shapes="weights")


@dataclass(frozen=True)
class TrainConfig(InferenceSettings, NetworkSettings):
    """python -m tf_lab.train"""

    data: Any = MISSING
    test_on: Any = setting(None, "test scenes of this data instead, of another choice or folder")
    select: Any = MISSING
    online: OnlineSettings = field(default_factory=OnlineSettings)
    optimizer: OptimizerSettings = MISSING
    training: TrainingSettings = MISSING
    trainer: TrainerSettings = field(default_factory=TrainerSettings)
    logger: LoggerSettings = field(default_factory=LoggerSettings)
    callbacks: dict[str, dict[str, Any]] = setting(
        {},
        "more callbacks, as +callbacks.any._target_=lightning.pytorch.callbacks.DeviceStatsMonitor"
        " (one that may change the weights makes another training)",
    )
    launcher: LauncherSettings = field(default_factory=LauncherSettings)
    seed: int = setting(
        0, "of weights, chunks and random choices", shapes="weights", least=0, most=MOST_SEED
    )
    init: str | None = setting(
        None,
        "start from these weights (a training's folder, its model.safetensors, or shipped), or go "
        "on from this state (its last.ckpt) up to optimizer.steps",
        kind="path",
    )
    init_encoder: str | None = setting(
        None,
        "an encoder's file, or a checkpoint's, in place of the encoder of init's weights; "
        "`pretrain like=` makes one that they understand",
        kind="path",
    )
    output: str = setting("outputs", "trainings/ and runs/ are made in it", kind="path")
    groundtruth: str | None = setting(
        None,
        "score test scenes by this ground truth, a folder in the published layout, not by their "
        "own",
        kind="path",
    )
    metrics: dict[str, Any] = setting(
        {}, "beside the paper's, by name, with their settings", shapes="scores"
    )
    content: Content = field(default_factory=Content)

    @property
    def tested(self) -> Any:
        """The data whose test scenes are reconstructed and scored."""
        return self.data if self.test_on is None else self.test_on


@dataclass(frozen=True)
class PretrainConfig:
    """python -m tf_lab.pretrain"""

    data: Any = MISSING
    encoder: Any = MISSING
    model: ModelSettings = MISSING
    trainer: TrainerSettings = field(default_factory=TrainerSettings)
    training: Any = None
    optimizer: Any = None
    seed: int = setting(0, "of weights and pairs", shapes="weights", least=0, most=MOST_SEED)
    steps: int = setting(
        3000,
        "in all; 0: encoder.weights are scored (and turned like=), not trained",
        shapes="weights",
        least=0,
    )
    lr: float = setting(
        3e-3, "peak learning rate; 50 steps of warm-up, then cosine to 0", shapes="weights", least=0
    )
    trunk_factor: float | None = setting(
        None,
        "the trunk's learning rate over the pyramid's; null: 0 (frozen) if it starts from "
        "what others published (imagenet, xfeat), else 1",
        shapes="weights",
        least=0,
    )
    temperature: float = setting(0.07, "of the softmax over candidates", shapes="weights", above=0)
    pairs: int = setting(8, "of images a step", shapes="weights", least=1)
    points: int = setting(320, "correspondences a pair", shapes="weights", least=1)
    epipolar: int = setting(
        8, "wrong candidates along a point's epipolar line", shapes="weights", least=0
    )
    jitter: float = setting(
        0.7,
        "deviation of a true pixel in training, pixels: real poses are never exact",
        shapes="weights",
        least=0,
    )
    augment: PhotometricSettings = setting(
        PhotometricSettings(
            exposure=1.0,
            white_balance=0.25,
            blur=1.2,
            motion=5.0,
            noise=0.04,
            gamma=0.25,
            contrast=0.25,
            jpeg=40,
        )
    )
    real: str | None = setting(
        None, "a capture with depth: scored beside the val split, never trained on", kind="path"
    )
    like: str | None = setting(
        None,
        "an encoder's file: features are turned to be like its in the end, so that networks "
        "trained with it can be trained on with this one",
        kind="path",
    )
    validate_every: int = setting(1000, "steps", least=1)
    output: str = setting(
        "outputs/encoders/${model.name}-${encoder.name}-encoder.safetensors",
        "for encoder.weights=FILE",
        kind="path",
    )


@dataclass(frozen=True)
class PretrainStereoConfig:
    """python -m tf_lab.pretrain_stereo"""

    data: Any = MISSING
    trainer: TrainerSettings = field(default_factory=TrainerSettings)
    seed: int = setting(0, "of weights and frames", shapes="weights", least=0, most=MOST_SEED)
    steps: int = setting(2000, "in all", shapes="weights", least=1)
    lr: float = setting(
        1.5e-3,
        "peak learning rate; 50 steps of warm-up, then cosine to 0",
        shapes="weights",
        least=0,
    )
    frames: int = setting(8, "a step", shapes="weights", least=1)
    camera_noise: CameraNoise = setting(
        CameraNoise(translation=0.01, rotation=0.5, focal=0.01),
        "a random share of it (0..1) a frame: cameras as wrong as real ones",
    )
    augment: PhotometricSettings = setting(
        PhotometricSettings(exposure=0.5, blur=1.0, motion=3.0, noise=0.03, gamma=0.2, jpeg=50)
    )
    real: str | None = setting(
        None, "a capture with depth: scored beside the val split, never trained on", kind="path"
    )
    validate_every: int = setting(500, "steps", least=1)
    output: str = setting(
        "outputs/stereo/stereo.safetensors",
        "the weights; copied over tf_lab/weights/stereo.safetensors they are used",
        kind="path",
    )


@dataclass(frozen=True)
class PrepareConfig:
    """python -m tf_lab.prepare"""

    data: Any = MISSING
    encoder: Any = MISSING
    model: ModelSettings = MISSING
    optimizer: Any = None
    training: TrainingSettings = MISSING
    splits: list[str] = setting([*SPLITS], "which to prepare")
    seed: int = setting(0, "of the shards' chunks", least=0, most=MOST_SEED)
    shards: str | None = setting(
        None, "a folder: the training chunks go there, too, as webdataset shards", kind="path"
    )
    shard_chunks: int = setting(10000, "in all", least=1)
    shard_size: int = setting(64, "chunks a shard", least=1)
    check: bool = setting(True, "warn of captures whose cameras are clearly wrong")
    pictures: bool = setting(False, "draw each scene's frames and ground truth, to look at")

    def __post_init__(self) -> None:
        if unknown := [split for split in self.splits if split not in SPLITS]:
            raise TFLabError(f"splits=[{','.join(unknown)}]: choose of {', '.join(SPLITS)}")


@dataclass(frozen=True)
class CaptureConfig(InferenceSettings, ReadSettings):
    """A capture and the network that reconstructs it.

    Attributes:
        replaced: settings, or groups of them, that are of no use, by the one that takes their
            place.
    """

    replaced: ClassVar[Mapping[str, tuple[str, ...]]] = {
        "input": ("data",),
        "mesh": ("data",),
        "run": ("data", "select", "online.precision", *(f.name for f in fields(InferenceSettings))),
    }
    data: Any = MISSING
    select: Any = MISSING
    online: OnlineSettings = field(default_factory=OnlineSettings)
    input: str | None = setting(
        None,
        "posed images (a folder, .sens, transforms.json, video); the layout is detected",
        kind="path",
    )
    checkpoint: str | None = setting(
        None,
        "a training's folder or its model.safetensors; null: the one that comes with tf_lab",
        kind="path",
    )
    check: bool = setting(
        True, "warn of cameras that are clearly wrong (python -m tf_lab.check says more)"
    )
    seed: int = setting(0, "of select=rnd and select=diverse", least=0, most=MOST_SEED)
    device: str = setting("auto", "auto, cpu, cuda")


@dataclass(frozen=True)
class ReconstructConfig(CaptureConfig):
    """python -m tf_lab.reconstruct"""

    output: str | None = setting(
        None,
        "the mesh, .ply or .glb; null: outputs/reconstructions/<path of the input from here>.ply, "
        "of one outside of this folder <its name>_<hash of its path>.ply",
        kind="path",
    )
    decimate: float = setting(1.0, "share of the mesh's faces that is written", above=0, most=1)
    method: str = setting(
        "network", "or plane_sweep: classical stereo at the same size, on the CPU, to compare with"
    )
    source_frame: bool = setting(
        False, "write the mesh in the source's world instead of the z-up one"
    )
    camera_noise: CameraNoise = setting(
        CameraNoise(), "make the cameras wrong first, to see what that costs"
    )
    refine_poses: bool = setting(
        False,
        "adjust the poses to what the images show, where that explains much (docs/reconstruct.md)",
    )
    score: bool = setting(
        True, "where the input has depth: score the mesh by what all of its depth maps give"
    )


@dataclass(frozen=True)
class ViewConfig(CaptureConfig):
    """python -m tf_lab.view"""

    checkpoint: Any = setting(
        None,
        "a training's folder or its model.safetensors, or a list side by side; null: the one that "
        "comes with tf_lab",
        kind="path",
        several=True,
    )
    run: Any = setting(
        None,
        "a run's folder: its test scene, with its network and settings; or a list of such side by "
        "side",
        kind="path",
        several=True,
    )
    scene: str | None = setting(None, "which test scene of the run; null: the first")
    mesh: Any = setting(
        None, "a mesh, or a list of such side by side, as it is", kind="path", several=True
    )
    groundtruth: str | None = setting(
        None, "a mesh to compare with; null: the input's own, if it has any", kind="path"
    )
    play: bool = setting(True, "add frames as soon as somebody looks")
    port: int = setting(8080, "of this machine, on which the page is", least=0, most=65535)

    def __post_init__(self) -> None:
        if sum(x is not None for x in (self.input, self.run, self.mesh)) > 1:
            raise TFLabError("give one of input=, run= and mesh=")
        if [] in (self.checkpoint, self.run, self.mesh):
            raise TFLabError("an empty list shows nothing; name what to look at")


@dataclass(frozen=True)
class FiguresConfig(CaptureConfig):
    """python -m tf_lab.figures"""

    figures: list[str] = setting(list(FIGURES), "which to draw")
    run: str | None = setting(
        None, "a run's folder: its test scenes, with its network and settings", kind="path"
    )
    scene: str | None = setting(None, "which test scene; null: the first")
    scenes: int = setting(2, "rows of the comparison: as many test scenes", least=1)
    frames: int | None = setting(
        40,
        "keyframes, evenly chosen, of which network and stereo are compared (stereo takes a second "
        "each on a CPU); null: all",
        least=2,
    )
    points: Any = setting(  # OmegaConf takes no whole numbers in lists of lists of floats
        None, "at which views are selected, [[x,y,z],...] in metres; null: some are chosen"
    )
    runs: Any = setting(
        "outputs/runs",
        "a study's folder of runs, or a list of such; comparison, ablations and errors are of its "
        "meshes, where it has any",
        kind="path",
        several=True,
    )
    study: str | None = setting(None, "key of the study, where the runs are of several")
    benchmark: str = setting(
        "outputs/benchmark/benchmark.json", "what python -m tf_lab.benchmark wrote", kind="path"
    )
    output: str = setting(
        "outputs/figures", "a folder: NAME.png, of charts .pdf; captions as .txt", kind="path"
    )

    def __post_init__(self) -> None:
        if self.input is not None and self.run is not None:
            raise TFLabError("give one of input= and run=")
        if not self.figures:
            raise TFLabError(f"figures=[]: name what to draw; there are {', '.join(FIGURES)}")
        check_figures(self.figures)


@dataclass(frozen=True)
class CheckConfig(ReadSettings):
    """python -m tf_lab.check"""

    input: str = setting(
        MISSING,
        "posed images (a folder, .sens, transforms.json, video), as for reconstruct",
        kind="path",
    )
    output: str | None = setting(None, "a folder for check.json and check.png", kind="path")


@dataclass(frozen=True)
class EvaluateConfig:
    """python -m tf_lab.evaluate"""

    predictions: str = setting(MISSING, "folder of <scene>.ply", kind="path")
    groundtruth: str = setting(
        MISSING, "folder of <scene>/{mesh_gt.ply,occlusion_mask.npy,world2grid.txt}", kind="path"
    )
    output: str | None = setting(None, "metrics as JSON", kind="path")
    seed: int = setting(0, "of the points sampled on the predicted meshes", least=0, most=MOST_SEED)
    metrics: dict[str, Any] = setting({}, "beside the paper's, by name, with their settings")


@dataclass(frozen=True)
class ReportConfig:
    """python -m tf_lab.report"""

    runs: Any = setting(
        "outputs/runs", "a folder of runs, or a list of such", kind="path", several=True
    )
    output: str = setting("outputs/report", "tables, charts and pictures", kind="path")
    study: str | None = setting(
        None, "key of the study, where the runs are of several; null: the one with most runs"
    )
    pictures: bool = setting(
        True, "draw each test scene under every row, where the runs have meshes"
    )
    figures: list[str] = setting(
        [name for name in FIGURES if not name.startswith("fscore")],
        "the paper's other figures, where the runs have what they show; [] for none",
    )
    benchmark: str = setting(
        "outputs/benchmark/benchmark.json", "what python -m tf_lab.benchmark wrote", kind="path"
    )
    pages: bool = setting(True, "the study and each run as one HTML file, to open offline or mail")
    keep: bool = setting(False, "copy the runs' small files to OUTPUT/runs, to be committed")

    def __post_init__(self) -> None:
        check_figures(self.figures)


@dataclass(frozen=True)
class BenchmarkConfig(NetworkSettings):
    """python -m tf_lab.benchmark"""

    data: Any = MISSING
    optimizer: Any = None
    training: Any = None
    online: OnlineSettings = field(default_factory=lambda: OnlineSettings(precision="auto"))
    device: str = setting("auto", "auto, cpu, cuda")
    width: int = setting(640, "pixels", least=1, most=MOST_SIDE)
    height: int = setting(480, "pixels", least=1, most=MOST_SIDE)
    frames: int = setting(20, "added to every room before anything is timed", least=1)
    timed: int = setting(20, "frames over which lazy fusion is timed", least=1)
    eager_timed: int = setting(2, "the same for eager fusion, which takes much longer", least=1)
    eager: bool = setting(True, "false leaves the eager measurements out")
    parts: list[str] = setting(
        ["tables", "live"],
        "what is measured: the paper's tables, with the network below; live viewing of a test room "
        "by the shipped checkpoint",
    )
    live_frames: int = setting(260, "of the room, at most, in live viewing", least=2)
    views: list[int] = setting([4, 8, 16], "K, views kept a voxel", least=1)
    rooms: list[int] = setting([1, 2, 4, 8], "scene sizes", least=1)
    counts: list[int] = setting([10, 500], "frames already there", least=1)
    resolution: float = setting(0.02, "metres, marching cubes", above=0)
    seed: int = setting(0, "of the networks' weights", least=0, most=MOST_SEED)
    output: str = setting("outputs/benchmark", "a folder for table, JSON and chart", kind="path")


CONFIGS: dict[str, type] = {
    "train": TrainConfig,
    "pretrain": PretrainConfig,
    "pretrain_stereo": PretrainStereoConfig,
    "prepare": PrepareConfig,
    "reconstruct": ReconstructConfig,
    "check": CheckConfig,
    "evaluate": EvaluateConfig,
    "report": ReportConfig,
    "view": ViewConfig,
    "figures": FiguresConfig,
    "benchmark": BenchmarkConfig,
}
