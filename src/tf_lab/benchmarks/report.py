"""What was measured as text, the paper's figures beside it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from tf_lab.benchmarks.measure import CHUNK_STAGES, STAGES
from tf_lab.reporting import paper
from tf_lab.reporting.figures.runtimes import described
from tf_lab.support.tables import NOTHING, aligned

MIB = 2**20
Rows = Sequence[Sequence[str]]


def tables(found: Mapping[str, Any]) -> str:
    """All measurements as text."""
    parts = []
    if "frame" in found:
        parts += _papers(found)
    if "live" in found:
        parts.append(_table("Live viewing", *_live(found["live"])))
    return "\n\n".join(parts)


def _papers(found: Mapping[str, Any]) -> list[str]:
    """The paper's tables, and what explains them."""
    return [
        described(found),
        _table("Adding a frame (ms)", *_frame(found)),
        _table("Frames per second", *_fps(found)),
        _table("Meshing a 1.5 m chunk (ms)", *_chunk(found)),
        _table("Against scene size", *_size(found)),
        _table("Against frames already there", *_count(found)),
        _table("Floor: the work at the best rates measured here", *_floor(found)),
        f"{found['rates']['flops'] / 1e9:,.0f} GFLOP/s, {found['rates']['bytes'] / 1e9:,.0f} GB/s",
        _table("Ratios", ["", "ratio"], [[k, f"{v:.2f}"] for k, v in found["ratios"].items()]),
        _table("Peak memory", *_memory(found)),
        "paper: Bozic et al. 2021, supplement, on an RTX 3090",
    ]


def _live(live: Mapping[str, float]) -> tuple[list[str], Rows]:
    memory = ("memory at the last frame", "memory when whole", "memory later")
    rows = [
        ["frames a second", f"{live['frames a second']:.2f}"],
        ["s from the start to the first surface", f"{live['first after']:.2f}"],
        ["s between refreshes of the mesh, mean", f"{live['mean gap']:.2f}"],
        ["s between refreshes of the mesh, worst", f"{live['worst gap']:.2f}"],
        ["s from the last frame to the whole mesh", f"{live['whole after']:.2f}"],
        *([f"MiB, {name}", f"{live[name] / MIB:,.0f}"] for name in memory),
        ["MiB sent to a page", f"{live['bytes sent'] / MIB:,.1f}"],
    ]
    return [f"{live['frames']:.0f} frames, {live['width']:.0f}x{live['height']:.0f}", ""], rows


def _modes(found: Mapping[str, Any]) -> list[str]:
    return [mode for mode in found["floor"] if mode != "chunk"]


def _frame(found: Mapping[str, Any]) -> tuple[list[str], Rows]:
    modes, k = _modes(found), found["views"]
    rows = [
        [
            stage,
            *(_number(found["frame"][f"{m} {k}"].get(stage)) for m in modes),
            f"{paper.FRAME_MS[stage]:.2f}",
        ]
        for stage in (*STAGES, "total")
    ]
    return [f"K = {k}", *modes, "paper"], rows


def _fps(found: Mapping[str, Any]) -> tuple[list[str], Rows]:
    modes, rows = _modes(found), []
    names = [key.removeprefix("lazy ") for key in found["frame"] if key.startswith("lazy ")]
    for name in names:
        figure = paper.FPS.get(int(name)) if name.isdecimal() else None
        cells = [f"{found['frame'][f'{m} {name}']['fps']:.2f}" for m in modes]
        rows.append([f"K = {name}", *cells, NOTHING if figure is None else f"{figure:.2f}"])
    return ["", *modes, "paper"], rows


def _chunk(found: Mapping[str, Any]) -> tuple[list[str], Rows]:
    chunk = found["chunk"]
    rows = [[s, f"{chunk[s]:.2f}", f"{paper.CHUNK_MS[s]:.2f}"] for s in (*CHUNK_STAGES, "total")]
    fused = f"fuse 1000 voxels of {chunk['views']:.1f} views"
    rows.append([fused, f"{chunk['fuse 1000 voxels']:.2f}", NOTHING])
    return ["", "here", "paper"], rows


def _size(found: Mapping[str, Any]) -> tuple[list[str], Rows]:
    head = [
        "rooms",
        "ms a frame",
        "voxels in view",
        "us a voxel",
        "voxels seen",
        "voxels in the box",
        "view sets MiB",
        "bytes a voxel",
        "all MiB",
    ]
    rows = [
        [
            f"{x['rooms']}",
            f"{x['ms a frame']:.2f}",
            f"{x['voxels in view']:.0f}",
            f"{x['us a voxel in view']:.2f}",
            f"{x['voxels seen']}",
            f"{x['voxels in the bounding box']}",
            f"{x['memory']['view sets'] / MIB:.1f}",
            f"{x['bytes a voxel']:.0f}",
            f"{sum(x['memory'].values()) / MIB:.0f}",
        ]
        for x in found["size"]
    ]
    return head, rows


def _count(found: Mapping[str, Any]) -> tuple[list[str], Rows]:
    rows = [[f"{x['frames']}", f"{x['ms a frame']:.2f}"] for x in found["count"]]
    return ["frames", "ms a frame"], rows


def _floor(found: Mapping[str, Any]) -> tuple[list[str], Rows]:
    rows = []
    for name, stages in found["floor"].items():
        measured = found["chunk"] if name == "chunk" else found["frame"][f"{name} {found['views']}"]
        for stage, x in stages.items():
            rows.append(
                [
                    f"{name}, {stage}",
                    _number(x["flops"] / 1e9),
                    _number(x["bytes"] / 1e6),
                    _number(x["ms"]),
                    _number(measured[stage]),
                    _number(measured[stage] / x["ms"] if x["ms"] else None),
                ]
            )
    return ["", "GFLOP", "MB", "floor ms", "measured ms", "measured / floor"], rows


def _memory(found: Mapping[str, Any]) -> tuple[list[str], Rows]:
    rows = [[name, f"{peak / MIB:,.0f}"] for name, peak in found["peak memory"].items()]
    return ["", "MiB"], rows


def _number(x: float | None) -> str:
    return f"{x:,.2f}" if x else NOTHING


def _table(title: str, head: Sequence[str], rows: Rows) -> str:
    return f"{title}\n{aligned(rows, head=head)}"
