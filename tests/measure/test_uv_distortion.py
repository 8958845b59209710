"""Charts whose numbers are known: a sphere on itself, squeezed, doubled over, and thrown together."""

import numpy as np
import pytest

from mesoshell.measure.uv_distortion import chart
from mesoshell.neutex.layout import directions


def test_a_sphere_on_itself_is_even_and_whole() -> None:
    y = directions("latlong", 96).astype(float)
    found = chart([y], [y], [np.ones(y.shape[:2], bool)])
    assert found.distortion < 0.01 and found.folded < 1e-9 and found.used == pytest.approx(1, abs=1e-6)


def test_size_and_side_do_not_matter() -> None:
    y = directions("latlong", 48).astype(float)
    hit = np.ones(y.shape[:2], bool)
    a, b = chart([y], [y], [hit]), chart([3 * y + 5], [-y], [hit])
    assert b.distortion == pytest.approx(a.distortion, abs=1e-6) and b.folded == 0


def test_distortion_is_the_deviation_of_the_log_of_the_ratio_of_areas() -> None:
    """A flat square whose right half is twice as wide in the texture."""
    x, z = np.meshgrid(np.linspace(-0.01, 0.01, 65), np.linspace(-0.01, 0.01, 65), indexing="xy")
    y = np.stack([x, z, np.ones_like(x)], axis=-1)
    u = np.stack([np.where(x > 0, 2 * x, x), z, np.ones_like(x)], axis=-1)
    found = chart([y], [u / np.linalg.norm(u, axis=-1, keepdims=True)], [np.ones(x.shape, bool)])
    assert found.distortion == pytest.approx(np.log(2) / 2, rel=0.02)


def test_a_fold_is_seen() -> None:
    x, z = np.meshgrid(np.linspace(-0.1, 0.1, 64), np.linspace(-0.1, 0.1, 64), indexing="xy")
    y = np.stack([x, z, np.ones_like(x)], axis=-1)
    u = np.stack([np.abs(x - 0.05), z, np.ones_like(x)], axis=-1)
    found = chart([y], [u / np.linalg.norm(u, axis=-1, keepdims=True)], [np.ones(x.shape, bool)])
    assert found.folded == pytest.approx(0.25, abs=0.02)


def test_all_in_one_place_uses_one_cell() -> None:
    y = directions("latlong", 48).astype(float)
    u = np.broadcast_to([0.0, 0.6, 0.8], y.shape) + 1e-9 * y
    found = chart([y], [u], [np.ones(y.shape[:2], bool)])
    assert found.used < 0.005


def test_a_map_to_one_point_has_numbers() -> None:
    y = directions("latlong", 12).astype(float)
    found = chart([y], [np.broadcast_to([0.0, 0.6, 0.8], y.shape)], [np.ones(y.shape[:2], bool)])
    assert np.isfinite(found).all()


def test_gaps_are_not_surface() -> None:
    """Two plates one behind the other: no triangle spans them."""
    y = np.stack(np.meshgrid(np.linspace(-1, 1, 32), np.linspace(-1, 1, 32)), axis=-1)
    y = np.concatenate([y, np.where(y[..., :1] > 0, 0.0, 50.0)], axis=-1)
    u = np.stack([y[..., 0], y[..., 1], np.ones((32, 32))], axis=-1) * 1e-3 + [0, 0, 1]
    found = chart([y], [u / np.linalg.norm(u, axis=-1, keepdims=True)], [np.ones((32, 32), bool)])
    assert found.distortion < 0.01


def test_nothing_seen_is_said() -> None:
    y = np.zeros((4, 4, 3))
    with pytest.raises(ValueError, match="no view"):
        chart([y], [y], [np.zeros((4, 4), bool)])
