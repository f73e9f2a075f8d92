"""Captures to scenes, each made once: which there are, which are missing, what was made.

A scene lies under the digest of its sources: changed sources make another scene beside it, and
whoever works with the old one goes on undisturbed.
"""

from __future__ import annotations

import contextlib
import logging
import os
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from tf_lab.data.capture import Capture
from tf_lab.data.digests import Sources, find_sources, read_digest, read_sources
from tf_lab.data.import_capture import ImportSettings, import_capture, reason_of
from tf_lab.data.readers import capture_within, detect_format, open_capture
from tf_lab.data.readers.source import SourceCapture
from tf_lab.data.scene import Scene
from tf_lab.errors import TFLabError
from tf_lab.support.files import atomic_directory, remove_abandoned, write_json
from tf_lab.support.locks import directory_lock
from tf_lab.support.tasks import run_tasks
from tf_lab.support.text import read_lines
from tf_lab.support.words import counted, shortened

logger = logging.getLogger(__name__)


@dataclass
class PreparedCaptures:
    """Scenes by name, and for those that could not be made the reason."""

    scenes: dict[str, Path]
    failed: dict[str, str]


def find_captures(root: Path, what: str = "data.root") -> dict[str, Path]:
    """The captures in a folder, by name: its folders of a known layout, and its `.sens` files.

    Other files (videos, json) are part of a capture: the folder that they lie in.

    Args:
        root: the folder.
        what: the setting that names it.

    Raises:
        TFLabError: there is none.
    """
    if not root.is_dir():
        raise TFLabError(f"{what}={root}: no such folder; give the folder of the captures")
    found: dict[str, Path] = {}
    for path in sorted(root.iterdir(), key=lambda path: (path.is_file(), path)):
        if path.name.startswith(".") or (path.is_file() and path.suffix.lower() != ".sens"):
            continue
        try:
            if detect_format(path):
                taken = path.stem in found
                found[path.stem if path.is_file() and not taken else path.name] = path
        except OSError as error:
            logger.warning("%s: left out, it cannot be read (%s)", path, error.strerror)
    if not found:
        inner = root if detect_format(root) else capture_within(root)
        cure = (
            "give the folder that holds the captures' folders (docs/data.md shows every layout)"
            if inner is None
            else f"the folder that holds them is {inner.resolve().parent}"
        )
        raise TFLabError(f"{what}={root}: no capture in it; {cure}")
    return found


def prepare_captures(
    sources: Mapping[str, Path],
    root: Path,
    settings: ImportSettings,
    workers: int | None = None,
    memory: int = 2**30,
    check: bool = True,
    what: str = "data.scenes",
) -> PreparedCaptures:
    """Make the scenes that do not exist yet or whose sources changed, one process a scene.

    A scene whose capture is not there any more stays as it is.

    Args:
        sources: captures by the name of their scene.
        root: scenes go to ``root/<settings' key>/<name>/<sources' digest>``.
        settings: for all of them.
        workers: processes; None: one a core.
        memory: bytes a process may take for depth fusion.
        check: whether to look for cameras that are clearly wrong; they make scenes all the same.
        what: the setting that names the root.
    """
    folder = root / settings.key
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise TFLabError(
            f"{folder}: cannot be made ({error.strerror}); say with {what}=DIR where the "
            "prepared scenes shall go"
        ) from error
    failed: dict[str, str] = {}
    if _outdated(folder, sources):
        with directory_lock(folder, "preparing"):
            outdated = _outdated(folder, sources)  # another process may have been faster
            tasks = {}
            for name in outdated:
                remove_abandoned(folder / name)
                job = (folder / name, sources[name], settings, memory, check)
                tasks[name] = partial(make_scene, *job)
            failed = run_tasks(tasks, "preparing scenes", workers) if tasks else {}
        _say_changes(folder, {n: s for n, s in outdated.items() if s and n not in failed})
    for name in failed:
        with contextlib.suppress(OSError):
            (folder / name).rmdir()  # if nothing was ever made of it
    found: dict[str, Path] = {}
    for name in sources:
        if name not in failed and (directory := scene_of(folder / name)):
            try:
                Scene(directory)
                found[name] = directory
            except TFLabError as error:  # damaged since
                failed[name] = str(error)
    return PreparedCaptures(found, failed)


def scene_of(place: Path) -> Path | None:
    """The directory of the scene of a name: of its sources as they were seen last."""
    digest = read_digest(place)
    return place / digest if digest and (place / digest).is_dir() else None


def prepared_scenes(folder: Path) -> list[str]:
    """The names of the scenes of some settings that are there."""
    found = folder.iterdir() if folder.is_dir() else ()
    return sorted(place.name for place in found if scene_of(place))


def _outdated(folder: Path, captures: Mapping[str, Path]) -> dict[str, Sources | None]:
    """Which scenes are to be made, and of what they were made last."""
    outdated: dict[str, Sources | None] = {}
    for name, capture in captures.items():
        place = folder / name
        sources = read_sources(place)
        made = sources is not None and (place / sources.digest).is_dir()
        if not (sources and made and (sources.unchanged(capture) or not _is_capture(capture))):
            outdated[name] = sources
    return outdated


def _is_capture(path: Path) -> bool:
    return path.exists() and bool(detect_format(path))


def make_scene(
    place: Path, source: Path, settings: ImportSettings, memory: int, check: bool = True
) -> None:
    """Make a capture's scene as ``place/<sources' digest>``, if it is not there; note its sources.

    Raises:
        TFLabError: the capture cannot be read, or changes meanwhile.
    """
    known = read_sources(place)
    if known:
        now = find_sources(source, known.stamps, known)
        if now.digest == known.digest and (place / known.digest).is_dir():
            now.write(place)  # touched, but the same
            return
    before = find_sources(source, known=known)
    capture = open_capture(source, settings.read)
    sources = find_sources(source, _files_of(source, capture), before)
    directory = place / sources.digest
    if not directory.is_dir():
        with atomic_directory(directory) as temporary:
            digest, name = sources.digest, place.name  # of two links to a `seq-01` each its own
            import_capture(temporary, source, settings, memory, capture, digest, check, name)
            if not (before.stamps.items() <= sources.stamps.items() and sources.unchanged(source)):
                raise TFLabError(f"{source}: changed while it was read; prepare it again")
    sources.write(place)


def _files_of(source: Path, capture: Capture) -> Iterator[str]:
    """The files that a capture refers to, wherever they lie, by their paths from its folder."""
    folder = source.parent if source.is_file() else source
    if not isinstance(capture, SourceCapture):
        return
    for file in capture.given.beside:
        yield os.path.relpath(file.resolve(), folder.resolve())
    for frame in capture.source:
        for pixels in (frame.color, frame.depth):
            path = getattr(pixels, "path", None)
            if isinstance(path, Path):
                yield os.path.relpath(path, folder)


def _say_changes(folder: Path, before: Mapping[str, Sources]) -> None:
    """A line on each scene that was made anew."""
    for name, old in before.items():
        new = read_sources(folder / name)
        if new is not None and new.digest != old.digest:
            print(
                f"{name}: made anew ({new.difference(old)}); the scene of before stays in "
                f"{folder / name / old.digest} for what uses it",
                flush=True,
            )


def summarise(prepared: PreparedCaptures, folder: Path) -> str:
    """What was made and skipped, as text; ``prepare.json`` in the folder has all of it."""
    reasons: Counter[str] = Counter()
    details: dict[str, Any] = {}
    frames, warnings = 0, []
    for name, directory in prepared.scenes.items():
        opened = Scene(directory)
        frames += len(opened)
        reasons.update(reason_of(line) for line in opened.skipped)
        warning = opened.provenance.get("warning")
        warnings += [f"  warning {name}: {warning}"] if warning else []
        details[name] = {"frames": len(opened), "skipped": opened.skipped, "warning": warning}
    lines = [f"{folder}: {counted(len(prepared.scenes), 'scene')}, {counted(frames, 'frame')}"]
    common = reasons.most_common(5)
    lines += [f"  skipped {counted(count, 'frame')}: {reason}" for reason, count in common]
    try:
        write_json(folder / "prepare.json", {"scenes": details, "failed": prepared.failed})
    except OSError as error:  # scenes that were prepared by others are no less ready
        lines.append(f"  prepare.json, which lists them, is as it was ({error.strerror})")
    return "\n".join([*lines, *warnings])


def names_of(given: Sequence[str] | str, known: Sequence[str], what: str) -> list[str]:
    """Scene names from a list, or from a text file with one a line.

    Raises:
        TFLabError: the file is missing, or a name is not known.
    """
    if isinstance(given, str):
        cure = f"{what} is a list of names, or a text file with one a line"
        given = [line for _, line in read_lines(Path(given).expanduser(), cure)]
    missing = [name for name in given if name not in known]
    if missing:
        raise TFLabError(
            f"{what}: {shortened(missing)}: not there; there are: {shortened(sorted(known))}"
        )
    return list(given)
