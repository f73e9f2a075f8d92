"""The conventions of the whole project, stated once.

* World: metres, right-handed, z up. Camera: x right, y down, z forward (OpenCV).
* ``world_T_cam`` maps camera to world coordinates; the paper's (R, t) is ``cam_T_world``.
* Pixel centres lie at integer coordinates; (0, 0) is the centre of the top-left pixel, so an image
  of width W covers [-0.5, W - 0.5).
* Voxel grids are cell-centred: voxel (i, j, k) has its centre at ``origin + (ijk + 0.5) * voxel``.
* Functions of geometry work on any leading batch shape that broadcasts, unless they say otherwise.
"""

COARSE, FINE, CHUNK = 0.30, 0.10, 1.5  # metres; the paper's v_c, v_f and chunk edge
