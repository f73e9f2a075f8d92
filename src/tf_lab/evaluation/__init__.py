"""Metrics, pure, and the published protocol."""

from tf_lab.evaluation.registry import METRICS, PAPER, MetricPart

__all__ = ["METRICS", "PAPER", "MetricPart"]
