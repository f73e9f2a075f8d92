"""Photometric augmentation: what cameras, light and hands do to an image, drawn at random.

In the order in which it happens: blur of the optics and of motion, and the light's colour, before
the sensor; its noise; then the camera's tone curve and its JPEG.
"""

from __future__ import annotations

import cv2
import numpy as np

from tf_lab.data.settings import PhotometricSettings

SCREEN_GAMMA = 2.2  # stored values to linear light, near enough


def photometric(
    image: np.ndarray, settings: PhotometricSettings, rng: np.random.Generator
) -> np.ndarray:
    """One draw of all effects on an RGB image, uint8 [H, W, 3] -> uint8 [H, W, 3]."""
    s = settings
    light = _blurred((image.astype(np.float32) / 255) ** SCREEN_GAMMA, s, rng)
    red, blue = np.exp(rng.uniform(-s.white_balance, s.white_balance, 2))
    light *= 2.0 ** rng.uniform(-s.exposure, s.exposure) * np.array([red, 1, blue], np.float32)
    stored = light.clip(0, 1) ** (1 / SCREEN_GAMMA)
    stored += rng.uniform(0, s.noise) * rng.standard_normal(stored.shape, np.float32)
    stored = stored.clip(0, 1) ** np.exp(rng.uniform(-s.gamma, s.gamma))
    mean = stored.mean()
    stored = mean + np.exp(rng.uniform(-s.contrast, s.contrast)) * (stored - mean)
    result = (stored * 255).round().clip(0, 255).astype(np.uint8)
    if s.jpeg < 100 and rng.random() < 0.5:
        return _through_jpeg(result, int(rng.integers(s.jpeg, 101)))
    return result


def _blurred(
    light: np.ndarray, settings: PhotometricSettings, rng: np.random.Generator
) -> np.ndarray:
    """By the optics, or by motion, or both, or neither."""
    if settings.blur and rng.random() < 0.5:
        sigma = max(1e-3, rng.uniform(0, settings.blur))  # 0: OpenCV would choose one
        light = np.asarray(cv2.GaussianBlur(light, (0, 0), sigma))
    if settings.motion and rng.random() < 0.25:
        kernel = streak(rng.uniform(0, settings.motion), rng.uniform(0, np.pi))
        light = np.asarray(cv2.filter2D(light, -1, kernel))
    return light


def _through_jpeg(image: np.ndarray, quality: int) -> np.ndarray:
    """Encoded and decoded; OpenCV wants blue first."""
    _, data = cv2.imencode(".jpg", image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, quality])
    decoded = cv2.imdecode(data, cv2.IMREAD_COLOR)
    assert decoded is not None
    return np.ascontiguousarray(decoded[..., ::-1])


def streak(length: float, angle: float) -> np.ndarray:
    """The kernel [n, n] of a straight motion of ``length`` pixels at an angle (radians)."""
    half = int(np.ceil(length / 2))
    steps = np.linspace(-length / 2, length / 2, 4 * half + 1)
    kernel = np.zeros((2 * half + 1, 2 * half + 1), np.float32)
    columns = np.rint(half + steps * np.cos(angle)).astype(int)
    rows = np.rint(half + steps * np.sin(angle)).astype(int)
    np.add.at(kernel, (rows, columns), 1 / len(steps))
    return kernel
