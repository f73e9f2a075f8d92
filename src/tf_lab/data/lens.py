"""Cameras as sources state them: any size, any lens; and how their images become pinhole images.

Everything after the readers sees pinhole cameras without distortion (see `geometry`).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from tf_lab.data.capture import MAX_PIXELS
from tf_lab.data.settings import MOST_SIDE
from tf_lab.errors import TFLabError
from tf_lab.geometry import check_focal

MAX_SLOPE = 1.75  # x / z: pinhole images wider than 120 degrees are mostly stretched pixels
SAMPLES = 33  # a side, that tell whether a lens sees a field
MAX_ZOOM = 2.0  # how much a lens may change the field of view before it is taken for an error


@dataclass(frozen=True)
class Camera:
    """A camera as a source gives it. Pixel centres are at integers, as everywhere in tf_lab.

    Attributes:
        size: (width, height) in pixels.
        fx, fy, cx, cy: pixels.
        distortion: OpenCV's coefficients: (k1, k2, p1, p2[, k3[, k4, k5, k6]]), or of its fisheye
            model (k1, k2, k3, k4); empty without distortion.
        fisheye: which of the two models.

    Raises:
        TFLabError: the numbers are not those of a camera.
    """

    size: tuple[int, int]
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, ...] = ()
    fisheye: bool = False

    def __post_init__(self) -> None:
        width, height = self.size
        possible = 0 < width <= MOST_SIDE and 0 < height <= MOST_SIDE
        if not possible or width * height > MAX_PIXELS:
            raise TFLabError(f"an image size of {width}x{height} is impossible")
        values = (self.fx, self.fy, self.cx, self.cy, *self.distortion)
        if not np.isfinite(values).all():
            raise TFLabError(f"the intrinsics {values} have NaN or infinity")
        check_focal(self.fx, self.fy, self.cx, self.cy, self.size)
        allowed = (0, 4) if self.fisheye else (0, 4, 5, 8)
        if len(self.distortion) not in allowed:
            raise TFLabError(f"{len(self.distortion)} distortion coefficients; OpenCV has 4, 5, 8")

    @property
    def K(self) -> np.ndarray:
        """The camera matrix, float64 [3, 3]."""
        return np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1]], np.float64)

    @property
    def centred(self) -> bool:
        """Whether the principal point lies in the image, as it does unless K is of others."""
        return 0 <= self.cx < self.size[0] and 0 <= self.cy < self.size[1]

    @property
    def distorted(self) -> bool:
        """Whether straight lines are bent."""
        return self.fisheye or any(self.distortion)

    def resized(self, size: tuple[int, int]) -> Camera:
        """The camera of the images after resizing them."""
        if size == self.size:
            return self
        sx, sy = size[0] / self.size[0], size[1] / self.size[1]
        cx, cy = (self.cx + 0.5) * sx - 0.5, (self.cy + 0.5) * sy - 0.5
        return Camera(
            size, self.fx * sx, self.fy * sy, cx, cy, self.distortion, self.fisheye
        )  # distortion acts on normalised coordinates: it stays

    def pinhole(self, size: tuple[int, int]) -> Camera:
        """A camera without distortion of (width, height) ``size``, all of whose pixels it sees.

        Raises:
            TFLabError: the distortion leaves no such camera.
        """
        if not self.distorted:
            return Camera(size, *_intrinsics(self.resized(size).K))
        left, top, right, bottom = _field_of_view(self)
        fx, fy = self.size[0] / (right - left), self.size[1] / (bottom - top)
        whole = Camera(self.size, fx, fy, -0.5 - left * fx, -0.5 - top * fy)
        return whole.resized(size)

    def _opencv(self) -> tuple[np.ndarray, bool, np.ndarray]:
        return self.K, self.fisheye, np.array(self.distortion or (0.0,) * 4, np.float64)


def camera_of(K: np.ndarray, size: tuple[int, int]) -> Camera:
    """The pinhole camera of a matrix [3, 3].

    Raises:
        TFLabError: the matrix is not one, or its pixels are skewed.
    """
    shaped = np.isfinite(K).all() and np.allclose(K[[1, 2, 2, 2], [0, 0, 1, 2]], [0, 0, 0, 1])
    if not shaped or min(K[0, 0], K[1, 1]) <= 0:
        raise TFLabError("not a camera matrix (fx, fy must be positive)")
    if abs(K[0, 1]) > 1e-3 * K[0, 0]:
        raise TFLabError(f"the pixels are skewed ({K[0, 1]:g}); only rectangular ones are known")
    return Camera(size, *_intrinsics(K))


def _intrinsics(K: np.ndarray) -> tuple[float, float, float, float]:
    return float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2])


def rectify_image(image: np.ndarray, camera: Camera, pinhole: Camera) -> np.ndarray:
    """An image uint8 [H, W, 3] of ``camera`` as ``pinhole`` at its place would take it."""
    if camera == pinhole:
        return image
    if not camera.distorted:  # only the size differs
        return np.asarray(cv2.resize(image, pinhole.size, interpolation=cv2.INTER_AREA))
    maps = _maps(camera, pinhole)
    return np.asarray(cv2.remap(image, *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))


def register_depth(
    depth: np.ndarray, camera: Camera, pinhole: Camera, pinhole_T_camera: np.ndarray | None = None
) -> np.ndarray:
    """A depth map float32 [h, w] (camera z, metres, 0 unknown) as ``pinhole`` would measure it.

    Every pixel of the result is one reading, never a mean of two.

    Args:
        depth: of ``camera``.
        camera: the depth camera, maybe with distortion.
        pinhole: the colour camera.
        pinhole_T_camera: [4, 4], where the depth camera is; None: at the colour camera's place.
    """
    if camera == pinhole and pinhole_T_camera is None:
        return depth
    if pinhole_T_camera is None:
        maps = _maps(camera, pinhole)
        return np.asarray(
            cv2.remap(depth, *maps, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT)
        )
    straight = camera.pinhole(camera.size) if camera.distorted else camera
    return _moved(register_depth(depth, camera, straight), straight, pinhole, pinhole_T_camera)


def _moved(
    depth: np.ndarray, camera: Camera, target: Camera, target_T_camera: np.ndarray
) -> np.ndarray:
    """A depth map as seen from elsewhere: each pixel takes the reading that lands on it."""
    transform = target_T_camera.astype(np.float32)
    rotation, translation = transform[:3, :3], transform[:3, 3]
    known = (depth > 0) & np.isfinite(depth)
    readings = _rays(camera) * np.where(known, depth, np.float32(0))[..., None]
    points = readings @ rotation.T + translation
    rays = _rays(target)
    z = _front(points[known], camera, target)
    for _ in range(2):  # where is what the pixel sees? a better depth tells better
        column, row, seen = _pixels_of(((rays * z[..., None]) - translation) @ rotation, camera)
        found = points[row, column]
        z = np.where(seen & known[row, column] & (z > 0), found[..., 2], np.float32(0))
    landing = np.abs(found[..., :2] - rays[..., :2] * z[..., None])  # metres beside the pixel
    reading = [max(1 / camera.fx, 1 / target.fx), max(1 / camera.fy, 1 / target.fy)]
    near = (landing <= np.multiply.outer(z, reading)).all(-1)
    return np.where(near & (z > 0), z, 0).astype(np.float32)


def _front(points: np.ndarray, camera: Camera, target: Camera) -> np.ndarray:
    """About what depth [H, W] of the points [N, 3] the target sees, 0 none; without holes.

    The nearest point in each square of some readings a side.
    """
    scale = min(1.0, 0.5 * camera.fx / target.fx, 0.5 * camera.fy / target.fy)
    column, row, seen = _pixels_of(points, target, scale)
    width, height = target.size
    front = np.full((int(height * scale) + 1, int(width * scale) + 1), np.inf, np.float32)
    np.minimum.at(front, (row[seen], column[seen]), points[seen, 2])
    rows, columns = (((np.arange(n) + 0.5) * scale).astype(int) for n in (height, width))
    return np.where(np.isfinite(front), front, np.float32(0))[np.ix_(rows, columns)]


def _rays(camera: Camera) -> np.ndarray:
    """The points [H, W, 3] at depth 1 of all pixels."""
    x = (np.arange(camera.size[0]) - camera.cx) / camera.fx
    y = (np.arange(camera.size[1]) - camera.cy) / camera.fy
    rays = np.stack([*np.meshgrid(x, y), np.ones((len(y), len(x)))], axis=-1)
    return rays.astype(np.float32)


def _pixels_of(
    points: np.ndarray, camera: Camera, scale: float = 1.0
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Column and row of the pixels that points [..., 3] fall on, and whether they are in view."""
    z = np.where(points[..., 2] > 1e-6, points[..., 2], np.inf)
    u = (points[..., 0] / z * camera.fx + camera.cx + 0.5) * scale
    v = (points[..., 1] / z * camera.fy + camera.cy + 0.5) * scale
    width, height = camera.size[0] * scale, camera.size[1] * scale
    seen = np.isfinite(z) & (u >= 0) & (u < width) & (v >= 0) & (v < height)
    return np.where(seen, u, 0).astype(int), np.where(seen, v, 0).astype(int), seen


@lru_cache(maxsize=8)
def _maps(camera: Camera, pinhole: Camera) -> tuple[np.ndarray, np.ndarray]:
    return _source_pixels(camera, pinhole.K, pinhole.size)


def _source_pixels(
    camera: Camera, K: np.ndarray, size: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """Where ``camera`` sees every pixel of a pinhole image: x and y, float32 [H, W] each."""
    lens, fisheye, coefficients = camera._opencv()
    undistort = cv2.fisheye.initUndistortRectifyMap if fisheye else cv2.initUndistortRectifyMap
    maps = undistort(lens, coefficients, np.eye(3), K, size, cv2.CV_32FC1)
    return maps[0], maps[1]


def _field_of_view(camera: Camera) -> np.ndarray:
    """The slopes x / z, y / z of left, top, right and bottom [4] of what a pinhole may see.

    A proposal, as much smaller as needed, then each side as far as the lens goes.

    Raises:
        TFLabError: it is a small fraction of what the camera would see without distortion.
    """
    straight = _slopes(camera.K, camera.size)
    widest = np.clip(straight * MAX_ZOOM, -MAX_SLOPE, MAX_SLOPE)
    field, proposal = straight / MAX_ZOOM, widest
    if not _sees(camera, field):
        raise TFLabError(f"the lens distortion {camera.distortion} makes no sense; check it")
    if not camera.fisheye:  # OpenCV's is as good as the lens is ordinary, else anything
        K, _ = cv2.getOptimalNewCameraMatrix(*camera._opencv()[::2], camera.size, alpha=0)
        if np.isfinite(K).all() and K[0, 0] > 0 and K[1, 1] > 0:
            bounds = np.sort([field, widest], axis=0)
            proposal = np.clip(_slopes(K, camera.size), *bounds)
    for stage, sides in enumerate(([0, 1, 2, 3], [0], [1], [2], [3])):
        lower, upper = field, field.copy()
        upper[sides] = (widest if stage else proposal)[sides]
        margin = 0.02 * stage  # pixels: the samples of a later stage may hit the edge elsewhere
        if _sees(camera, upper, margin):
            lower = upper
        for _ in range(20):  # halves the doubt: to a millionth
            middle = (lower + upper) / 2
            lower, upper = (middle, upper) if _sees(camera, middle, margin) else (lower, middle)
        field = lower
    return field


def _slopes(K: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Slopes x / z, y / z at the left, top, right and bottom edges [4] of pinhole images."""
    edges = np.array([-0.5, -0.5, size[0] - 0.5, size[1] - 0.5])
    return (edges - K[[0, 1, 0, 1], 2]) / K[[0, 1, 0, 1], [0, 1, 0, 1]]


def _sees(camera: Camera, field: np.ndarray, margin: float = 0.0) -> bool:
    """Whether a lens maps a field [4] into its image, up to ``margin`` pixels off, unfolded."""
    left, top, right, bottom = field
    fx, fy = (SAMPLES - 1) / (right - left), (SAMPLES - 1) / (bottom - top)
    K = np.array([[fx, 0, -left * fx], [0, fy, -top * fy], [0, 0, 1]])
    x, y = _source_pixels(camera, K, (SAMPLES, SAMPLES))
    width, height = camera.size
    low, right, bottom = -0.5 - margin, width - 0.5 + margin, height - 0.5 + margin
    inside = (x >= low) & (x <= right) & (y >= low) & (y <= bottom)
    return bool(inside.all() and (np.diff(x, axis=1) > 0).all() and (np.diff(y, axis=0) > 0).all())
