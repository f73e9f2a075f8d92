"""From images on disk to training chunks."""
