"""What figures are drawn of, and what comes of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
import trimesh

from tf_lab.data.capture import Capture
from tf_lab.errors import TFLabError
from tf_lab.meshes.raycast import overview_camera
from tf_lab.online.reconstruction import Reconstruction
from tf_lab.reporting.studies import Study

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Size = tuple[int, int]
TRUTH = "Ground truth"


@dataclass(frozen=True)
class Drawn:
    """A figure, its caption, and whether it is a chart (else a picture of meshes)."""

    figure: Figure
    caption: str
    chart: bool = False


@dataclass(frozen=True)
class Shown:
    """A capture, what a network made of it, and its ground truth (metres), if there is one."""

    capture: Capture
    result: Reconstruction
    truth: trimesh.Trimesh | None


@dataclass(frozen=True)
class Compared:
    """A scene's meshes (metres) by method, in the order in which they are shown.

    Attributes:
        scene: its name.
        meshes: by method; some may be empty.
        truth: the ground truth, if there is one.
        fscores: by method, where known.
        frames: how many every mesh was made of, the same ones; None: of those its method takes.
    """

    scene: str
    meshes: Mapping[str, trimesh.Trimesh]
    truth: trimesh.Trimesh | None
    fscores: Mapping[str, float] = field(default_factory=dict)
    frames: int | None = None

    def made_of(self) -> str:
        """What a caption says of the frames."""
        return "" if self.frames is None else f" Each mesh is of the same {self.frames} frames."

    def title(self, method: str) -> str:
        """A method with its F-score."""
        score = self.fscores.get(method)
        return method if score is None else f"{method}\nF {score:.3f}"

    def camera(self, size: Size) -> tuple[np.ndarray, np.ndarray, float]:
        """K, world_T_cam and the cut of a picture from above, the same for all meshes.

        Raises:
            TFLabError: all are empty.
        """
        every = [*([] if self.truth is None else [self.truth]), *self.meshes.values()]
        shown = next((mesh for mesh in every if len(mesh.faces)), None)
        if shown is None:
            raise TFLabError(f"{self.scene}: there is no surface to draw; all meshes are empty")
        return overview_camera(shown.bounds, size)


@dataclass(frozen=True)
class Material:
    """What figures can be drawn of, each got when a figure asks for it.

    Each raises a TFLabError that says what is missing.

    Attributes:
        shown: a scene with all that a network keeps of it.
        compared: scenes under several methods.
        ablations: a scene under every row, or under variations of a network.
        study: finished runs.
        runtimes: what ``python -m tf_lab.benchmark`` measured.
        points: [P, 3] metres, at which the views kept are shown; None: some are chosen.
    """

    shown: Callable[[], Shown]
    compared: Callable[[], Sequence[Compared]]
    ablations: Callable[[], Compared]
    study: Callable[[], Study]
    runtimes: Callable[[], Mapping[str, Any]]
    points: np.ndarray | None = None
