"""Each effect by itself, on images whose change can be worked out by hand."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from tf_lab.data.photometric import photometric, streak
from tf_lab.data.settings import PhotometricSettings

NONE = PhotometricSettings()
ALL = PhotometricSettings(1.0, 0.25, 1.2, 5.0, 0.04, 0.25, 0.25, 40)


def flat(red: int, green: int, blue: int, size: int = 16) -> np.ndarray:
    return np.full((size, size, 3), (red, green, blue), np.uint8)


def dot(size: int = 31) -> np.ndarray:
    image = np.zeros((size, size, 3), np.uint8)
    image[size // 2, size // 2] = 255
    return image


def noise(size: int = 64) -> np.ndarray:
    return np.random.default_rng(3).integers(40, 216, (size, size, 3), dtype=np.uint8)


def draws(image: np.ndarray, settings: PhotometricSettings, n: int = 40) -> Iterator[np.ndarray]:
    rng = np.random.default_rng(0)
    return (photometric(image, settings, rng) for _ in range(n))


def linear(image: np.ndarray) -> np.ndarray:
    return (image.astype(float) / 255) ** 2.2


def test_nothing_is_nothing() -> None:
    for result in draws(noise(), NONE, 3):
        np.testing.assert_array_equal(result, noise())


def test_an_image_is_a_function_of_the_generator() -> None:
    first, second = draws(noise(), ALL, 2)
    assert first.dtype == np.uint8 and first.shape == noise().shape
    np.testing.assert_array_equal(next(draws(noise(), ALL)), first)
    assert (first != second).mean() > 0.5


def test_exposure_multiplies_light() -> None:
    """By 2^x, |x| at most as told, the same for all channels; nothing is left out of the range."""
    stops = []
    for result in draws(flat(100, 120, 80), replace(NONE, exposure=0.8)):
        found = np.log2(linear(result[0, 0]) / linear(np.array([100, 120, 80])))
        assert np.ptp(found) < 0.06  # 8 bits
        stops.append(found.mean())
    assert 0.6 < max(stops) < 0.83 and -0.83 < min(stops) < -0.6


def test_white_balance_spares_green() -> None:
    gains = []
    for result in draws(flat(120, 120, 120), replace(NONE, white_balance=0.3)):
        red, green, blue = np.log(linear(result[0, 0]) / linear(np.array(120)))
        assert abs(green) < 1e-6
        gains.append((red, blue))
    assert 0.2 < np.max(gains) < 0.32 and -0.32 < np.min(gains) < -0.2
    assert abs(np.corrcoef(np.array(gains).T)[0, 1]) < 0.5  # two draws, not one


def test_gamma_keeps_black_and_white() -> None:
    image = np.stack([flat(v, v, v)[0] for v in (0, 128, 255)])
    exponents = []
    for black, grey, white in (r[:, 0, 0] for r in draws(image, replace(NONE, gamma=0.5))):
        assert (black, white) == (0, 255)
        exponents.append(np.log(np.log(grey / 255) / np.log(128 / 255)))
    assert 0.35 < max(exponents) < 0.52 and -0.52 < min(exponents) < -0.35


def test_contrast_keeps_the_mean() -> None:
    image = noise()
    gains = []
    for result in draws(image, replace(NONE, contrast=0.2)):
        assert result.mean() == pytest.approx(image.mean(), abs=0.6)
        gains.append(np.log(result.std() / image.std()))
    assert 0.14 < max(gains) < 0.21 and -0.21 < min(gains) < -0.14


def test_blur_spreads_light_and_keeps_its_sum() -> None:
    spreads = []
    v, u = np.mgrid[:31, :31] - 15
    for result in draws(dot(), replace(NONE, blur=2.0)):
        light = linear(result)[..., 0]
        assert light.sum() == pytest.approx(1, abs=0.05)
        spreads.append(np.sqrt((light * v**2).sum() / light.sum()))
        assert (light * u**2).sum() == pytest.approx((light * v**2).sum(), rel=0.02, abs=1e-6)
    assert 1.2 < max(spreads) < 2.05
    assert 10 < sum(s == 0 for s in spreads) < 30  # half of the images


def test_motion_blur_is_a_line() -> None:
    lengths = []
    v, u = np.mgrid[:31, :31] - 15
    for result in draws(dot(), replace(NONE, motion=8.0)):
        light = linear(result)[..., 0]
        assert light.sum() == pytest.approx(1, abs=0.05)
        moments = np.array([[(light * a * b).sum() / light.sum() for a in (u, v)] for b in (u, v)])
        across, along = np.linalg.eigvalsh(moments)
        assert across < 0.3  # of a pixel, squared: the raster's
        lengths.append(np.sqrt(12 * along))  # a uniform line of length L has a variance L^2 / 12
    assert 5 < max(lengths) < 9
    assert 20 < sum(length < 0.5 for length in lengths) < 38  # three quarters of the images


@pytest.mark.parametrize("angle", [0.0, np.pi / 2])
def test_a_streak_along_an_axis(angle: float) -> None:
    kernel = streak(4.0, angle)
    assert kernel.sum() == pytest.approx(1)
    line = kernel[2] if angle == 0 else kernel[:, 2]
    assert line.sum() == pytest.approx(1)
    assert (line > 0).all()
    assert streak(0.0, angle).tolist() == [[1]]


def test_noise_has_the_deviation_it_says() -> None:
    deviations = []
    for result in draws(flat(128, 128, 128, 48), replace(NONE, noise=0.05)):
        error = result.astype(float) / 255 - 128 / 255
        assert abs(error.mean()) < 0.004
        assert abs(np.corrcoef(error[..., 0].ravel(), error[..., 1].ravel())[0, 1]) < 0.1
        deviations.append(error.std())
    assert 0.04 < max(deviations) < 0.052 and min(deviations) < 0.01


def test_jpeg_loses_detail_and_keeps_colours() -> None:
    """Half of the images; a flat colour stays, channels in their places."""
    for result in draws(flat(200, 60, 30), replace(NONE, jpeg=20)):
        assert np.abs(result.astype(int) - (200, 60, 30)).max() <= 6
    changed = [
        np.abs(r.astype(int) - noise()).mean() for r in draws(noise(), replace(NONE, jpeg=20))
    ]
    assert 8 < sum(c > 0 for c in changed) < 32
    assert max(changed) > 10
