"""The phone's camera before a wall with one edge: each flaw has the size that geometry says."""

import numpy as np
import pytest
import torch

from helpers.box_room import look
from tf_lab import geometry
from tf_lab.data.flats.phone import (
    TURN,
    Filming,
    Motion,
    Phone,
    blur,
    make_phone,
    motion_at,
    pass_times,
)
from tf_lab.data.rooms.materials import Textures
from tf_lab.data.rooms.render import Lighting, Renderer
from tf_lab.data.rooms.shapes import Surfaces
from tf_lab.data.rooms.textures import SIZE
from tf_lab.geometry import pinhole

PHONE = Phone(np.radians(60), shutter=0.03, readout=0.03, pace=0.5, height=1.5, key=0.25)
K = pinhole((160, 120), PHONE.field_of_view)
FRONT = look(np.zeros(3), 0.0, 0.0)
STILL = Motion(np.zeros(3), np.zeros(3))
DARK, BRIGHT = 0.2, 1.0


def wall(brightness: float = 1.0) -> Renderer:
    """A wall 2 m ahead (x = 2), dark left of the middle and bright right of it; only ambient."""
    surfaces = Surfaces(np.random.default_rng(0))
    for y0, y1, tint in ((0.0, 20.0, DARK), (-20.0, 0.0, BRIGHT)):
        corners = np.array([[2, y1, -20], [2, y0, -20], [2, y0, 20], [2, y1, 20]])
        surfaces.polygon(corners, 0, tint * np.ones(3))
    white = Textures([np.ones((SIZE, SIZE, 3))], [0.01])
    none = np.empty((0, 3))
    light = Lighting(none, none, brightness * np.ones(3), 1.0)
    return Renderer(surfaces.build(), white, [light], K, (160, 120), 4)


def edge(image: np.ndarray) -> np.ndarray:
    """Where the edge is [H], in pixels, to a fraction of one: from how much of a row is dark."""
    dark = (image.mean(-1) - BRIGHT) / (DARK - BRIGHT)
    return dark.clip(0, 1).sum(axis=1) - 0.5


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(3)


def test_a_still_rolling_shutter_changes_nothing() -> None:
    still, depth = wall().render(FRONT)
    rolling, same = wall().render(STILL.poses(FRONT, np.linspace(-0.015, 0.015, 120)))
    np.testing.assert_allclose(rolling, still, atol=1e-9)
    np.testing.assert_allclose(same, depth, atol=1e-6)
    np.testing.assert_allclose(depth, 2, atol=1e-6)


def test_rolling_shutter_shears_what_a_turn_passes() -> None:
    """Turning by w shifts the edge by f tan(w t) in a row that is exposed at t."""
    rate = 0.8  # rad/s, clockwise from above: about the camera's y axis, which points down
    times = np.linspace(-0.5, 0.5, 120) * PHONE.readout
    poses = Motion(np.zeros(3), np.array([0, rate, 0])).poses(FRONT, times)
    found = edge(wall().render(poses)[0])
    expected = K[0, 2] - K[0, 0] * np.tan(rate * times)
    assert np.ptp(expected) > 3
    np.testing.assert_allclose(found, expected, atol=0.2)
    # the stored pose is the middle row's
    assert np.abs(found - edge(wall().render(FRONT)[0]))[[59, 60]].max() < 0.2


def test_blur_is_as_wide_as_the_way_during_exposure() -> None:
    rate = 1.5
    motion = Motion(np.zeros(3), np.array([0, rate, 0]))
    linear, depth = wall().render(FRONT)
    path = motion.flow(FRONT, depth, K) * PHONE.shutter
    row = blur(linear, path)[60].mean(-1)
    way = K[0, 0] * rate * PHONE.shutter
    assert way > 6
    ramp = np.flatnonzero((row > DARK + 0.02) & (row < BRIGHT - 0.02))
    assert len(ramp) == pytest.approx(way, abs=2)
    assert np.diff(row[ramp]).min() > 0, "a ramp"
    assert ramp.mean() == pytest.approx(K[0, 2], abs=0.7), "about where the edge is at the pose"
    np.testing.assert_array_equal(blur(linear, 0 * path), linear)


def test_flow_is_what_points_do(rng: np.random.Generator) -> None:
    """Against points projected a moment before and after, by the project's own geometry."""
    motion = Motion(rng.normal(size=3), rng.normal(size=3))
    pose = look(np.array([0.3, -0.2, 1.4]), 0.7, -0.3)
    depth = rng.uniform(0.5, 4, (120, 160))
    rays = geometry.pixel_directions(torch.tensor(K), (160, 120))
    points = geometry.transform(
        torch.tensor(pose), (rays * torch.tensor(depth)[..., None]).view(-1, 3)
    )
    h = 1e-4
    uv = [
        geometry.project(points, torch.tensor(K), geometry.invert_pose(torch.tensor(p)))[0]
        for p in motion.poses(pose, np.array([-h, h]))
    ]
    expected = ((uv[1] - uv[0]) / (2 * h)).view(120, 160, 2).numpy()
    np.testing.assert_allclose(motion.flow(pose, depth, K), expected, rtol=1e-3, atol=0.05)


def test_the_motion_of_a_trail(rng: np.random.Generator) -> None:
    motion = Motion(np.array([0.4, 0.1, -0.1]), np.array([0.2, 0.9, -0.1]))
    trail = motion.poses(look(np.ones(3), 0.4, -0.2), np.arange(9) * 0.02)
    for number in (0, 4, 8):
        found = motion_at(trail, np.arange(9) * 0.02, number)
        np.testing.assert_allclose(found.turn, motion.turn, atol=1e-9)
        np.testing.assert_allclose(found.velocity, motion.velocity, atol=1e-9)


def test_who_films_slows_down_in_turns() -> None:
    """A way straight on, then a turn on the spot, at a pace of 0.5 m/s."""
    straight = [look(np.array([x, 0, 1]), 0.0, 0.0) for x in np.arange(11) * 0.01]
    turn = [look(np.array([0.1, 0, 1]), yaw, 0.0) for yaw in np.arange(1, 11) * 0.1]
    times = pass_times(np.array([*straight, *turn]), 0.5)
    np.testing.assert_allclose(np.diff(times[:11]), 0.01 / 0.5)
    np.testing.assert_allclose(np.diff(times[10:]), 0.1 / TURN / 0.5)


def test_exposure_follows_the_light(rng: np.random.Generator) -> None:
    """Into a room four times as bright: too bright at first, then right again within a second."""
    filming = Filming(PHONE, wall(), K, 60, rng)
    before = [filming.frame(i, FRONT, STILL)[0].mean() for i in range(30)]
    filming._renderer = wall(brightness=4.0)
    after = [filming.frame(i, FRONT, STILL)[0].mean() for i in range(30, 60)]
    assert np.ptp(before) > 1, "it drifts"
    assert np.std(before) < 12
    assert after[0] > np.mean(before) + 30
    assert np.abs(np.mean(after[-10:]) - np.mean(before)) < 12
    assert np.mean(after[:3]) > np.mean(after[5:8]) > np.mean(after[15:])


def test_colours_drift_apart(rng: np.random.Generator) -> None:
    filming = Filming(PHONE, wall(), K, 60, rng)
    colours = np.array([filming.frame(i, FRONT, STILL)[0].mean((0, 1)) for i in range(0, 60, 4)])
    warmth = colours[:, 0] / colours[:, 2]
    assert 0.01 < np.ptp(warmth) < 0.3


def test_depth_is_that_of_the_pose(rng: np.random.Generator) -> None:
    """Whatever the motion: depth is of a global shutter at the stored pose."""
    fast = Motion(np.array([3.0, 1, 0]), np.array([1.0, 2, 0]))
    _, depth = Filming(PHONE, wall(), K, 1, rng).frame(0, FRONT, fast)
    np.testing.assert_allclose(depth, 2, atol=1e-6)


def test_phones_in_use() -> None:
    phones = [make_phone(np.random.default_rng(i)) for i in range(300)]
    views = np.degrees([p.field_of_view for p in phones])
    assert 50 <= views.min() < 52 and 73 < views.max() <= 75
    K = pinhole((160, 120), phones[0].field_of_view)
    corner = (80 / K[0, 0], K[0, 0] / K[1, 1])
    assert np.degrees(2 * np.arctan(corner[0])) == pytest.approx(views[0]) and corner[1] == 1
    assert all(1.1 < p.height < 1.7 for p in phones)
