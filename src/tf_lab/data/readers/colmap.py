"""A sparse model of COLMAP (structure from motion), with its images.

::

    images/                         or input/: the images, by the names that the model has for them
    sparse/0/cameras.bin, images.bin    or .txt; or in sparse/, or in the folder itself

Of several models in sparse/ (COLMAP makes one of each part that it could not join to the others)
that with the most images is read, and the log says so; to read another, open its folder. The model
has no unit of length (`open_capture` asks for the scale) and no gravity. Its camera is OpenCV's,
but the centre of the first pixel is at (0.5, 0.5). Images may have been made smaller after the
reconstruction, as a whole and in the same shape: the camera follows.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path, PurePosixPath

import numpy as np

from tf_lab.data.readers.colmap_model import ModelImage, count_images, has_model, read_model
from tf_lab.data.readers.images import (
    at_file_size,
    frame_names,
    image_files,
    in_order,
    is_file,
    natural_order,
)
from tf_lab.data.readers.parsing import pose_of_quaternion
from tf_lab.data.readers.source import ColorFile, SourceCapture, SourceFrame, collect
from tf_lab.data.reading import Convention
from tf_lab.errors import TFLabError

NAME = "colmap"
LAYOUT = "images/, sparse/0/ with cameras and images (.bin or .txt)"
CONVENTION = Convention(poses="world_to_camera", quaternions="wxyz")
IMAGE_FOLDERS = ("images", "input")  # COLMAP's own, and that of 3D Gaussian splatting

logger = logging.getLogger(__name__)


def detect(directory: Path) -> bool:
    """Whether there is a model where one is looked for."""
    return bool(_models(directory))


def read(directory: Path) -> SourceCapture:
    """The reconstruction in its own world frame and unit, in natural order of the images' names.

    Raises:
        TFLabError: the model or the images are missing or damaged, or no image is usable.
    """
    models = _models(directory)
    if not models:
        raise TFLabError(f"{directory}: no sparse model in it; looked for {LAYOUT}")
    counts = [count_images(model) for model in models]
    model = models[counts.index(max(counts))]
    if len(models) > 1:
        logger.warning("%s: the largest of %d models, with %d images of %d; to read another, open "
                       "its folder", model, len(models), max(counts), sum(counts))  # fmt: skip
    cameras, images = read_model(model)
    folder = _images(model, [image.name for image in images])
    found, skipped = [], []
    for image in in_order(images, lambda image: PurePosixPath(image.name)):
        file = folder / image.name
        try:
            if not is_file(file):
                raise ValueError(f"no such image in {folder}")
            camera = cameras.get(image.camera, f"its camera {image.camera} is not in the model")
            if isinstance(camera, str):
                raise ValueError(camera)
            found.append((image.name, camera, _pose(image), file))
        except ValueError as error:
            skipped.append(f"{image.name[:200]}: {error}")
    skipped += _unregistered(folder, [image.name for image in images])
    names = frame_names([PurePosixPath(name) for name, _, _, _ in found])
    sized = at_file_size([camera for _, camera, _, _ in found], [file for _, _, _, file in found])
    frames = [
        SourceFrame(name, camera, pose, ColorFile(file), stated=stated)
        for name, camera, (_, stated, pose, file) in zip(names, sized, found, strict=True)
    ]
    return collect(directory, frames, skipped, metric=False, convention=CONVENTION)


def _models(directory: Path) -> list[Path]:
    """The folders of the models: those in sparse/, or that, or the folder itself."""
    sparse = directory / "sparse"
    inner = sorted(sparse.iterdir(), key=natural_order) if sparse.is_dir() else []
    several = [folder for folder in inner if has_model(folder)]
    return several or [folder for folder in (sparse, directory) if has_model(folder)][:1]


def _images(model: Path, names: Sequence[str]) -> Path:
    """The folder of the images, beside the model or above it: the first that has one of them."""
    above = model.resolve()
    candidates = [f / name for f in (above, *above.parents[:2]) for name in IMAGE_FOLDERS]
    found = [folder for folder in candidates if folder.is_dir()]
    if not found:
        looked = ", ".join(map(str, candidates))
        raise TFLabError(f"{model}: no folder of images with it; looked for {looked}")
    holding = (folder for folder in found if any(is_file(folder / name) for name in names))
    return next(holding, found[0])


def _unregistered(folder: Path, names: Sequence[str]) -> list[str]:
    """The images in the folders of those in the model that it has not, with the reason."""
    known = {folder / name for name in names}
    parents = sorted({file.parent for file in known if is_file(file)})
    files = [file for parent in parents for file in image_files(parent) if file not in known]
    return [f"{file.name}: not in the model (COLMAP found no pose for it)" for file in files]


def _pose(image: ModelImage) -> np.ndarray:
    """world_T_cam [4, 4]. Raises ValueError: the model has none."""
    return np.linalg.inv(pose_of_quaternion(image.quaternion, image.translation))
