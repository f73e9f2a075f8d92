"""Is a capture what it says it is? Cameras, poses, scale and depth, held against its images."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from tf_lab.config.schema import CheckConfig
from tf_lab.data.diagnosis import diagnose
from tf_lab.data.diagnosis.picture import draw
from tf_lab.data.diagnosis.search import Candidate
from tf_lab.data.diagnosis.statistics import Statistics
from tf_lab.data.diagnosis.verdict import FINE, Report
from tf_lab.data.readers import open_capture
from tf_lab.data.reading import ReadSettings
from tf_lab.support.files import check_folder, write_json
from tf_lab.support.progress import tracked

SHOWN = 6  # alternatives in the table


def run(config: CheckConfig) -> None:
    """Print what was found; write it where it is asked for."""
    path, settings = Path(config.input), ReadSettings.part_of(config)
    output = Path(config.output) if config.output is not None else None
    if output is not None:
        check_folder(output)
    capture = open_capture(path, settings, strict=False)
    track = partial(tracked, description="reading images")
    report, evidence = diagnose(capture, settings, path, track)
    console = Console(highlight=False, soft_wrap=True)
    for table in tables(report):
        console.print(table)
    if capture.skipped:
        total = len(capture.skipped) + len(capture.frames)
        print(f"lost: {len(capture.skipped)} of {total} frames; the first: {capture.skipped[0]}")
    if output is not None:
        write_json(output / "check.json", {"input": str(path), **report.as_json()})
        draw(report, evidence, output / "check.png")
        print(f"{output}: check.json and check.png")
    for line in lines(report, path):
        print(line)
    if report.verdict != FINE:
        sys.exit(1)


def tables(report: Report) -> Iterator[Table]:
    """The figures of the capture, and the ways to read it with their errors.

    Where it is fine as it is, others with errors as small, by chance, would only look like advice.
    """
    if report.statistics is not None:
        table = Table("Capture", "", show_lines=False)
        for name, value in figures(report.statistics):
            table.add_row(name, value)
        yield table
    if report.found is None:
        return
    table = Table("Cameras and poses", "Setting", title_justify="left")
    table.add_column("Error (pixels)", justify="right")
    table.add_column("In front", justify="right")
    given, best = report.found.given, report.found.best
    others = [c for c in report.found.tried if c.possible and c is not best]
    if best is given:  # what is as good says nothing, unless it is found to be as likely
        same = report.found.same
        others = [
            c for c in others if c.setting in same or round(c.error, 2) > round(given.error, 2)
        ]
    for candidate in [given, *([best] if best is not given else []), *others[:SHOWN]]:
        style = "bold" if candidate is best else ""
        table.add_row(*_row(candidate), style=style)
    yield table


def _row(candidate: Candidate) -> tuple[str, str, str, str]:
    share = "-" if np.isnan(candidate.in_front) else f"{candidate.in_front:.0%}"
    return candidate.text, candidate.setting, f"{candidate.error:.2f}", share


def figures(s: Statistics) -> Iterator[tuple[str, str]]:
    """What is known of a capture, by name."""
    yield "frames", f"{s.frames}, of them keyframes {s.keyframes}; lost {s.lost}"
    yield "unreadable", f"{len(s.unread)} of {s.looked_at} images"
    wide, high = s.field_of_view
    yield "images", f"{s.size[0]}x{s.size[1]}, field of view {wide:.0f} x {high:.0f} degrees"
    x, y, z = s.extent
    yield "path", f"{s.path:.2f} m, within {x:.2f} x {y:.2f} m, {z:.2f} m in height"
    height = "no depth" if np.isnan(s.height) else f"{s.height:.2f} m"
    yield "camera above the lowest depth", height
    up = ", ".join(f"{value:.2f}" for value in s.up)
    yield "up", f"({up}) in the source's world, from: {s.up_from}"
    yield "sharpness", f"{s.blur:.0f} (variance of the Laplacian); {s.blurred:.0%} blurred"
    yield "brightness", f"{s.exposure:.0f} of 255; {s.ill_exposed:.0%} nearly black or white"
    overlap = "unknown" if np.isnan(s.overlap) else f"{s.overlap:.0f} keyframes see a point"
    yield "overlap", overlap


def lines(report: Report, path: Path) -> Iterator[str]:
    """What was found beside the tables, and the verdict."""
    exact = ""
    if np.isfinite(report.floor):
        exact = (
            f"; they are themselves exact to {report.floor:.2f} pixels: errors near that are as "
            "good as can be"
        )
    yield f"{report.matches} matches in {report.pairs} pairs of images{exact}"
    if report.verdict == FINE:
        yield "no other way to read the capture has clearly smaller errors than as given"
    if report.found is not None and report.found.focal is not None:
        best, low, high = report.found.focal
        yield (f"focal length: {best:.3f} times the given one fits best ({low:.3f} to {high:.3f})")
    if report.scale is not None and np.isfinite(report.scale.seen):
        if np.isfinite(report.scale.factor):
            yield (
                f"scale: depth maps have {report.scale.factor:.3g} times the depth that the "
                f"images triangulate to ({report.scale.seen:.3g} m)"
            )
        else:
            yield (
                f"scale: without depth unknown; the images triangulate to {report.scale.seen:.3g} m"
            )
    if report.sensors is not None:
        x, y = (1000 * value for value in report.sensors.offset)
        other = "no other focal length or offset is better"
        if report.sensors.best > report.sensors.score:
            other = (
                f"best {report.sensors.best:.3f} with {report.sensors.focal:.3f} times the focal "
                f"length and colour ({x:.0f}, {y:.0f}) mm off"
            )
        yield f"colour against depth: correlation {report.sensors.score:.3f}; {other}"
    for finding in report.findings:
        yield f"- {finding}"
    cure = f"; to mend it: {shlex.join(report.settings)}" if report.settings else ""
    yield f"{path}: {report.verdict}{cure}"
