"""The frames a reconstruction has seen: images, cameras, and their feature maps, kept once.

Maps lie in one channels-last pool, so that any mixture of (point, frame) pairs is sampled by one
gather. Within a budget the least recently needed maps give way and are encoded again from their
image when they are needed again: the same numbers, for some time.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterator
from functools import partial

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from tf_lab.errors import TFLabError
from tf_lab.geometry import (
    check_focal,
    frustum_corners,
    frustum_planes,
    in_view,
    invert_pose,
    is_valid_pose,
    project,
)
from tf_lab.network.network import LEVELS, Network
from tf_lab.network.tokens import Measurements, measure
from tf_lab.online.lattice.table import Table
from tf_lab.stereo.depth import CHANNELS, DepthSequence
from tf_lab.support.devices import free_memory

FAR = 10_000.0  # metres, of cameras from the origin; a float32 there is exact to a millimetre
PAIRS = 1 << 19  # (point, frame) pairs measured at a time
CAMERA = {"K": (3, 3), "world_T_cam": (4, 4), "cam_T_world": (4, 4), "planes": (6, 4)}


def upload(tensor: Tensor, device: torch.device) -> Tensor:
    """A host's tensor on a device. Waits for none of the work that a GPU still has to do."""
    if device.type != "cuda":
        return tensor.to(device)
    return tensor.pin_memory().to(device, non_blocking=True)


def check_camera(K: Tensor, world_T_cam: Tensor, size: tuple[int, int]) -> None:
    """That a frame of (width, height) ``size`` may have these K [3, 3] and pose [4, 4].

    Raises:
        TFLabError: it may not.
    """
    if world_T_cam.shape != (4, 4):
        raise TFLabError(f"a pose of shape {tuple(world_T_cam.shape)}; it has to be [4, 4]")
    if not is_valid_pose(world_T_cam):
        raise TFLabError("a pose that is no rigid transform: the camera is lost")
    away = float(world_T_cam[:3, 3].abs().max())
    if away > FAR:
        raise TFLabError(
            f"a camera {away:,.0f} m from the origin, of {FAR:,.0f} at most (single precision gets "
            "coarse there); subtract the same offset from all poses"
        )
    if K.shape != (3, 3) or not K.isfinite().all():
        raise TFLabError("intrinsics that are not 3x3 finite numbers")
    if K[1, 0] != 0 or K[2].tolist() != [0, 0, 1]:  # transposed, say
        raise TFLabError(f"intrinsics {K.tolist()} that are not fx s cx / 0 fy cy / 0 0 1")
    if not (0 <= K[0, 2] < size[0] and 0 <= K[1, 2] < size[1]):
        raise TFLabError(
            f"a principal point ({K[0, 2]:g}, {K[1, 2]:g}) outside of the {size[0]}x{size[1]} "
            "image; intrinsics and image have to be of one size"
        )
    check_focal(float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2]), size)


class Frames:
    """Frames by number.

    Attributes:
        images: uint8 [3, H, W], on the host, all of them: they colour meshes, are what `save`
            writes, and give the maps again; a tenth of the maps' size or less.
        poses: (K [3, 3], world_T_cam [4, 4]) of each, on the host.
        cameras: the same by frame, with cam_T_world and the frustum's planes (normal and offset).

    Args:
        network: in evaluation mode.
        dtype: of the maps kept.
        device: where the maps are kept; sampling happens there, and the samples move.
        budget: bytes for maps; None: half of the memory that is free when the first is kept.
    """

    def __init__(
        self,
        network: Network,
        dtype: torch.dtype,
        device: torch.device | None = None,
        budget: int | None = None,
    ) -> None:
        self.network, self.dtype, self.budget = network, dtype, budget
        self.device = next(network.parameters()).device
        self.maps_device = device or self.device
        self.images: list[Tensor] = []
        self.poses: list[tuple[Tensor, Tensor]] = []
        self.cameras = Table(self.device)
        for name, shape in CAMERA.items():
            self.cameras.add_column(name, shape, torch.float32, 0)
        self._pools: dict[str, Table] = {}
        self._shape: dict[str, tuple[int, int]] = {}  # (h, w) of the maps
        self._slot = torch.empty(0, dtype=torch.int64, device=self.maps_device)  # by frame, or -1
        self._resident: OrderedDict[int, int] = OrderedDict()  # frame -> slot, oldest use first
        self._depths = DepthSequence() if network.config.stereo else None
        self._stereo = Table(self.device)  # depth maps by frame
        self._stereo_shape = (0, 0)  # (h, w) of them

    def __len__(self) -> int:
        return len(self.images)

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) of the frames, pixels."""
        return self.images[0].shape[2], self.images[0].shape[1]

    @property
    def nbytes(self) -> int:
        """Memory of the maps, those of depth included."""
        return sum(pool.nbytes() for pool in [*self._pools.values(), self._stereo])

    @property
    def crowded(self) -> bool:
        """Whether the budget has no room for the maps of all."""
        return len(self) > self._capacity()

    def map_nbytes(self, level: str) -> int:
        """Memory of one frame's map."""
        return self._pools[level].row_nbytes

    def add(self, image: Tensor, K: Tensor, world_T_cam: Tensor, encode: bool = True) -> int:
        """Keep a frame: uint8 [3, H, W], [3, 3] and [4, 4], on the host; its number.

        ``encode=False`` leaves its maps until they are needed.
        """
        number = len(self.images)
        self.images.append(image)
        self.poses.append((K, world_T_cam))
        planes = frustum_planes(*self._frustum(number)).float()
        camera = [x.flatten() for x in (K, world_T_cam, invert_pose(world_T_cam), planes)]
        self.cameras.grow(number + 1)
        parts = upload(torch.cat(camera), self.device).split([len(x) for x in camera])
        for (name, shape), part in zip(CAMERA.items(), parts, strict=True):
            self.cameras[name][number] = part.view(shape)
        if self._depths is not None:
            self._add_depth(self._depths.add(_pixels(image), K.numpy(), world_T_cam.numpy()))
        self._slot = F.pad(self._slot, (0, 1), value=-1)
        if encode:
            self._load(number)
        return number

    def truncate(self, count: int) -> None:
        """Only the first frames are there, whatever was broken off half done.

        All maps are encoded again when they are needed.
        """
        del self.images[count:], self.poses[count:]
        self.cameras.grow(count)
        self._resident.clear()
        self._slot = torch.full((count,), -1, dtype=torch.int64, device=self.maps_device)
        if self._depths is not None:
            del self._depths.views[count:]
            self._stereo.grow(min(self._stereo.rows, count))

    def frustum_box(self, frame: int) -> tuple[Tensor, Tensor]:
        """Lower and upper corner [3] (metres, on the host) of the box around a frame's frustum."""
        corners = frustum_corners(*self._frustum(frame))
        return corners.amin(0), corners.amax(0)

    def _frustum(self, frame: int) -> tuple[Tensor, Tensor, tuple[int, int], float, float]:
        K, world_T_cam = self.poses[frame]
        config = self.network.config
        return K.double(), world_T_cam.double(), self.size, config.near, config.far

    def visible(self, points: Tensor, frame: int) -> Tensor:
        """Whether a frame sees points [P, 3], occlusion apart: bool [P]."""
        K, cam_T_world = self.cameras["K"][frame], self.cameras["cam_T_world"][frame]
        uv, depth = project(points, K, cam_T_world)
        return in_view(uv, depth, self.size, self.network.config.near, self.network.config.far)

    def measure(self, level: str, points: Tensor, frames: Tensor) -> Measurements:
        """What frames [P] measure at points [P, 3], one each: [P, ...]."""
        pairs = zip(points.split(PAIRS), frames.long().split(PAIRS), strict=True)
        found = [self._measure(level, p, f) for p, f in pairs]
        if len(found) == 1:
            return found[0]
        return Measurements(*map(torch.cat, zip(*found, strict=True)))

    def _measure(self, level: str, points: Tensor, frames: Tensor) -> Measurements:
        c, config = self.cameras, self.network.config
        here = frames.to(self.maps_device)

        def sample(uv: Tensor) -> Tensor:
            found = self._sample(level, here, uv[:, 0].to(self.maps_device))
            return found.to(self.device).float()[:, None]

        K, world_T_cam, cam_T_world = (
            c[name].index_select(0, frames) for name in ("K", "world_T_cam", "cam_T_world")
        )
        depth_range = (config.near, config.far)
        stereo = None
        if self._depths is not None:
            stereo = partial(self._depth_at, frames)
        cameras = (K, world_T_cam, cam_T_world)
        one = measure(points[:, None], *cameras, self.size, depth_range, sample, stereo)
        return one.each(lambda values: values[:, 0])

    def _sample(self, level: str, frames: Tensor, uv: Tensor) -> Tensor:
        """Bilinear samples [P, C] of the frames' maps at pixels [P, 2], as `sample_maps`."""
        if len(self._resident) == len(self):
            return self._gather(level, frames, uv)
        if not self._pools:  # of a reconstruction that was loaded
            self._load(0)
        pool = self._pools[level]["maps"]
        out = pool.new_empty(len(uv), pool.shape[-1])
        for group in self._groups(frames.unique().tolist()):
            where = torch.isin(frames, torch.tensor(group, device=frames.device))
            out[where] = self._gather(level, frames[where], uv[where])
        return out

    def _gather(self, level: str, frames: Tensor, uv: Tensor) -> Tensor:
        (h, w), stride = self._shape[level], self.network.stride[level]
        x = ((uv[:, 0] + 0.5) / stride - 0.5).clamp(0, w - 1)  # the border's value beyond it
        y = ((uv[:, 1] + 0.5) / stride - 0.5).clamp(0, h - 1)
        x0, y0 = x.floor(), y.floor()
        fx, fy = x - x0, y - y0
        weights = torch.stack([(1 - fx) * (1 - fy), fx * (1 - fy), (1 - fx) * fy, fx * fy], 1)
        left, top = x0.long(), y0.long()
        right, bottom = (left + 1).clamp(max=w - 1), (top + 1).clamp(max=h - 1)
        start = self._slot[frames] * (h * w)
        upper, lower = start + top * w, start + bottom * w
        index = torch.stack([upper + left, upper + right, lower + left, lower + right], 1)
        pool = self._pools[level]["maps"].flatten(0, 1)
        return F.embedding_bag(index, pool, mode="sum", per_sample_weights=weights.to(pool.dtype))

    def _add_depth(self, depth: np.ndarray) -> None:
        if not self._stereo.rows:
            self._stereo_shape = depth.shape[1:]
            pixels = depth.shape[1] * depth.shape[2]
            self._stereo.add_column("depth", (pixels, CHANNELS), torch.float16, 0)
        self._stereo.grow(self._stereo.rows + 1)
        pixels = torch.from_numpy(depth).flatten(1).T.to(torch.float16)
        self._stereo["depth"][-1] = upload(pixels, self.device)

    def _depth_at(self, frames: Tensor, uv: Tensor) -> Tensor:
        """What the frames' depth maps say at the pixels nearest to [P, 1, 2]: [P, 1, 2]."""
        (h, w), (width, height) = self._stereo_shape, self.size
        x = ((uv[..., 0] + 0.5) * (w / width) - 0.5).clamp(0, w - 1).round().long()
        y = ((uv[..., 1] + 0.5) * (h / height) - 0.5).clamp(0, h - 1).round().long()
        index = (frames[:, None] * h + y) * w + x
        return self._stereo["depth"].flatten(0, 1)[index].float()

    def _groups(self, wanted: list[int]) -> Iterator[list[int]]:
        """The frames in groups whose maps are all there while a group is worked on."""
        wanted.sort(key=lambda frame: frame not in self._resident)  # those at hand first
        most = self._capacity()
        for i in range(0, len(wanted), most):
            group = wanted[i : i + most]
            for frame in group:
                if frame in self._resident:
                    self._resident.move_to_end(frame)
            for frame in group:
                if frame not in self._resident:
                    self._load(frame)
            yield group

    def _capacity(self) -> int:
        """How many frames' maps may be there at once."""
        if self.budget is None or not self._pools:  # before the first is kept
            return max(len(self), 1)
        return max(1, self.budget // sum(pool.row_nbytes for pool in self._pools.values()))

    def _load(self, frame: int) -> None:
        """Encode a frame into a free slot, or into that of the maps unused for longest."""
        found = self.network.encode(upload(self.images[frame][None], self.device))
        if not self._pools:
            for level in LEVELS:
                c, h, w = found[level].shape[1:]
                self._shape[level] = (h, w)
                self._pools[level] = Table(self.maps_device)
                self._pools[level].add_column("maps", (h * w, c), self.dtype, 0)
        if self.budget is None:
            self.budget = free_memory(self.maps_device) // 2
        slot = len(self._resident)
        most = self._capacity()
        if slot >= most:
            old, slot = self._resident.popitem(last=False)
            self._slot[old] = -1
        for level, pool in self._pools.items():
            pool.grow(max(slot + 1, pool.rows), most)
            pool["maps"][slot] = found[level][0].flatten(1).T.to(self.maps_device, self.dtype)
        self._slot[frame] = slot
        self._resident[frame] = slot


def _pixels(image: Tensor) -> np.ndarray:
    """uint8 [H, W, 3] of [3, H, W]."""
    return image.permute(1, 2, 0).numpy()
