"""Voxels: blocks of them, their columns, sparse convolutions."""
