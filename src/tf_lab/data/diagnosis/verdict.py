"""From what was found to a verdict: fine, doubtful, wrong, or too little to tell."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from tf_lab.data.diagnosis.evidence import Evidence
from tf_lab.data.diagnosis.scale import Scale
from tf_lab.data.diagnosis.search import Found, usable
from tf_lab.data.diagnosis.sensors import Sensors
from tf_lab.data.diagnosis.statistics import Statistics

FINE, DOUBTFUL, WRONG, UNKNOWN = "fine", "doubtful", "wrong", "too poor to tell"
LEAST_PAIRS, LEAST_MATCHES = 5, 120
HOPELESS = 3  # times the error of usable poses: beyond doubt not those of the images
NAMED = 10  # frames, at most
FOCAL = 0.06  # how far (logarithm) depth may put colour's focal length from what is stated


@dataclass(frozen=True)
class Report:
    """What a check of a capture found.

    Attributes:
        verdict: one of the four.
        findings: what is wrong or doubtful, or why nothing can be told, a sentence each.
        settings: those that mend it, "NAME=VALUE" each.
        pairs, matches: how much it rests on.
        floor: median error, pixels, that would remain with any cameras.
        found: the alternatives; None: too little to try them.
        scale, sensors, statistics: see there; None: not looked at.
    """

    verdict: str
    findings: list[str]
    settings: list[str]
    pairs: int
    matches: int
    floor: float
    found: Found | None = None
    scale: Scale | None = None
    sensors: Sensors | None = None
    statistics: Statistics | None = None

    def as_json(self) -> dict[str, Any]:
        """All of it as plain values; what is not known is null."""
        plain: dict[str, Any] = {
            "verdict": self.verdict,
            "findings": self.findings,
            "settings": self.settings,
            "pairs": self.pairs,
            "matches": self.matches,
            "floor_pixels": self.floor,
        }
        if self.found is not None:
            tried = [self.found.given, *self.found.tried]
            plain["alternatives"] = [
                {"setting": c.setting, "error_pixels": c.error, "in_front": c.in_front}
                for c in tried
            ]
            plain["focal_factor"] = self.found.focal and list(self.found.focal)
        for name in ("scale", "sensors", "statistics"):
            value = getattr(self, name)
            plain[name] = None if value is None else asdict(value)
        known: dict[str, Any] = _known(plain)
        return known


def _known(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _known(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_known(item) for item in value]
    if isinstance(value, float):
        return float(value) if np.isfinite(value) else None
    return bool(value) if isinstance(value, np.bool_) else value


@dataclass
class _Judgement:
    """The worst that was found so far."""

    verdict: str = FINE
    findings: list[str] = field(default_factory=list)
    settings: list[str] = field(default_factory=list)

    def add(self, verdict: str, finding: str, *settings: str) -> None:
        order = (FINE, UNKNOWN, DOUBTFUL, WRONG)
        self.verdict = max(self.verdict, verdict, key=order.index)
        self.findings.append(finding)
        self.settings += [setting for setting in settings if setting]


def too_poor(evidence: Evidence) -> str:
    """Why the matches are too few for any verdict; empty: they are enough."""
    pairs, matches = len(evidence.pairs), sum(len(pair.a) for pair in evidence.pairs)
    if pairs >= LEAST_PAIRS and matches >= LEAST_MATCHES:
        return ""
    if len(evidence.capture.frames) < 2:
        return "a single image says nothing about the cameras"
    return (
        f"{matches} matches in {pairs} pairs of images: too little texture or overlap to say "
        "anything about the cameras"
    )


def judge(
    evidence: Evidence,
    found: Found,
    scale: Scale,
    sensors: Sensors | None,
    statistics: Statistics | None,
) -> Report:
    """The verdict on a capture that has enough matches."""
    judgement = _Judgement()
    _judge_cameras(judgement, evidence, found, sensors)
    _judge_scale(judgement, scale)
    known = evidence.given.metric or evidence.settings.scale is not None
    if not (known or scale.setting):
        judgement.add(
            DOUBTFUL,
            "the poses have no unit (structure from motion gives none), what is metres above is "
            "theirs: give scale=METRES_PER_UNIT",
        )
    if sensors is not None:
        _judge_sensors(judgement, sensors, found)
    if statistics is not None:
        _judge_images(judgement, statistics)
    return Report(
        judgement.verdict,
        judgement.findings,
        judgement.settings,
        len(evidence.pairs),
        sum(len(pair.a) for pair in evidence.pairs),
        float(np.median([pair.floor for pair in evidence.pairs])),
        found,
        scale,
        sensors,
        statistics,
    )


def _judge_cameras(
    judgement: _Judgement, evidence: Evidence, found: Found, sensors: Sensors | None
) -> None:
    given, best = found.given, found.best
    if not evidence.centred and best is given:
        judgement.add(
            WRONG, "the principal point lies outside of the images: the intrinsics are of others"
        )
    elif best.error > usable(evidence):  # what makes it somewhat smaller mends nothing
        judgement.add(
            WRONG if best.error > HOPELESS * usable(evidence) else DOUBTFUL,
            f"poses and images do not fit, nor does any usual mistake explain it: the error is "
            f"{best.error:.1f} pixels, of usable poses under {usable(evidence):.1f}",
        )
    elif best is not given:
        alone = sensors is not None and sensors.alone < sensors.shared
        judgement.add(
            WRONG,
            f"{best.text}: the error falls from {given.error:.2f} to {best.error:.2f} pixels",
            *best.setting.split(),
            "depth_camera=as_given" if alone else "",
        )
    elif not given.possible:
        judgement.add(
            WRONG, f"{1 - given.in_front:.0%} of what the images show lies behind the cameras"
        )
    elif found.same:
        judgement.add(
            UNKNOWN, f"the camera moves too little: {', '.join(found.same[:3])} fit as well"
        )


def _judge_scale(judgement: _Judgement, scale: Scale) -> None:
    if not scale.setting:
        return
    if scale.certain:
        judgement.add(
            WRONG,
            f"depth maps and poses differ in unit: depth is {scale.factor:.3g} times what the "
            "images triangulate to",
            scale.setting,
        )
    else:
        judgement.add(
            DOUBTFUL,
            f"what the images show is {float(f'{scale.seen:.3g}'):,g} m away, which no room has in "
            "metres",
            scale.setting,
        )


def _judge_sensors(judgement: _Judgement, sensors: Sensors, found: Found) -> None:
    named = found.best.settings.focal_scale != found.given.settings.focal_scale
    if sensors.apart and not named and abs(np.log(sensors.focal)) > FOCAL:
        judgement.add(
            DOUBTFUL,
            f"depth and colour are not of one camera: colour fits depth best with "
            f"{sensors.focal:.3f} times the focal length",
        )


def unread(statistics: Statistics) -> list[str]:
    """A sentence on the images that cannot be read, if there are any."""
    if not statistics.unread:
        return []
    names = [line.partition(": ")[0] for line in statistics.unread]
    named = ", ".join(names[:NAMED]) + (", ..." if len(names) > NAMED else "")
    return [
        f"{len(names)} of {statistics.looked_at} images cannot be read and will be skipped "
        f"({named}); the first: {statistics.unread[0]}"
    ]


def _judge_images(judgement: _Judgement, statistics: Statistics) -> None:
    for finding in unread(statistics):
        judgement.add(DOUBTFUL, finding)
    if statistics.unread_depth:
        judgement.add(DOUBTFUL, f"depth maps are left out: {statistics.unread_depth}")
    if statistics.ill_exposed > 0.5:
        judgement.add(DOUBTFUL, f"{statistics.ill_exposed:.0%} of the images are black or white")
