"""Passes of a made-up engine: a picture, a bias, and noise that is drawn anew for each pass."""

import numpy as np

from mesoshell.scene.picture import Passes, Rendered

SHAPE = 24, 20


def picture() -> np.ndarray:
    """A smooth opaque picture."""
    y, x = np.indices(SHAPE) / 24
    return np.stack([0.3 + 0.2 * np.sin(6 * x), 0.4 + 0.2 * y, 0.5 - 0.2 * x, np.ones(SHAPE)], axis=-1)


def passes(bias: float, noise: float, queries: int = 7) -> Passes:
    """bias: added to all colours; noise: deviation of a pass; queries: a pixel and pass."""
    asked = 0

    def one(k: int, pixels: np.ndarray, progress) -> np.ndarray:
        nonlocal asked
        asked += queries * len(pixels)
        image = picture()
        own = np.random.default_rng([k, round(1e6 * bias), round(1e6 * noise)]).normal(size=(*SHAPE, 3))
        image[..., :3] += bias + noise * own
        return image.reshape(-1, 4)[pixels]

    def ended(image: np.ndarray, samples: int) -> Rendered:
        return Rendered(image, {}, {"queries": asked, "quality": {}})

    return Passes(SHAPE, True, lambda pixels: 1, one, ended)
