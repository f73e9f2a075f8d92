"""tf_lab: a lab for TransformerFusion (Bozic et al., NeurIPS 2021).

What a script or a notebook needs is here by name; it is imported when it is first asked for.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from tf_lab.support.stops import end_with_parent as _end_with_parent

if TYPE_CHECKING:
    from tf_lab.config.compose import compose_config
    from tf_lab.data.readers import open_capture
    from tf_lab.data.reading import ReadSettings
    from tf_lab.data.resize import Resized
    from tf_lab.data.scene import Scene
    from tf_lab.errors import TFLabError
    from tf_lab.evaluation.protocol import evaluate_scene
    from tf_lab.network.checkpoint import load_network, shipped_checkpoint
    from tf_lab.online.reconstructor import Reconstructor
    from tf_lab.online.settings import ReconstructionSettings

_end_with_parent()  # first of all, so that a child also ends with it while it imports the rest

__version__ = "0.1.0"

_PLACES = {
    "ReadSettings": "tf_lab.data.reading",
    "ReconstructionSettings": "tf_lab.online.settings",
    "Reconstructor": "tf_lab.online.reconstructor",
    "Resized": "tf_lab.data.resize",
    "Scene": "tf_lab.data.scene",
    "TFLabError": "tf_lab.errors",
    "compose_config": "tf_lab.config.compose",
    "evaluate_scene": "tf_lab.evaluation.protocol",
    "load_network": "tf_lab.network.checkpoint",
    "open_capture": "tf_lab.data.readers",
    "shipped_checkpoint": "tf_lab.network.checkpoint",
}

__all__ = [
    "ReadSettings",
    "ReconstructionSettings",
    "Reconstructor",
    "Resized",
    "Scene",
    "TFLabError",
    "compose_config",
    "evaluate_scene",
    "load_network",
    "open_capture",
    "shipped_checkpoint",
]


def __getattr__(name: str) -> Any:
    if name not in _PLACES:
        raise AttributeError(f"module 'tf_lab' has no attribute {name!r}")
    return getattr(import_module(_PLACES[name]), name)
