"""A sparse model of COLMAP (structure from motion), with its images.

::

    images/                         the images, by the names that the model has for them
    sparse/0/cameras.bin, images.bin    or .txt; or in sparse/, or in the folder itself

The model has no unit of length (`open_capture` asks for the scale) and no gravity. Its camera is
OpenCV's, but the centre of the first pixel is at (0.5, 0.5). Images may have been made smaller
after the reconstruction, as a whole and in the same shape: the camera follows.
"""

from __future__ import annotations

import logging
from pathlib import Path, PurePosixPath

import numpy as np

from tf_lab.data.readers.colmap_model import ModelImage, has_model, read_model
from tf_lab.data.readers.images import at_file_size, frame_names, is_file, natural_order
from tf_lab.data.readers.parsing import pose_of_quaternion
from tf_lab.data.readers.settings import Convention
from tf_lab.data.readers.source import ColorFile, SourceCapture, SourceFrame, collect
from tf_lab.errors import TFLabError

NAME = "colmap"
LAYOUT = "images/, sparse/0/ with cameras and images (.bin or .txt)"
CONVENTION = Convention(poses="world_to_camera", quaternions="wxyz")

logger = logging.getLogger(__name__)


def detect(directory: Path) -> bool:
    """Whether there is a model where one is looked for."""
    return _model(directory) is not None


def read(directory: Path) -> SourceCapture:
    """The reconstruction in its own world frame and unit, in natural order of the images' names.

    Raises:
        TFLabError: the model or the images are missing or damaged, or no image is usable.
    """
    model = _model(directory)
    if model is None:
        raise TFLabError(f"{directory}: no sparse model in it; looked for {LAYOUT}")
    count = sum(has_model(folder) for folder in model.parent.iterdir())
    if model != directory and count > 1:
        logger.warning("%s: one of %d models; the others are left out", model, count)
    cameras, images = read_model(model)
    folder = _images(model)
    found, skipped = [], []
    for image in sorted(images, key=lambda image: natural_order(PurePosixPath(image.name))):
        file = folder / image.name
        try:
            if not is_file(file):
                raise ValueError(f"no such image in {folder}")
            if image.camera not in cameras:
                raise ValueError(f"its camera {image.camera} is not in the model")
            found.append((image.name, cameras[image.camera], _pose(image), file))
        except ValueError as error:
            skipped.append(f"{image.name[:200]}: {error}")
    names = frame_names([PurePosixPath(name) for name, _, _, _ in found])
    sized = at_file_size([camera for _, camera, _, _ in found], [file for _, _, _, file in found])
    frames = [
        SourceFrame(name, camera, pose, ColorFile(file))
        for name, camera, (_, _, pose, file) in zip(names, sized, found, strict=True)
    ]
    return collect(directory, frames, skipped, metric=False, convention=CONVENTION)


def _model(directory: Path) -> Path | None:
    """The folder of the model."""
    candidates = (directory / "sparse" / "0", directory / "sparse", directory)
    return next((folder for folder in candidates if has_model(folder)), None)


def _images(model: Path) -> Path:
    """The folder of the images, beside the model or above it."""
    above = model.resolve()
    candidates = [folder / "images" for folder in (above, *above.parents[:2])]
    found = next((folder for folder in candidates if folder.is_dir()), None)
    if found is None:
        looked = ", ".join(map(str, candidates))
        raise TFLabError(f"{model}: no folder of images with it; looked for {looked}")
    return found


def _pose(image: ModelImage) -> np.ndarray:
    """world_T_cam [4, 4]. Raises ValueError: the model has none."""
    return np.linalg.inv(pose_of_quaternion(image.quaternion, image.translation))
