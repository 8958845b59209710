"""Bias and noise of an engine whose bias and noise are known."""

import json

import numpy as np
import pytest

from mesoshell.measure.flip import flip
from mesoshell.render.camera import in_pixel, outward
from mesoshell.scene.accumulate import over_backdrop
from mesoshell.tradeoff.points import Point, combined_error, measure_point
from mesoshell.tradeoff.reference import Reference, is_same_scene, render_reference
from tests.helpers.made_passes import SHAPE, passes, picture

EXACT = Reference(picture(), picture(), 0.0, 0.0, 16, True)


def quiet(share: float) -> None:
    pass


@pytest.mark.parametrize(("covered", "scale"), [(1.0, 1.0), (1.0, 1e-3), (0.005, 1.0)])
def test_a_reference_is_of_one_scene_however_dim_or_far(covered: float, scale: float) -> None:
    """A fifth of its light more is another scene; a thousandth, as other processors round, is not."""
    begun, image = passes(0.0, 0.0), picture()
    image[..., :3] *= scale
    lit = lambda share: lambda p: image * np.array([share, share, share, 1.0])  # noqa: E731
    hidden = np.arange(image[..., 0].size).reshape(SHAPE) >= covered * image[..., 0].size
    image[hidden] = 0
    kept = Reference(image, image, 0.0, 0.0, 16, True)
    assert is_same_scene(kept, begun, lit(1.001)) and not is_same_scene(kept, begun, lit(1.2))
    assert not is_same_scene(kept, begun, lambda p: image * np.array([1.0, 1.0, 1.0, 0.9]))
    assert not is_same_scene(kept, begun._replace(shape=(3, 3)), lambda p: image)


def test_noise_falls_with_samples_and_bias_does_not() -> None:
    noisy, images = measure_point({"samples": 48}, passes(0.0, 0.05), EXACT, quiet)
    biased, _ = measure_point({"samples": 24}, passes(0.05, 0.0), EXACT, quiet)
    assert noisy.samples == biased.samples == (1, 2, 4, 8) and images.shape == (4, *SHAPE, 4)
    np.testing.assert_allclose(noisy.relative[-1] / noisy.relative[0], 1 / 8, rtol=0.2)
    assert noisy.bias < 0.2 * noisy.flip[0] and noisy.noise > 0.8 * noisy.flip[0]
    np.testing.assert_allclose(biased.flip, biased.flip[0], rtol=1e-6)
    np.testing.assert_allclose(biased.bias, biased.flip[0], rtol=1e-3)
    assert biased.noise < 0.02 * biased.flip[0] and biased.variance == pytest.approx(0, abs=1e-12)
    true = over_backdrop(picture())
    assert biased.bias2 == pytest.approx(np.mean(0.05**2 / (true**2 + 0.01)))
    assert biased.evaluations == noisy.evaluations == 7
    assert biased.error(4) == biased.flip[2] and noisy.error(64) == pytest.approx(
        combined_error(noisy.bias, noisy.noise, 64)
    )
    assert noisy.flip[-1] / 3 < noisy.error(64) < noisy.flip[-1]


def test_groups_of_rays_lie_about_the_centre_of_their_pixel() -> None:
    """As they do in a picture with `pixel_samples`: a slope across pixels is no error at any number of samples."""
    slope = np.array([1.0, -0.5])

    def one(k: int, pixels: np.ndarray, progress) -> np.ndarray:
        image = picture()
        image[..., :3] += 0.1 * float((in_pixel(outward(k)) - 0.5) @ slope)
        return image.reshape(-1, 4)[pixels]

    point, _ = measure_point({}, passes(0.0, 0.0)._replace(render=one), EXACT, quiet)
    np.testing.assert_allclose(point.relative, 0, atol=1e-20)


def test_the_estimate_of_bias_is_not_biased() -> None:
    """Over draws, that of an engine without bias has mean 0, where the square of a mean has not."""
    found = []
    for seed in range(40):
        exact = Reference(picture(), picture(), 0.0, 0.0, 16, True)
        found.append(measure_point({}, passes(0.0, 0.05 + 1e-6 * seed), exact, quiet)[0])
    each = np.array([p.bias2 for p in found])
    assert abs(each.mean()) < 4 * each.std(ddof=1) / len(each) ** 0.5
    assert each.std() < 0.1 * np.mean([p.variance for p in found])


def test_the_noise_of_the_reference_is_taken_off() -> None:
    image = picture()
    image[..., :3] += 0.03 * np.random.default_rng(1).normal(size=(*SHAPE, 3))
    noise = flip(over_backdrop(image), over_backdrop(picture()))
    clean, _ = measure_point({}, passes(0.0, 0.05), EXACT, quiet)
    rough, _ = measure_point({}, passes(0.0, 0.05), EXACT._replace(image=image, noise=noise), quiet)
    np.testing.assert_allclose(rough.flip[:2], clean.flip[:2], rtol=0.15)
    assert min(rough.flip) >= noise
    same, _ = measure_point({}, passes(0.0, 0.0), EXACT._replace(image=image, noise=noise), quiet)
    np.testing.assert_allclose(same.flip, noise, rtol=1e-6)  # what cannot be told


def test_a_reference_knows_its_noise() -> None:
    """And that its passes are other ones than those of points."""
    exact = passes(0.0, 0.02)
    made, short = render_reference(exact, True, 1e9, 0.004, quiet), render_reference(exact, False, 1e-9, 0.0, quiet)
    true = over_backdrop(picture())
    assert made.same_rays and made.noise <= 0.004 and made.passes > 64
    assert short.passes == 16 and not short.same_rays and short.noise > 2 * made.noise
    assert 0.5 < made.noise / flip(over_backdrop(made.image), true) < 2
    off = np.mean((over_backdrop(made.image) - true) ** 2 / (true**2 + 0.01))
    assert 0.5 < made.variance / off < 2
    np.testing.assert_array_equal(
        made.first, exact.render(0, np.arange(made.first[..., 0].size), quiet).reshape(*SHAPE, 4)
    )


def test_points_are_kept_as_json() -> None:
    point, _ = measure_point({"samples": 48, "filtering": False}, passes(0.01, 0.02), EXACT, quiet)
    assert Point.of(json.loads(json.dumps(point.as_dict()))) == point
