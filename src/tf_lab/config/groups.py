"""The groups of settings that several commands share; those of parts lie beside the parts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from tf_lab.data.settings import ChunkSettings
from tf_lab.errors import TFLabError
from tf_lab.network.settings import MOST_FAR, NetworkSizes
from tf_lab.online.views import POLICIES
from tf_lab.support.settings import plain_values, setting


@dataclass(frozen=True, kw_only=True)
class ModelSettings(NetworkSizes):
    """The network's size (paper, Sec. 3)."""

    name: str = setting(about="begins the names of trainings and runs", shapes="weights")
    near: float = setting(
        about="metres; a view measures points from this depth", shapes="weights", least=0
    )
    far: float = setting(about="metres; to this depth", shapes="weights", above=0, most=MOST_FAR)


@dataclass(frozen=True)
class InputSettings:
    """What a token holds beside the image features."""

    depth: bool = setting(True, "of the point in the view", shapes="weights")
    ray: bool = setting(True, "from the camera to the point", shapes="weights")
    matching: bool = setting(
        False, "how the kept views' features compare at the point", shapes="weights"
    )
    stereo: bool = setting(
        False,
        "where the point is to the depth that stereo with earlier frames finds",
        shapes="weights",
        absent=False,
    )


@dataclass(frozen=True)
class TrainingSettings(ChunkSettings):
    """How chunks are drawn, the losses, and when something is saved."""

    sdf_weight: float = setting(
        0.0, "of the auxiliary signed-distance loss", shapes="weights", least=0
    )
    maps_memory: float = setting(4.0, "GiB of feature maps kept if the encoder is frozen", least=0)
    validate_every: int = setting(5000, "steps between scores of the val scenes; 0: never", least=0)
    save_every: int = setting(1000, "steps between checkpoints to resume from", least=1)

    @property
    def chunk(self) -> ChunkSettings:
        """How chunks are drawn, and nothing else; rules without weight are left out.

        Raises:
            TFLabError: no rule has any, or one is no policy of view selection.
        """
        rules = {name: w for name, w in self.rules.items() if w > 0 and POLICIES[name]}
        if not rules:
            raise TFLabError("training.rules: all weights are 0; give at least one rule some")
        names = ChunkSettings.__dataclass_fields__
        return ChunkSettings(**{**{name: getattr(self, name) for name in names}, "rules": rules})


SCHEDULES = ("inverse_sqrt", "cosine", "warmup_stable_decay")


@dataclass(frozen=True, kw_only=True)
class OptimizerSettings:
    """Adam and its schedule (paper, Sec. 3.5)."""

    lr: float = setting(about="peak learning rate", shapes="weights", least=0)
    betas: tuple[float, float] = setting(
        (0.9, 0.999), "decay of both moments", shapes="weights", least=0, most=0.999999
    )
    eps: float = setting(1e-8, "added to the denominator", shapes="weights", above=0)
    weight_decay: float = setting(about="L2, added to the gradient", shapes="weights", least=0)
    schedule: str = setting(
        about="after the warm-up: inverse_sqrt, cosine (to 0 at the last step), or "
        "warmup_stable_decay (level, then linearly to 0 over the last fifth)",
        shapes="weights",
    )
    warmup: int = setting(about="steps of linear warm-up", shapes="weights", least=0)
    steps: int = setting(
        about="in all; 0: only test what init= names; more: inverse_sqrt goes on from a finished "
        "training, the others by init=",
        shapes="weights",
        least=0,
    )
    clip: float = setting(about="largest gradient norm; 0: any", shapes="weights", least=0)
    encoder_factor: float = setting(
        about="the encoder's learning rate over the others'; 0: frozen", shapes="weights", least=0
    )

    def __post_init__(self) -> None:
        plain_values(self)
        if self.schedule not in SCHEDULES:
            raise TFLabError(
                f"optimizer.schedule={self.schedule}: choose one of {', '.join(SCHEDULES)}"
            )


ELSEWHERE = {  # arguments of lightning.Trainer that a setting of ours is for
    "max_time": "trainer.max_time",
    "max_steps": "optimizer.steps",
    "limit_train_batches": "optimizer.steps, or data.size",
    "overfit_batches": "data.size",
}


@dataclass(frozen=True)
class TrainerSettings:
    """On what and how a training computes: arguments of lightning.Trainer, and two of ours."""

    accelerator: str = setting("auto", "auto (CUDA where there is one), cpu, gpu")
    devices: Any = setting(1, "how many, or auto: all", shapes="weights")
    precision: str = setting("32-true", "or bf16-mixed, 16-mixed", shapes="weights")
    strategy: str = setting("auto", "ddp for several devices")
    compile: bool = setting(False, "torch.compile")
    workers: int = setting(1, "loader processes a device", least=0)
    max_time: str | None = setting(
        None,
        "stop after so long (days:hours:minutes:seconds), as 00:08:00:00; the same command goes on",
    )
    others: dict[str, Any] = setting(
        {},
        "more arguments of lightning.Trainer, as +trainer.others.accumulate_grad_batches=2",
        shapes="weights",
    )

    def __post_init__(self) -> None:
        for name, cure in ELSEWHERE.items():
            if name in self.others:
                raise TFLabError(f"trainer.others.{name}: give {cure} instead")


@dataclass(frozen=True)
class OnlineSettings:
    """How reconstructions compute: memory and speed.

    The mesh changes only by what low precision rounds, so precision makes another evaluation.
    """

    precision: str = setting(
        "float32",
        "of networks and feature maps: float32, float16, bfloat16; auto: bfloat16 on a GPU, else "
        "float32",
        shapes="scores",
    )
    maps_device: str = setting(
        "auto", "where feature maps are kept: auto (with the network), cpu, cuda"
    )
    maps_budget: float | None = setting(
        None,
        "GiB that they may take; what has no room is encoded again when needed. null: half of what "
        "is free when a reconstruction begins",
        above=0,
    )
    batch: int = setting(8192, "voxels fused at a time", least=1)
    compile: bool = setting(
        False,
        "torch.compile of encoder and fusion: minutes first, and no gain for model=paper on a CPU",
    )


@dataclass(frozen=True)
class LoggerSettings:
    """Where losses and scores are logged, beside metrics.csv."""

    _target_: str | None = setting(None, "a class of Lightning's loggers; null: metrics.csv only")
    project: str = setting("tf_lab", "of Weights & Biases")
    offline: bool = setting(False, "true keeps runs of Weights & Biases in the training's folder")
    others: dict[str, Any] = setting(
        {}, "more arguments of the class, as +logger.others.log_model=true"
    )


@dataclass(frozen=True)
class LauncherSettings:
    """How the jobs of a sweep run; which launcher runs them is Hydra's ``hydra/launcher``."""

    jobs: int = setting(1, "of a sweep at a time, by launcher=local", least=1)
    gpus: int = setting(
        1, "of each job, by launcher=ray; 0 where there is none, or Ray waits", least=0
    )
    cpus: int = setting(1, "cores of each job, by launcher=ray", least=1)
