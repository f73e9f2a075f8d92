"""Online reconstruction: keyframes, view sets, lazy fusion, meshing."""

from tf_lab.online.reconstructor import Reconstructor
from tf_lab.online.settings import ReconstructionSettings

__all__ = ["ReconstructionSettings", "Reconstructor"]
