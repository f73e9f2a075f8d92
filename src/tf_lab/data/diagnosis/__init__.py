"""Is a capture what it says it is? Its images held against its cameras, poses and depth."""

from __future__ import annotations

import logging
import shlex
from pathlib import Path

import cv2
import numpy as np

from tf_lab.data.capture import Capture
from tf_lab.data.diagnosis.evidence import Evidence
from tf_lab.data.diagnosis.matches import Album, match_capture
from tf_lab.data.diagnosis.motion import images_move, little_motion, standstill
from tf_lab.data.diagnosis.scale import find_scale
from tf_lab.data.diagnosis.search import search
from tf_lab.data.diagnosis.sensors import compare_sensors
from tf_lab.data.diagnosis.statistics import Track, describe
from tf_lab.data.diagnosis.verdict import UNKNOWN, WRONG, Report, judge, too_poor, unread
from tf_lab.data.reading import AS_STATED, ReadSettings
from tf_lab.errors import TFLabError

PAIRS, FEW = 60, 12  # of images: of a whole check, and of a quick one
NARROW = 400  # pixels, for a quick one
MORE = "(see python -m tf_lab.check)"

logger = logging.getLogger(__name__)


def diagnose(
    capture: Capture, settings: ReadSettings, path: Path, track: Track = iter
) -> tuple[Report, Evidence]:
    """Check a capture: its verdict, and the matches that it rests on.

    Args:
        capture: as `open_capture` gave it.
        settings: with which it was opened.
        path: from where.
        track: shows how far the reading of all images is.
    """
    album = Album(capture)
    evidence = Evidence(capture, settings, match_capture(album, PAIRS))
    still, poor = standstill(capture.world_T_cam), too_poor(evidence)
    if still or poor:
        statistics = describe(album, evidence, settings, path, track)
        matches = sum(len(pair.a) for pair in evidence.pairs)
        little = "" if still else little_motion(capture.world_T_cam)
        findings = [why for why in (still, poor, little, *unread(statistics)) if why]
        verdict = WRONG if still and images_move(evidence) else UNKNOWN
        report = Report(
            verdict, findings, [], len(evidence.pairs), matches, np.nan, statistics=statistics
        )
        return report, evidence
    found = search(evidence)
    statistics = describe(album, evidence, found.best.settings, path, track)
    scale = find_scale(evidence, found.best)
    sensors = None if scale.setting else compare_sensors(evidence, found.best)
    return judge(evidence, found, scale, sensors, statistics), evidence


def quick_warning(capture: Capture, settings: ReadSettings = AS_STATED) -> str | None:
    """What is clearly wrong with a capture by a few pairs of its images, in a line; None: nothing.

    It never fails: whatever goes wrong here, the capture may still be of use.
    """
    try:
        evidence = Evidence(capture, settings, match_capture(Album(capture, NARROW), FEW))
        poses = capture.world_T_cam
        if hopeless := standstill(poses) or (too_poor(evidence) and little_motion(poses)):
            return f"{hopeless} {MORE}"
        if too_poor(evidence):
            return None
        found = search(evidence, thorough=False)
        scale = find_scale(evidence, found.best)
        report = judge(evidence, found, scale, None, None)
    except (TFLabError, ArithmeticError, ValueError, np.linalg.LinAlgError, cv2.error) as error:
        logger.debug("no quick check of %s: %s", capture.name, error)
        return None
    if report.verdict != WRONG and not scale.setting:
        return None
    cure = f"; try {shlex.join(report.settings)}" if report.settings else ""
    return f"{'; '.join(report.findings)}{cure} {MORE}"
