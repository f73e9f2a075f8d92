"""Settings of drawing training chunks and of changing images; what uses them is beside it."""

from __future__ import annotations

from dataclasses import dataclass

from tf_lab.support.settings import plain_values, setting

MOST_SIDE = 32_000  # pixels; OpenCV's remap ends at 32767


@dataclass(frozen=True)
class CameraNoise:
    """How wrong cameras are made: those of real captures never are exact."""

    translation: float = setting(
        0.0, "deviation of each camera's place along each axis, metres", shapes="weights", least=0
    )
    rotation: float = setting(
        0.0, "deviation of its rotation about each axis, degrees", shapes="weights", least=0
    )
    focal: float = setting(
        0.0, "deviation of the logarithm of all focal lengths", shapes="weights", least=0, most=0.2
    )


@dataclass(frozen=True)
class ChunkSettings:
    """How chunks are drawn (paper, Sec. 3.5)."""

    chunks: int = setting(4, "1.5 m pieces of scenes a step and device", shapes="weights", least=1)
    images: int = setting(
        8, "random images a chunk, the candidates of its voxels", shapes="weights", least=1
    )
    views: tuple[int, ...] = setting(
        (),
        "K_t, valid images kept a voxel, as at test time: one of these numbers a step; []: all "
        "images, valid or not (paper)",
        shapes="weights",
        least=1,
    )
    rules: dict[str, float] = setting(
        {"random": 1.0},
        "policy that keeps them in a step, drawn by these weights",
        shapes="weights",
        least=0,
    )
    points: int = setting(1000, "occupancy samples a chunk", shapes="weights", least=1)
    near_share: float = setting(
        0.8, "of them within 10 cm of the surface", shapes="weights", least=0, most=1
    )
    coverage: float = setting(
        0.3, "least share of a chunk that an image should see", shapes="weights", least=0, most=1
    )
    seen_by: int = setting(
        8,
        "images that must; where there are no more, the best others fill up",
        shapes="weights",
        least=0,
    )
    augment: bool = setting(
        True, "chunks turned about the vertical by random angles", shapes="weights"
    )
    camera_noise: CameraNoise = setting(
        CameraNoise(), "a random share of it (0..1) a chunk: cameras as wrong as real ones"
    )

    def __post_init__(self) -> None:
        plain_values(self)


@dataclass(frozen=True)
class PhotometricSettings:
    """How strong each effect on an image is at most; 0 (jpeg: 100) is none of it."""

    exposure: float = setting(
        0.0, "stops (factors of two in linear light)", shapes="weights", least=0
    )
    white_balance: float = setting(
        0.0, "logarithm of the gains of red and blue (linear light)", shapes="weights", least=0
    )
    blur: float = setting(
        0.0, "deviation of a Gaussian, pixels; in half of the images", shapes="weights", least=0
    )
    motion: float = setting(
        0.0,
        "length of a motion blur, pixels; in a quarter of the images",
        shapes="weights",
        least=0,
    )
    noise: float = setting(
        0.0, "deviation of the sensor's noise, of a range of 0..1", shapes="weights", least=0
    )
    gamma: float = setting(
        0.0, "logarithm of the exponent of the stored values", shapes="weights", least=0
    )
    contrast: float = setting(
        0.0, "logarithm of the gain about the image's mean", shapes="weights", least=0
    )
    jpeg: int = setting(
        100, "lowest quality; in half of the images", shapes="weights", least=1, most=100
    )
