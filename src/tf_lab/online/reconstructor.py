"""Posed frames in, mesh out: the online procedure of the paper (Sec. 3.4), fused lazily.

In a notebook:

    from tf_lab.online import Reconstructor
    scene = Reconstructor(network)
    for image, K, world_T_cam in frames:
        scene.add_frame(image, K, world_T_cam)
    scene.mesh().show()

Adding a frame encodes it and updates the view sets of the voxels it sees, by its own logits alone.
The transformers run when a mesh is asked for, and only for voxels whose view set has changed.
Where a coarse voxel turns out to be near a surface, its fine voxels' earlier views are taken from
the kept feature maps, so that the result does not depend on when that was found out.
"""

from __future__ import annotations

import weakref
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import ClassVar, Self

import numpy as np
import torch
import trimesh
from torch import Tensor

from tf_lab.errors import TFLabError
from tf_lab.geometry import COARSE, FINE, linear_map
from tf_lab.meshes.colors import color_vertices
from tf_lab.network.network import Network
from tf_lab.online.frames import Frames, check_camera
from tf_lab.online.lattice.blocks import voxels_in
from tf_lab.online.lattice.level import Box, Level
from tf_lab.online.painting import painters
from tf_lab.online.pipeline import Pipeline
from tf_lab.online.precision import dtype_of
from tf_lab.online.settings import ReconstructionSettings, cells_per_voxel
from tf_lab.online.state import read_state, restore, write_state
from tf_lab.online.surface import Surface, whole_chunks
from tf_lab.online.views import make_policy
from tf_lab.online.views.selection import without_logits
from tf_lab.online.views.store import ViewStore
from tf_lab.support.devices import is_there


class Reconstructor:
    """Online reconstruction of one scene of any extent.

    Attributes:
        stages: what makes surface of view sets.

    Args:
        network: on its device, in evaluation mode.
        settings: test-time settings; its keyframes apply to captures, not to what is added here.
    """

    stages: ClassVar[type[Pipeline]] = Pipeline

    def __init__(
        self,
        network: Network,
        settings: ReconstructionSettings | None = None,
    ) -> None:
        self.network = network
        self.settings = settings = settings or ReconstructionSettings()
        self.device = next(network.parameters()).device
        policy = make_policy(settings.select, settings.seed)
        self.policy = policy if network.ranks_views else without_logits(policy)
        maps_device = None if settings.maps_device is None else torch.device(settings.maps_device)
        maps = dtype_of(settings.maps, self.device)
        self.frames = Frames(network, maps, maps_device, settings.maps_budget)
        self._begin()

    def _begin(self) -> None:
        """Without view sets and surface."""
        settings = self.settings
        self._broken = False  # whether work on them was broken off half done
        self.coarse = self._level("coarse", COARSE)
        self.fine = self._level("fine", FINE)
        n = cells_per_voxel(FINE, settings.resolution)
        me = weakref.proxy(self)  # in a cycle the maps would stay until Python looks for cycles
        self.pipeline = self.stages(
            self.network,
            self.coarse,
            self.fine,
            settings.threshold,
            n,
            settings.batch,
            lambda coords: me.replay(coords),
        )
        self.surface = Surface(self.fine, n)

    @torch.inference_mode()
    def add_frame(self, image: np.ndarray, K: np.ndarray, world_T_cam: np.ndarray) -> None:
        """Add a frame: uint8 [H, W, 3] RGB, its intrinsics [3, 3] and its pose [4, 4].

        Raises:
            TFLabError: the frame cannot be used; nothing has changed then. Nor has it where the
                work breaks off (an interrupt, too little memory), here or in `mesh`: the next call
                makes the view sets anew of the frames there are, which takes a while.
        """
        tensor, k, pose = self._checked(image, K, world_T_cam)
        with self._whole():
            number = self.frames.add(tensor, k, pose)
            self.see(number)

    @torch.inference_mode()
    def mesh(
        self, region: tuple[Sequence[float], Sequence[float]] | None = None, color: bool = True
    ) -> trimesh.Trimesh:
        """The surface; no faces if there is none.

        Args:
            region: lower and upper corner (metres); only the 1.5 m chunks that this box touches
                are brought up to date and returned. None: everything.
            color: whether the vertices get the images' colours.
        """
        box = None if region is None else (np.array(region[0], float), np.array(region[1], float))
        self.update(box)
        mesh = self.surface.assemble(box)
        if color and len(mesh.faces):
            held = self.fine.store.frames[self.fine.features["shown"]]
            some = painters(held.cpu().numpy(), len(self.frames))
            images = [self.frames.images[i] for i in some]
            cameras = self.frames.cameras
            color_vertices(
                mesh, images, cameras["K"].cpu()[some], cameras["world_T_cam"].cpu()[some]
            )
        return mesh

    @torch.inference_mode()
    def update(self, box: Box | None = None, roughly: bool = False) -> int:
        """Bring occupancy and mesh in a box (metres) up to date; how many chunks were meshed.

        ``roughly`` is for those who watch, see `Pipeline.update`.
        """
        with self._whole():
            self.surface.touch(self.pipeline.update(whole_chunks(box), roughly))
        return self.surface.update(box)

    @contextmanager
    def _whole(self) -> Iterator[None]:
        """Work that changes frames, view sets or what is made of them: all of it, or none."""
        self._mend()
        count = len(self.frames)
        self._broken = True
        try:
            with self.precision():
                yield
        except BaseException:
            self.frames.truncate(count)
            raise
        self._broken = False

    def _mend(self) -> None:
        """Make anew what was left half done."""
        if not self._broken:
            return
        self._begin()
        self._broken = True  # until all frames were seen
        self.frames.truncate(len(self.frames))  # without maps that were half loaded
        with self.precision():
            for frame in range(len(self.frames)):
                self.see(frame)
        self._broken = False

    @torch.inference_mode()
    def view_weights(
        self, points: np.ndarray, level: str = "fine"
    ) -> tuple[np.ndarray, np.ndarray]:
        """Which frames speak for points, and how much.

        Args:
            points: [P, 3], metres.
            level: "fine" (known near surfaces, as of the last mesh) or "coarse".

        Returns:
            Frame numbers int [P, K], -1 in empty slots, and weights [P, K], 0 in empty ones; they
            sum to 1 where any frame is held.
        """
        self._mend()
        store = self.fine if level == "fine" else self.coarse
        where = torch.as_tensor(np.asarray(points), dtype=torch.float32, device=self.device)
        rows = store.blocks.row_of((where / store.voxel).floor().long())
        frames = torch.full((len(rows), self.settings.views), -1, device=self.device)
        weights = torch.zeros(len(rows), self.settings.views, device=self.device)
        known = rows >= 0
        with self.precision():
            weights[known] = store.fuse(rows[known], self.settings.batch)[1]
        frames[known] = store.store.frames[rows[known]].long()
        return frames.cpu().numpy(), weights.cpu().numpy()

    @torch.inference_mode()
    def save(self, path: str | Path) -> None:
        """Write frames and view sets to a file, whole or not at all."""
        self._mend()
        write_state(Path(path), self.settings, self.frames, (self.coarse, self.fine))

    @classmethod
    @torch.inference_mode()
    def load(cls, path: str | Path, network: Network) -> Self:
        """Go on with what `save` wrote, with the same network.

        Raises:
            TFLabError: the file is missing, damaged, or made with another network.
        """
        path = Path(path)
        settings, tensors = read_state(path, network)
        if settings.maps_device is not None and not is_there(settings.maps_device):
            settings = replace(settings, maps_device=None)  # which changes no number
        r = cls(network, settings)
        restore(path, tensors, r.frames, (r.coarse, r.fine))
        return r

    @property
    def memory(self) -> dict[str, int]:
        """Bytes in use, by what for."""
        levels = (self.coarse, self.fine)
        return {
            "view sets": sum(x.store.nbytes + x.blocks.nbytes for x in levels),
            "features": sum(x.features.nbytes() + x.flags.nbytes() for x in levels),
            "feature maps": self.frames.nbytes,
            "images": sum(image.nbytes for image in self.frames.images),
        }

    def see(self, frame: int) -> None:
        """Offer a frame to all voxels that it sees, coarse ones and the fine ones in use."""
        voxels = voxels_in(*self.frames.frustum_box(frame), COARSE, self.device)
        known = self.fine.blocks.find(voxels)
        known = known[(known >= 0) & self._touched(voxels, frame)]
        self.see_coarse(frame, voxels)
        self.see_fine(frame, known)

    def see_coarse(self, frame: int, voxels: Tensor) -> None:
        """Offer a frame to those of coarse voxels [P, 3] that it sees."""
        voxels = voxels[self.frames.visible((voxels.float() + 0.5) * COARSE, frame)]
        self.coarse.allocate(self.coarse.blocks.block_of(voxels))
        self.offer(self.coarse, frame, self.coarse.blocks.row_of(voxels))

    def see_fine(self, frame: int, blocks: Tensor) -> None:
        """Offer a frame to those of the voxels of fine blocks [N] that it sees."""
        self._offer_seen(frame, self.fine.blocks.rows_in(blocks))

    def _offer_seen(self, frame: int, rows: Tensor) -> None:
        if len(rows):
            self.offer(self.fine, frame, rows[self.frames.visible(self.fine.points(rows), frame)])

    def offer(self, level: Level, frame: int, rows: Tensor) -> None:
        """Offer a frame to the voxels (rows [M]) of a level that it sees."""
        level.offer(frame, rows)

    def replay(self, coords: Tensor) -> None:
        """Offer all frames so far to new fine blocks at coordinates [N, 3]."""
        blocks = self.fine.blocks.find(coords)
        for frame in range(len(self.frames)):
            touched = blocks[self._touched(coords, frame)]
            self._offer_seen(frame, self.fine.blocks.rows_in(touched))

    def _touched(self, voxels: Tensor, frame: int) -> Tensor:
        """Coarse voxels [P, 3] that a frustum may touch: bool [P], true for all that it does."""
        planes = self.frames.cameras["planes"][frame]
        inside = linear_map(planes[:, :3], (voxels.float() + 0.5) * COARSE) + planes[:, 3]
        return (inside > -COARSE).all(1)  # a voxel's corner is 0.87 edges from its centre

    def _checked(
        self, image: np.ndarray, K: np.ndarray, world_T_cam: np.ndarray
    ) -> tuple[Tensor, Tensor, Tensor]:
        pixels = torch.from_numpy(np.array(image))
        k, pose = (torch.from_numpy(np.array(x)).float() for x in (K, world_T_cam))
        if pixels.ndim != 3 or pixels.shape[2] != 3 or pixels.dtype != torch.uint8:
            kind = f"{tuple(pixels.shape)} and {str(pixels.dtype).removeprefix('torch.')}"
            raise TFLabError(f"an image of shape {kind}; it has to be uint8 [H, W, 3], RGB")
        if len(self.frames) and (pixels.shape[1], pixels.shape[0]) != self.frames.size:
            width, height = self.frames.size
            raise TFLabError(
                f"a frame of {pixels.shape[1]}x{pixels.shape[0]} among those of {width}x{height}"
            )
        check_camera(k, pose, (pixels.shape[1], pixels.shape[0]))
        return pixels.permute(2, 0, 1).contiguous(), k, pose

    def _level(self, name: str, voxel: float) -> Level:
        heads = self.network.selection_heads(name) if self.policy.needs_logits else 0
        dtype = dtype_of(self.settings.logits, self.device)
        store = ViewStore(self.settings.views, heads, self.policy, self.device, dtype)
        return Level(name, voxel, self.frames, store, is_open=name == "coarse")

    def precision(self) -> AbstractContextManager[None]:
        """In which the networks compute."""
        dtype = dtype_of(self.settings.precision, self.device)
        return torch.autocast(self.device.type, dtype, enabled=dtype != torch.float32)
