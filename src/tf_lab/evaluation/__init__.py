"""Metrics, pure, and the published protocol."""
