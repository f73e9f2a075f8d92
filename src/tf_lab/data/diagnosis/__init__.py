"""Is a capture what it says it is? Its images held against its cameras, poses and depth."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np

from tf_lab.data.capture import Capture
from tf_lab.data.diagnosis.evidence import Evidence
from tf_lab.data.diagnosis.matches import Album, match_capture
from tf_lab.data.diagnosis.scale import find_scale
from tf_lab.data.diagnosis.search import search
from tf_lab.data.diagnosis.sensors import compare_sensors
from tf_lab.data.diagnosis.statistics import describe
from tf_lab.data.diagnosis.verdict import UNKNOWN, WRONG, Report, judge, too_poor
from tf_lab.data.reading import AS_STATED, ReadSettings

PAIRS, FEW = 60, 12  # of images: of a whole check, and of a quick one
NARROW = 400  # pixels, for a quick one

logger = logging.getLogger(__name__)


def diagnose(capture: Capture, settings: ReadSettings, path: Path) -> tuple[Report, Evidence]:
    """Check a capture: its verdict, and the matches that it rests on.

    Args:
        capture: as `open_capture` gave it.
        settings: with which it was opened.
        path: from where.
    """
    album = Album(capture)
    evidence = Evidence(capture, settings, match_capture(album, PAIRS))
    poor = too_poor(evidence)
    if poor:
        statistics = describe(album, evidence, settings, path)
        matches = sum(len(pair.a) for pair in evidence.pairs)
        report = Report(
            UNKNOWN, [poor], [], len(evidence.pairs), matches, float("nan"), statistics=statistics
        )
        return report, evidence
    found = search(evidence)
    statistics = describe(album, evidence, found.best.settings, path)
    scale = find_scale(evidence, found.best)
    sensors = None if scale.setting else compare_sensors(evidence, found.best)
    return judge(evidence, found, scale, sensors, statistics), evidence


def quick_warning(capture: Capture, settings: ReadSettings = AS_STATED) -> str | None:
    """What is clearly wrong with a capture by a few pairs of its images, in a line; None: nothing.

    It never fails: whatever goes wrong here, the capture may still be of use.
    """
    try:
        evidence = Evidence(capture, settings, match_capture(Album(capture, NARROW), FEW))
        if too_poor(evidence):
            return None
        found = search(evidence, thorough=False)
        report = judge(evidence, found, find_scale(evidence, found.best), None, None)
    except (ArithmeticError, ValueError, np.linalg.LinAlgError) as error:
        logger.debug("no quick check of %s: %s", capture.name, error)
        return None
    if report.verdict != WRONG:
        return None
    cure = f"; try {' '.join(report.settings)}" if report.settings else ""
    return f"{'; '.join(report.findings)}{cure} (see python -m tf_lab.check)"
