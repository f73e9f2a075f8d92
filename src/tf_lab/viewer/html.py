"""The parts of the page that are text and pictures."""

from __future__ import annotations

import base64
import io
from html import escape

import numpy as np
from PIL import Image

from tf_lab.online.kept import Pick
from tf_lab.support.colors import ERROR_SCALE, css, gradient, weight_colors

BAR = "height:10px;border-radius:2px;background:"
TEXT = "font:12px sans-serif;display:flex;justify-content:space-between"


def data_uri(image: np.ndarray) -> str:
    """An image, uint8 [H, W, 3], to stand in a page."""
    content = io.BytesIO()
    Image.fromarray(image).save(content, "jpeg", quality=85)
    return f"data:image/jpeg;base64,{base64.b64encode(content.getvalue()).decode()}"


def kept_views(pick: Pick | None) -> str:
    """The views kept at a point: framed by weight, of greatest weight first."""
    if pick is None:
        return f"<div style='{TEXT}'>Click a point of the mesh: the views kept there.</div>"
    x, y, z = pick.point
    colors = weight_colors(pick.weights)
    cells = "".join(
        f"<figure class='kept-view' data-frame='{view.source}' data-weight='{view.weight:.5f}' "
        f"style='margin:0;width:31%'><img src='{data_uri(view.image)}' "
        f"style='width:100%;box-sizing:border-box;border:3px solid {css(color)}'>"
        f"<figcaption style='font:11px sans-serif;text-align:center'>frame {view.source}: "
        f"{view.weight:.3f}</figcaption></figure>"
        for view, color in zip(pick.views, colors, strict=True)
    )
    head = f"{len(pick.views)} views at ({x:.2f}, {y:.2f}, {z:.2f}) m, {pick.level} level"
    scale = legend("weight", ["0", "attention weight", f"{max(pick.weights, default=0):.3f}"])
    return (
        f"<div style='padding:0 4px'><div style='{TEXT}'>{head}</div>{scale}"
        f"<div style='display:flex;flex-wrap:wrap;gap:4px;margin-top:6px'>{cells}</div></div>"
    )


def legend(which: str, labels: list[str]) -> str:
    """A colour scale with labels under it."""
    spans = "".join(f"<span>{escape(label)}</span>" for label in labels)
    return f"<div style='{BAR}{gradient(which)}'></div><div style='{TEXT}'>{spans}</div>"


def legend_of(mode: str, frames: int) -> str:
    """What a mesh's colours mean."""
    if mode == "error":
        steps = np.linspace(0, 100 * ERROR_SCALE, 4)
        text = legend("error", [f"{step:g}" for step in steps[:-1]] + [f"≥ {steps[-1]:g} cm"])
    elif mode == "best view":
        text = legend("view", ["first frame", "of greatest weight", f"frame {frames - 1}"])
    else:
        return ""
    return f"<div class='legend' style='padding:4px'>{text}</div>"
