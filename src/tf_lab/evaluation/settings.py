"""Hyper-parameters of the metrics."""

from __future__ import annotations

from dataclasses import dataclass

from tf_lab.support.settings import setting


@dataclass(frozen=True)
class PaperSettings:
    """A metric of the published protocol, which has no choice of numbers."""

    name: str = setting(about="of the metric", shapes="scores")


@dataclass(frozen=True)
class NormalsSettings:
    """Normal consistency: how well the directions of the two surfaces agree, 1 at best."""

    name: str = setting("normals", "of the metric", shapes="scores")
