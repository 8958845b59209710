"""Errors of a surface material by footprint: of answers that are wrong by a known share."""

import numpy as np

from mesoshell.measure.queries import errors_by_radius
from tests.silhouette import wearing


def test_errors_by_octave() -> None:
    """Right but for a share that falls with the footprint; a patch's are averaged, and twice as wrong in one of two is 1.5."""

    def patch(seed: int, radii: np.ndarray) -> np.ndarray:
        rows = wearing.rows(len(radii), seed, lambda q: {"alpha": 0.5, "cosine": 0.0, "rgb": 0.2})
        rows[:, 2] = radii
        return rows

    radii = np.repeat([0.01, 0.019, 0.02, 0.08], 50)
    patches = (patch(0, radii), patch(1, radii))

    def answers(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        wrong = np.where(rows[:, 2] < 0.02, 0.4, 0.1) * (1 + rows[:, -1])
        rho = rows[:, 12:15] / 0.5 * (1 + wrong)[:, None]
        return rows[:, 10], rows[:, 11], rho

    found = errors_by_radius(answers, patches)
    np.testing.assert_allclose([r for r, _ in found], [0.01, 0.02, 0.08], rtol=1e-6)
    spread = 1.96 * np.std([1, 2], ddof=1) / 2**0.5
    expected = [(1.5 + spread) * share for share in (0.4, 0.1, 0.1)]
    np.testing.assert_allclose([e for _, e in found], expected, rtol=1e-5)
    alone = errors_by_radius(answers, patches[:1])
    np.testing.assert_allclose([e for _, e in alone], [0.4, 0.1, 0.1], rtol=1e-5)
