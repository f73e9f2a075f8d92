"""Images and depth of any lens become those of a pinhole: compared with the published formulas."""

from typing import Any

import numpy as np
import pytest

from helpers import lenses
from tf_lab.data.lens import MAX_SLOPE, Camera, camera_of, rectify_image, register_depth
from tf_lab.errors import TFLabError

SIZE = (128, 96)
FOCAL = dict(fx=110.0, fy=115.0, cx=60.25, cy=49.5)

LENSES: dict[str, tuple[Camera, lenses.Lens]] = {
    name: (Camera(SIZE, **{**FOCAL, **focal}, distortion=k, fisheye=fish),
           lenses.fisheye(*k) if fish else lenses.perspective(*k))
    for name, (k, fish, focal) in {
        "barrel": ((-0.25, 0.06, 0.0, 0.0), False, {}),
        "pincushion": ((0.15, 0.02, 0.0, 0.0), False, {}),
        "tangential": ((0.0, 0.0, 0.02, -0.03), False, {}),
        "five": ((0.26, -0.95, -0.005, 0.003, 1.16), False, {}),
        "rational": ((0.5, 0.1, 0.001, -0.002, 0.01, 0.8, 0.2, 0.02), False, {}),
        "off centre": ((-0.2, 0.05, 0.0, 0.0), False, dict(cx=10.0, cy=90.0)),
        "fisheye": ((0.03, -0.01, 0.004, -0.001), True, {}),
        "equidistant": ((), True, dict(fx=80.0, fy=80.0)),
        "160 degrees": ((0.03, 0.005, 0.0006, 0.0001), True, dict(fx=45.0, fy=45.0)),
    }.items()
}  # fmt: skip
every_lens = pytest.mark.parametrize("name", list(LENSES))


def seen_at(camera: Camera, lens: lenses.Lens, pinhole: Camera) -> np.ndarray:
    """Where the lens has the pixels of the pinhole image: [H, W, 2] pixels of the source."""
    bent = lens(lenses.slopes_of(pinhole.K, pinhole.size))
    return np.asarray(bent * [camera.fx, camera.fy] + [camera.cx, camera.cy])


@every_lens
@pytest.mark.parametrize("size", [SIZE, (64, 48), (200, 150)])
def test_colour_equals_what_a_pinhole_sees(name: str, size: tuple[int, int]) -> None:
    camera, lens = LENSES[name]
    pinhole = camera.pinhole(size)
    assert (pinhole.size, pinhole.distorted) == (size, False)
    image = lenses.photograph(camera.K, SIZE, lens)
    seen = rectify_image(image, camera, pinhole)
    assert (seen.dtype, seen.shape) == (np.uint8, (size[1], size[0], 3))
    expected = lenses.colours(lenses.slopes_of(pinhole.K, size))
    error = np.abs(seen - expected)
    # at the edges the source ends half a pixel early
    assert error[2:-2, 2:-2].max() < 2.5
    assert error.mean() < 0.5


@every_lens
def test_the_pinhole_sees_only_what_the_lens_saw_and_nearly_all_of_it(name: str) -> None:
    camera, lens = LENSES[name]
    pinhole = camera.pinhole(SIZE)
    at = seen_at(camera, lens, pinhole)
    assert (at > -0.55).all()
    assert (at < [SIZE[0] - 0.45, SIZE[1] - 0.45]).all()
    slopes = lenses.slopes_of(pinhole.K, SIZE)
    assert np.abs(slopes).max() < MAX_SLOPE
    assert (np.diff(at[..., 0], axis=1) > 0).all()
    assert (np.diff(at[..., 1], axis=0) > 0).all()
    reached = [at[..., 0].min() < 3, at[..., 0].max() > SIZE[0] - 4,
               at[..., 1].min() < 3, at[..., 1].max() > SIZE[1] - 4]  # fmt: skip
    assert all(reached) or np.abs(slopes).max() > 0.97 * MAX_SLOPE


def test_a_straight_lens_of_the_size_is_left_alone() -> None:
    camera = Camera(SIZE, **FOCAL, distortion=(0.0, 0.0, 0.0, 0.0))
    image = lenses.photograph(camera.K, SIZE)
    pinhole = camera.pinhole(SIZE)
    assert pinhole == Camera(SIZE, **FOCAL)
    np.testing.assert_array_equal(rectify_image(image, camera, pinhole), image)
    assert rectify_image(image, pinhole, pinhole) is image


@pytest.mark.parametrize("size", [(64, 48), (256, 192), (100, 90)])
def test_resized_images_have_the_resized_camera(size: tuple[int, int]) -> None:
    camera = Camera(SIZE, **FOCAL)
    seen = rectify_image(lenses.photograph(camera.K, SIZE), camera, camera.pinhole(size))
    expected = lenses.colours(lenses.slopes_of(camera.resized(size).K, size))
    assert np.abs(seen - expected)[3:-3, 3:-3].max() < 3


def test_resizing_keeps_the_corner_of_the_image() -> None:
    half = Camera((640, 480), 500, 510, 319.5, 200.0, (0.1, 0, 0, 0)).resized((320, 240))
    assert half == Camera((320, 240), 250, 255, 159.5, 99.75, (0.1, 0, 0, 0))
    camera = Camera((3, 3), 2.1, 2.2, 1.1, 1.3)
    assert camera.resized((3, 3)) is camera


NONSENSE: dict[str, tuple[tuple[float, ...], bool]] = {
    "folded": ((-5.0, 0, 0, 0), False),
    "huge": ((1e9, 0, 0, 0), False),
    "infinite in float32": ((-1e30, 0, 0, 1e30), False),
    "pole": ((0.5, 0.1, 0, 0, 0.01, -8.0, 0.2, 0.02), False),
    "overflow": ((1e300, -1e300, 1e300, 1e300, 1e300), False),
    "folded fisheye": ((-6.0, 0, 0, 0), True),
    "huge fisheye": ((1e200, 0, 0, -1e200), True),
}


@pytest.mark.parametrize("name", list(NONSENSE))
def test_nonsense_is_refused(name: str) -> None:
    distortion, fish = NONSENSE[name]
    camera = Camera((640, 480), 500, 500, 320, 240, distortion, fish)
    with pytest.raises(TFLabError, match="makes no sense"):
        camera.pinhole((640, 480))


@pytest.mark.filterwarnings("ignore::RuntimeWarning")  # of this test's formulas
def test_any_lens_is_refused_or_seen_through() -> None:
    random, refused = np.random.default_rng(5), 0
    for _ in range(150):
        fish = bool(random.integers(2))
        count = 4 if fish else int(random.choice([4, 5, 8]))
        magnitude = 10 ** random.uniform(-3, random.choice([0, 3, 30]))
        distortion = tuple((random.normal(size=count) * magnitude).tolist())
        focal, at = 10 ** random.uniform(0, 4, 2), random.uniform(0, 0.99, 2) * SIZE
        try:
            camera = Camera(SIZE, *focal.tolist(), *at.tolist(), distortion, fish)
            pinhole = camera.pinhole(SIZE)
        except TFLabError:
            refused += 1
            continue
        seen = rectify_image(np.zeros((SIZE[1], SIZE[0], 3), np.uint8), camera, pinhole)
        assert seen.shape == (SIZE[1], SIZE[0], 3)
        assert np.isfinite(pinhole.K).all()
    assert 30 < refused < 130


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"size": (0, 10)}, "0x10 is impossible"),
        ({"size": (10**9, 10**9)}, "is impossible"),
        ({"fx": 0.0}, "must be positive"),
        ({"fy": -1.0}, "must be positive"),
        ({"fx": float("nan")}, "NaN or infinity"),
        ({"distortion": (0.0, float("inf"), 0.0, 0.0)}, "NaN or infinity"),
        ({"distortion": (0.1, 0.2)}, "2 distortion coefficients"),
        ({"distortion": (0.1,) * 5, "fisheye": True}, "5 distortion coefficients"),
    ],
)
def test_impossible_cameras(change: dict[str, Any], message: str) -> None:
    with pytest.raises(TFLabError, match=message):
        Camera(**{"size": SIZE, **FOCAL, **change})


def test_whether_intrinsics_are_of_the_images() -> None:
    assert Camera(SIZE, **FOCAL).centred
    for change in ({"cx": 128.0}, {"cy": -1.0}):
        assert not Camera(SIZE, **{**FOCAL, **change}).centred


def test_cameras_of_matrices() -> None:
    K = np.array([[110.0, 0, 60.25], [0, 115.0, 49.5], [0, 0, 1]])
    assert camera_of(K, SIZE) == Camera(SIZE, **FOCAL)
    np.testing.assert_array_equal(camera_of(K, SIZE).K, K)
    with pytest.raises(TFLabError, match="skewed"):
        camera_of(np.array([[110.0, 0.5, 60.25], [0, 115.0, 49.5], [0, 0, 1]]), SIZE)
    for wrong in (K.T, -K, K * 2, K * np.nan):
        with pytest.raises(TFLabError, match="not a camera matrix"):
            camera_of(wrong, SIZE)


PLANE = np.array([0.25, -0.35, 0.9, 2.0])  # slanted: 1.7 to 4 m away
DEPTH_CAMERAS: dict[str, tuple[Camera, lenses.Lens | None]] = {
    "smaller": (Camera((64, 48), 55.0, 57.5, 29.875, 24.5), None),
    "larger": (Camera((320, 240), 275.0, 287.5, 151.4, 124.5), None),
    "other intrinsics": (Camera((90, 70), 70.0, 68.0, 47.0, 33.0), None),
    "other shape": (Camera((131, 60), 90.0, 91.0, 66.0, 28.5), None),
    "lens": (Camera((100, 75), 80.0, 82.0, 50.0, 37.0, (-0.2, 0.05, 0.001, 0.002)),
             lenses.perspective(-0.2, 0.05, 0.001, 0.002)),
    "fisheye": (Camera((100, 75), 70.0, 70.0, 50.0, 37.0, (0.03, 0.0, 0.0, 0.0), True),
                lenses.fisheye(0.03)),
}  # fmt: skip
COLOR = Camera(SIZE, **FOCAL)


PLACES = {
    "there": None,
    "beside": lenses.moved([0, 0, 0], [0.05, 0.01, 0.0]),
    "turned": lenses.moved([0.02, -0.08, 0.05], [-0.04, 0.02, 0.03]),
}


@pytest.mark.parametrize("place", list(PLACES))
@pytest.mark.parametrize("name", list(DEPTH_CAMERAS))
def test_depth_of_a_plane_in_the_colour_camera(name: str, place: str) -> None:
    camera, lens = DEPTH_CAMERAS[name]
    color_T_depth = PLACES[place]
    depth_T_color = np.linalg.inv(np.eye(4) if color_T_depth is None else color_T_depth)
    there = lenses.slopes_of(camera.K, camera.size, lens)
    measured = lenses.plane_depth(PLANE, depth_T_color, there).astype(np.float32)
    seen = register_depth(measured, camera, COLOR, color_T_depth)
    assert (seen.dtype, seen.shape) == (np.float32, (SIZE[1], SIZE[0]))
    expected = lenses.plane_depth(PLANE, np.eye(4), lenses.slopes_of(COLOR.K, SIZE))
    known = seen > 0
    assert known[20:-20, 25:-25].mean() > 0.97  # both look there: hardly a hole
    error = (seen - expected)[known]
    # the nearest reading of the coarser image: at most a pixel of it away
    pixel = np.abs(np.gradient(expected)).max() * max(1, 1.3 * COLOR.fx / camera.fx)
    assert np.abs(error).max() < 1.5 * pixel
    assert abs(error.mean()) < 0.1 * pixel  # and as often on this side as on that


def test_depth_of_the_same_camera_is_left_alone() -> None:
    depth = np.random.default_rng(0).uniform(0, 5, (SIZE[1], SIZE[0])).astype(np.float32)
    assert register_depth(depth, COLOR, COLOR) is depth


def test_registered_depth_is_made_of_readings() -> None:
    depth = np.random.default_rng(0).uniform(1, 5, (37, 50)).astype(np.float32)
    depth[5:20, 10:30] = 0
    for camera in (Camera((50, 37), 44.0, 45.0, 25.0, 18.0),
                   Camera((50, 37), 44.0, 45.0, 25.0, 18.0, (-0.2, 0.0, 0.0, 0.0))):  # fmt: skip
        seen = register_depth(depth, camera, COLOR)
        assert set(seen.ravel()) <= set(depth.ravel())
        assert 0.05 < (seen == 0).mean() < 0.5


def test_the_nearer_surface_hides_the_farther_one() -> None:
    camera = Camera((64, 48), 50.0, 50.0, 31.5, 23.5)
    depth = np.full((48, 64), 4.0, np.float32)
    depth[:, 32:] = 1.0
    seen = register_depth(depth, camera, camera, lenses.moved([0, 0, 0], [-0.2, 0, 0]))
    # the near half moves by 50 * 0.2 / 1 = 10 pixels, the far one by 2.5
    assert set(np.unique(seen)) == {0.0, 1.0, 4.0}
    assert (seen[:, 22:54] == 1).all()
    assert (seen[:, :22] == 4).mean() > 0.99
    assert (seen[:, 54:] == 0).all()


def test_readings_behind_the_camera_or_missing_give_none() -> None:
    camera = Camera((8, 6), 8.0, 8.0, 3.5, 2.5)
    depth = np.full((6, 8), 0.5, np.float32)
    assert (register_depth(depth, camera, camera, lenses.moved([0, 0, 0], [0, 0, -1.0])) == 0).all()
    for value in (0.0, np.nan, -1.0, np.inf):
        nothing = np.full((6, 8), value, np.float32)
        assert (
            register_depth(nothing, camera, camera, lenses.moved([0, 0, 0], [0.1, 0, 0])) == 0
        ).all()
