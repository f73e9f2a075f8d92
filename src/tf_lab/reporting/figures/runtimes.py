"""What ``python -m tf_lab.benchmark`` measured as a chart, the paper's numbers beside it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from tf_lab.reporting import paper
from tf_lab.reporting.figures.contract import Drawn
from tf_lab.support.colors import BLUE, GREEN, ORANGE, PURPLE, SKY
from tf_lab.support.figures import SMALL, TITLE, new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLORS = {"lazy": BLUE, "eager": SKY, "here": BLUE, "paper": ORANGE}
STAGE_COLORS = (BLUE, SKY, GREEN, PURPLE)


def described(found: Mapping[str, Any]) -> str:
    """What was measured, and on what."""
    config, machine = found["config"], found["provenance"]["machine"]
    threads = machine["threads"]
    times = "1 thread, CPU time" if threads == 1 else f"{threads} threads"
    where = machine.get("gpu") or f"{machine['processor']}, {times}"
    size = f"{config['width']}x{config['height']}"
    return f"model={config['model']['name']}, {size}, {found['precision']}, {where}"


def runtimes(found: Mapping[str, Any]) -> Drawn:
    """Frames a second by K, what a frame and a chunk take by stage, and growth with the scene."""
    figure = new_figure(15, 4.2)
    figure.suptitle(described(found), fontsize=TITLE)
    speed, frame, chunk, size = figure.subplots(1, 4, width_ratios=[1.3, 1, 0.8, 1])
    _speed(speed, found)
    k = found["views"]
    modes = [mode for mode in ("lazy", "eager") if f"{mode} {k}" in found["frame"]]
    bars = {mode: found["frame"][f"{mode} {k}"] for mode in modes}
    _shares(frame, {**bars, "paper": paper.FRAME_MS}, f"adding a frame, K = {k}")
    _shares(chunk, {"here": found["chunk"], "paper": paper.CHUNK_MS}, "meshing a 1.5 m chunk")
    _growth(size, found["size"])
    caption = (
        f"Runtimes ({described(found)}) beside the paper's on an RTX 3090. Left: frames a second "
        "by K, the views kept a voxel; middle: the shares of the stages, with the whole above; "
        "right: how time and memory grow with the scene. Lazy fusion leaves the transformers to "
        "the mesh; eager is the paper's procedure."
    )
    return Drawn(figure, caption, chart=True)


def _speed(axes: Axes, found: Mapping[str, Any]) -> None:
    """Frames a second by K, with the values on the bars: they differ by orders of magnitude."""
    counts = sorted({int(name.split()[1]) for name in found["frame"] if "filter" not in name})
    values = {
        mode: {k: found["frame"][f"{mode} {k}"]["fps"] for k in counts}
        for mode in ("lazy", "eager")
        if f"{mode} {counts[0]}" in found["frame"]
    }
    values["paper"] = {k: paper.FPS[k] for k in counts if k in paper.FPS}
    width = 0.8 / len(values)
    for i, (mode, bars) in enumerate(values.items()):
        places = [counts.index(k) + (i - (len(values) - 1) / 2) * width for k in bars]
        drawn = axes.bar(places, [*bars.values()], 0.92 * width, label=mode, color=COLORS[mode])
        axes.bar_label(drawn, fmt="%.2g", fontsize=SMALL, padding=2)
    axes.set_xticks(range(len(counts)), [str(k) for k in counts])
    axes.set(yscale="log", xlabel="views kept a voxel, K", ylabel="frames a second")
    axes.set_title("adding frames", fontsize=TITLE)
    axes.margins(y=0.15)
    _legend(axes, len(values))


def _shares(axes: Axes, bars: Mapping[str, Mapping[str, float]], title: str) -> None:
    """The stages' shares, the totals above: machines differ too much for one scale."""
    stages = [stage for stage in bars["paper"] if stage != "total"]
    bottom = [0.0] * len(bars)
    for stage, color in zip(stages, STAGE_COLORS, strict=True):
        values = [100 * bar.get(stage, 0.0) / bar["total"] for bar in bars.values()]
        axes.bar([*bars], values, bottom=bottom, label=stage, color=color, edgecolor="white")
        bottom = [b + v for b, v in zip(bottom, values, strict=True)]
    for i, bar in enumerate(bars.values()):
        axes.text(i, 101, f"{bar['total']:,.0f} ms", ha="center", fontsize=SMALL)
    axes.set(ylabel="% of the time", ylim=(0, 108))
    axes.set_title(title, fontsize=TITLE)
    _legend(axes, 2)


def _legend(axes: Axes, columns: int) -> None:
    axes.legend(
        fontsize=SMALL,
        loc="upper center",
        bbox_to_anchor=(0.5, -0.14),
        ncols=columns,
        frameon=False,
    )


def _growth(axes: Axes, sizes: Sequence[Mapping[str, Any]]) -> None:
    """How time and memory grow with the scene, relative to the smallest."""
    rooms = [x["rooms"] for x in sizes]
    for label, marker, color, values in (
        ("time a frame", "o-", BLUE, [x["ms a frame"] for x in sizes]),
        ("memory of view sets", "s-", ORANGE, [x["memory"]["view sets"] for x in sizes]),
        ("voxels seen", "^--", GREEN, [x["voxels seen"] for x in sizes]),
    ):
        axes.plot(rooms, [value / values[0] for value in values], marker, color=color, label=label)
    axes.set(xlabel="rooms", xticks=rooms, ylabel=f"times that of rooms={rooms[0]}")
    axes.set_title("scene size", fontsize=TITLE)
    axes.set_ylim(bottom=0)
    _legend(axes, 2)
