"""_info.txt and frame-XXXXXX.{color.png,depth.pgm,pose.txt} of ScanNet's C++ SensReader."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from tf_lab.data.reading import ReadSettings
from tf_lab.data.scene import Frame

OPTIONS = ReadSettings()  # the format says where down is


def write(directory: Path, frames: Sequence[Frame]) -> Path:
    """Write the frames and return what to open."""
    directory.mkdir(parents=True)
    height, width = frames[0].image.shape[:2]
    intrinsics = np.eye(4)
    intrinsics[:3, :3] = frames[0].K
    K, identity = (" ".join(f"{v:g}" for v in matrix.ravel()) for matrix in (intrinsics, np.eye(4)))
    (directory / "_info.txt").write_text(
        f"m_versionNumber = 4\nm_sensorName = StructureSensor\nm_colorWidth = {width}\n"
        f"m_colorHeight = {height}\nm_depthWidth = {width}\nm_depthHeight = {height}\n"
        f"m_depthShift = 4000\nm_calibrationColorIntrinsic = {K} \n"
        f"m_calibrationColorExtrinsic = {identity} \nm_calibrationDepthIntrinsic = {K} \n"
        f"m_calibrationDepthExtrinsic = {identity} \nm_frames.size = {len(frames)}\n"
    )
    for i, frame in enumerate(frames):
        stem = directory / f"frame-{i:06d}"
        # SensReader writes JPEG; here PNG, so that images can be compared
        Image.fromarray(frame.image).save(f"{stem}.color.png")
        units = np.round(frame.depth * 4000).astype(">u2")
        header = f"P5\n{width} {height}\n65535\n".encode()
        Path(f"{stem}.depth.pgm").write_bytes(header + units.tobytes())
        np.savetxt(f"{stem}.pose.txt", frame.world_T_cam, fmt="%.9g")
    return directory
