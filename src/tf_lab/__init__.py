"""tf_lab: a lab for TransformerFusion (Bozic et al., NeurIPS 2021)."""

__version__ = "0.1.0"
