"""The network: tensors in, tensors out. Knows nothing of files, Hydra or Lightning."""
