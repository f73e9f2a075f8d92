"""What colours say, the same in figures, charts, the viewer's scene and its legends.

Those of charts are told apart by colour-blind eyes (Okabe and Ito, 2008), scales by their lightness
or, blue to red, by any eyes.
"""

from __future__ import annotations

import numpy as np

BLUE, ORANGE, GREEN = "#0072B2", "#D55E00", "#009E73"
PURPLE, SKY = "#CC79A7", "#56B4E9"

LOW, HIGH = np.array([33, 102, 220]), np.array([214, 39, 40])  # of weights: blue, red
FRAME_COLORS = "viridis"
ERROR_COLORS = "YlOrRd"
ERROR_SCALE = 0.15  # metres at the end of the scale of errors


def weight_colors(weights: np.ndarray) -> np.ndarray:
    """Attention weights [N] from blue (none) to red (the greatest of them): uint8 [N, 3]."""
    share = np.asarray(weights, float) / max(float(np.max(weights, initial=0)), 1e-12)
    return np.round(LOW + (HIGH - LOW) * share[:, None]).astype(np.uint8)


def frame_colors(frames: np.ndarray, total: int) -> np.ndarray:
    """Frames [N] of ``total`` along the trajectory, as uint8 [N, 3]; grey where it is -1."""
    colors = _mapped(FRAME_COLORS, np.asarray(frames) / max(total - 1, 1))
    return np.where((np.asarray(frames) < 0)[:, None], np.uint8(128), colors)


def error_colors(errors: np.ndarray) -> np.ndarray:
    """Distances [N] (metres) to the ground truth: uint8 [N, 3]."""
    return _mapped(ERROR_COLORS, errors / ERROR_SCALE)


def gradient(which: str) -> str:
    """A colour scale as a CSS gradient, from left to right."""
    steps = np.linspace(0, 1, 9)
    colors = {
        "error": error_colors(steps * ERROR_SCALE),
        "view": frame_colors(np.arange(9), 9),
        "weight": weight_colors(steps),
    }[which]
    return f"linear-gradient(to right,{','.join(map(css, colors))})"


def css(color: np.ndarray) -> str:
    """A colour [3] for a style sheet."""
    return "#{:02x}{:02x}{:02x}".format(*(int(c) for c in color))


def _mapped(name: str, values: np.ndarray) -> np.ndarray:
    import matplotlib  # a second

    return np.round(255 * matplotlib.colormaps[name](np.asarray(values))[..., :3]).astype(np.uint8)
