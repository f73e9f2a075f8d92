"""The views that a voxel keeps: selection, store, and the batch form for training."""
