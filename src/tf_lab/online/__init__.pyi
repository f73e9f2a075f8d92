from .reconstructor import Reconstructor as Reconstructor
from .settings import ReconstructionSettings as ReconstructionSettings
