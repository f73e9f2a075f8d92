"""Given poses made more exact by what the images show: points followed, bundle adjustment."""
