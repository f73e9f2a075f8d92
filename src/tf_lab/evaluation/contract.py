"""What a metric promises, and the check of it that every registered metric is run through.

A metric is a function of a `Comparison`, and of its settings by name, that returns a number in the
unit of its column. It is called only where there is something to compare: at least one predicted
point and one of the ground truth. A missing or empty reconstruction scores what the registry says.

1. The number is finite, of a surface and of a point cloud (which has no faces).
2. It is a pure function: the same for the same input, which it leaves as it is.
3. It does not depend on where the world's origin is and which way its axes point.
4. A reconstruction on the ground truth is better than one that is 20 cm off and full of noise, and
   not worse than an empty one; ``higher_is_better`` says which way that is.
5. Its settings are a frozen dataclass whose first field is its name, and all of them shape scores.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from typing import Any

import numpy as np
import trimesh

from tf_lab.evaluation.metrics import Comparison
from tf_lab.evaluation.registry import METRICS, MetricPart

POINTS = 2000


def check_metric(part: MetricPart, settings: Any = None) -> None:
    """Check that a registered metric keeps the contract.

    Args:
        part: the metric.
        settings: of it; None: its defaults.

    Raises:
        AssertionError: it does not; says what.
    """
    settings = part.settings(part.name) if settings is None else settings
    _check_settings(part, settings)
    function = functools.partial(METRICS.make, settings)
    exact, noisy = comparison(0.0), comparison(0.2)
    for found in (exact, noisy, cloud(exact)):
        given = (found.points, found.visible, found.truth)
        before = points, visible, truth = tuple(map(np.copy, given))
        value = function(found)
        assert math.isfinite(value), f"{part.name}: not finite"
        for array, copy in zip(given, before, strict=True):
            assert np.array_equal(array, copy), f"{part.name}: changes its input"
        again = Comparison(points, visible, truth, found.mesh, found.faces, found.truth_mesh)
        assert function(again) == value, f"{part.name}: not pure"
    score, worse = function(exact), function(noisy)
    moved = function(comparison(0.2, elsewhere()))
    assert math.isclose(moved, worse, rel_tol=1e-3), f"{part.name}: depends on the world's frame"
    assert part.higher_is_better is not None, f"{part.name}: higher_is_better is not said"
    sign = 1 if part.higher_is_better else -1
    assert sign * score > sign * worse, f"{part.name}: {score} on it, {worse} off it"
    assert sign * score >= sign * part.empty, f"{part.name}: an empty mesh is better than the truth"
    printed = float(format(score, part.format))
    assert math.isclose(printed, score, abs_tol=0.1), f"{part.name}: {score} is shown as {printed}"


def _check_settings(part: MetricPart, settings: Any) -> None:
    fields = dataclasses.fields(settings)
    assert settings.__dataclass_params__.frozen, f"{part.name}: its settings are not frozen"
    assert fields[0].name == METRICS.key, f"{part.name}: its settings do not begin with its name"
    assert METRICS.named(settings) == part, f"{part.name}: its settings have another name"
    for field in fields:
        shapes = field.metadata.get("shapes")
        assert shapes == "scores", f"{part.name}.{field.name}: shapes {shapes}, not scores"
        assert field.metadata.get("about"), f"{part.name}.{field.name}: is not documented"


def comparison(off: float, frame: np.ndarray | None = None) -> Comparison:
    """A ball of 60 cm, predicted at its place or ``off`` (metres) beside it and as noisy.

    Args:
        off: how far.
        frame: [4, 4] moves all of it.
    """
    truth = trimesh.creation.icosphere(subdivisions=4, radius=0.6)
    mesh = truth.copy()
    noise = np.random.default_rng(0).normal(0, off / 2, (len(mesh.vertices), 3))
    mesh.vertices = mesh.vertices + noise + (0, 0, off)
    points, faces = trimesh.sample.sample_surface(mesh, POINTS, seed=0)[:2]
    visible = np.asarray(points)[:, 0] > -0.3
    for each in (truth, mesh):
        each.apply_transform(np.eye(4) if frame is None else frame)
    points = trimesh.transform_points(points, np.eye(4) if frame is None else frame)
    return Comparison(points, visible, np.asarray(truth.vertices), mesh, np.asarray(faces), truth)


def cloud(found: Comparison) -> Comparison:
    """The same prediction as points without a surface."""
    mesh = trimesh.Trimesh(found.points, process=False)
    return Comparison(found.points, found.visible, found.truth, mesh, None, found.truth_mesh)


def elsewhere() -> np.ndarray:
    """[4, 4]: turned about no axis of the world, and moved."""
    turn = trimesh.transformations.rotation_matrix(1.0, (1, 2, 3))
    turn[:3, 3] = (3, -2, 1)
    return turn
