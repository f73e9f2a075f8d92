"""Depth of single frames by stereo with the frames before them; nothing in here is learned.

A frame is swept over planes against a few earlier ones (`cost`), the scores are made smooth along
scan lines (`smoothing`), and the best plane of each pixel is its depth (`depth`). What sees a frame
only once, online, can do it: nothing waits for later frames, and nothing changes afterwards.
"""
