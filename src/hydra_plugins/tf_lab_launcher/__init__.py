"""Hydra finds the launcher of tf_lab's sweeps here; what it does is in `tf_lab.experiments`."""
