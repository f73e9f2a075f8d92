"""Meshes: files, marching cubes, colours, ray casting."""
