"""Measurements of speed and memory beside the paper's; see `tf_lab.benchmark`."""
