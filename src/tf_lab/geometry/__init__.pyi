from .cameras import (
    check_focal as check_focal,
    covered_pixels as covered_pixels,
    grid_sample as grid_sample,
    in_view as in_view,
    pinhole as pinhole,
    pixel_directions as pixel_directions,
    project as project,
    sample_maps as sample_maps,
    scale_intrinsics as scale_intrinsics,
    view_rays as view_rays,
)
from .conventions import CHUNK as CHUNK, COARSE as COARSE, FINE as FINE
from .frustum import (
    frustum_corners as frustum_corners,
    frustum_planes as frustum_planes,
    frustum_sides as frustum_sides,
)
from .grids import (
    VoxelGrid as VoxelGrid,
)
from .poses import (
    invert_pose as invert_pose,
    is_valid_pose as is_valid_pose,
    linear_map as linear_map,
    pose_distance as pose_distance,
    rotation_about_z as rotation_about_z,
    rotation_between as rotation_between,
    transform as transform,
)
