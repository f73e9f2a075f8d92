"""The paper's figures (Bozic et al. 2021, supplement, "Runtime Analysis", RTX 3090)."""

FRAME_MS = {  # table "Runtime analysis of our per-frame feature fusion"
    "feature extraction": 21.50,
    "coarse fusion": 11.81,
    "near-surface masks": 24.18,
    "fine fusion": 73.03,
    "total": 130.52,
}
CHUNK_MS = {  # table "Runtime analysis of the per-chunk mesh extraction", 1.5 m chunks at 2 cm
    "coarse refinement": 28.56,
    "fine refinement": 140.79,
    "occupancy": 25.21,
    "marching cubes": 48.74,
    "total": 243.29,
}
FPS = {4: 12.28, 8: 10.17, 16: 7.66}  # by views kept a voxel
FILTER_SPEEDUP = 3.5  # coarse-to-fine filtering: 7 instead of 2 frames a second
