"""What `tf_lab.evaluation` expects of a metric, as checks.

A metric is a function of a `Comparison`, and of its settings by name, that returns a number in the
unit of its column. It is called only where there is something to compare: at least one predicted
point and one of the ground truth. A missing or empty reconstruction scores what the registry says.

Tests run every registered metric through the checks. For one of your own::

    for check in CHECKS:
        check("mine")  # or its settings; an AssertionError says what it does not keep
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import trimesh

from tf_lab.evaluation.metrics import Comparison
from tf_lab.evaluation.registry import METRICS

POINTS = 2000
OFF = 0.2  # metres


def example(off: float, frame: np.ndarray | None = None) -> Comparison:
    """A ball of 60 cm, predicted in its place, or so far beside it (metres) and as noisy.

    Args:
        off: how far.
        frame: [4, 4], moves all of it.
    """
    frame = np.eye(4) if frame is None else frame
    truth = trimesh.creation.icosphere(subdivisions=4, radius=0.6)
    mesh = truth.copy()
    noise = np.random.default_rng(0).normal(0, off / 2, (len(mesh.vertices), 3))
    mesh.vertices = mesh.vertices + noise + (0, 0, off)
    points, faces = map(np.asarray, trimesh.sample.sample_surface(mesh, POINTS, seed=0)[:2])
    visible = points[:, 0] > -0.3
    mesh.apply_transform(frame)
    truth.apply_transform(frame)
    points = trimesh.transform_points(points, frame)
    return Comparison(points, visible, np.asarray(truth.vertices), mesh, faces, truth)


def it_is_a_finite_number(settings: Any) -> None:
    """Of a surface, and of points without one (then the mesh has no faces)."""
    surface = example(OFF)
    cloud = dataclasses.replace(surface, mesh=trimesh.Trimesh(surface.points), faces=None)
    for found in (surface, cloud):
        assert math.isfinite(METRICS.make(settings, found))


def it_is_of_its_input_alone(settings: Any) -> None:
    """The same of the same, without touching what it is given."""
    found, untouched = example(OFF), example(OFF)
    assert METRICS.make(settings, found) == METRICS.make(settings, untouched)
    for name in ("points", "visible", "truth"):
        assert np.array_equal(getattr(found, name), getattr(example(OFF), name)), name


def the_worlds_axes_do_not_matter(settings: Any) -> None:
    """Wherever the origin is, and which way the axes point."""
    frame = trimesh.transformations.rotation_matrix(1.0, (1, 2, 3))
    frame[:3, 3] = (3, -2, 1)
    moved, still = (METRICS.make(settings, example(OFF, f)) for f in (frame, None))
    assert math.isclose(moved, still, rel_tol=1e-3), (moved, still)


def better_is_said(settings: Any) -> None:
    """The truth scores better than what is off and noisy, and no worse than an empty mesh."""
    part = METRICS.named(METRICS.settings(settings))
    assert part.higher_is_better is not None
    sign = 1 if part.higher_is_better else -1
    right, wrong = (METRICS.make(settings, example(off)) for off in (0.0, OFF))
    assert sign * right > sign * wrong, (right, wrong)
    assert sign * right >= sign * part.empty, (right, part.empty)


def settings_shape_scores(settings: Any) -> None:
    """They are a frozen, documented dataclass that begins with the name, and shape scores alone."""
    given = METRICS.settings(settings)
    assert given.__dataclass_params__.frozen
    fields = dataclasses.fields(given)
    assert fields[0].name == METRICS.key
    for field in fields:
        assert field.metadata.get("shapes") == "scores", field.name
        assert field.metadata.get("about"), field.name


CHECKS = (
    it_is_a_finite_number,
    it_is_of_its_input_alone,
    the_worlds_axes_do_not_matter,
    better_is_said,
    settings_shape_scores,
)
