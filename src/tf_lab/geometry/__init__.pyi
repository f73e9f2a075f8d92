from .cameras import (
    check_focal as check_focal,
)
from .cameras import (
    covered_pixels as covered_pixels,
)
from .cameras import (
    grid_sample as grid_sample,
)
from .cameras import (
    in_view as in_view,
)
from .cameras import (
    pixel_directions as pixel_directions,
)
from .cameras import (
    project as project,
)
from .cameras import (
    sample_maps as sample_maps,
)
from .cameras import (
    scale_intrinsics as scale_intrinsics,
)
from .cameras import (
    view_rays as view_rays,
)
from .conventions import CHUNK as CHUNK
from .conventions import COARSE as COARSE
from .conventions import FINE as FINE
from .frustum import (
    frustum_corners as frustum_corners,
)
from .frustum import (
    frustum_planes as frustum_planes,
)
from .frustum import (
    frustum_sides as frustum_sides,
)
from .grids import (
    VoxelGrid as VoxelGrid,
)
from .poses import (
    invert_pose as invert_pose,
)
from .poses import (
    is_valid_pose as is_valid_pose,
)
from .poses import (
    linear_map as linear_map,
)
from .poses import (
    pose_distance as pose_distance,
)
from .poses import (
    rotation_about_z as rotation_about_z,
)
from .poses import (
    rotation_between as rotation_between,
)
from .poses import (
    transform as transform,
)
