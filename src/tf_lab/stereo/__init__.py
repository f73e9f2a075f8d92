"""Depth of single frames by stereo with the frames before them.

A frame is swept over planes against a few earlier ones (`cost`), a small 3D CNN reads the volume of
scores (`regularizer`), and the likeliest plane of each pixel is its depth (`depth`). What sees a
frame only once, online, can do it: nothing waits for later frames, and nothing changes afterwards.
"""
