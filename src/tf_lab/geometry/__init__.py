"""Poses, cameras, frusta and voxel grids, as `tf_lab.geometry.conventions` has them."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
