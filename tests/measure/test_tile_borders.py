"""A field of the bundled corner tiles shows no seams: radiance jumps no more across a tile's border than across lines inside.

Oracle: the same field with its tiles in an order that no border fits, where it does.
"""

import jax
import numpy as np
import pytest

from mesoshell.io.bundle import Bundle, read_bundle
from mesoshell.io.material import find
from mesoshell.measure import above
from mesoshell.shell.material import corner_tiles
from mesoshell.shell.material.loader import load_device_material

#: Patches along the field, and pixels a patch.
FIELD = (8, 32)


def jumps(bundle: Bundle) -> list[np.ndarray]:
    """Mean change of radiance from pixel to pixel across each line of a patch (32,), by axis; the first is its border."""
    picture, by_axis = (
        above.picture(load_device_material(bundle), np.zeros(1, np.float32), FIELD, (0.6, 0.0, 0.8), 32),
        [],
    )
    for axis in (0, 1):
        change = np.abs(np.diff(picture, axis=axis)).mean(axis=(1 - axis, 2))
        line = np.arange(1, len(change) + 1) % FIELD[1]
        by_axis.append(np.array([change[line == k].mean() for k in range(FIELD[1])]))
    return by_axis


@pytest.mark.slow  # of the shipped turf; test_corner_tiles has borders of every level
def test_a_border_is_a_line_like_others(monkeypatch, optimised) -> None:
    turf, ordered = read_bundle(find("turf")), corner_tiles.places
    for border, *inside in jumps(turf):
        assert border < 1.05 * np.median(inside) and border < max(inside)
    order = np.random.default_rng(0).permutation(16)
    monkeypatch.setattr(corner_tiles, "places", lambda colours: ordered(colours)[order])
    jax.clear_caches()
    for border, *inside in jumps(turf):
        assert border > 1.1 * np.median(inside) and border > max(inside)
    jax.clear_caches()
