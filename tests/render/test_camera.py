"""Pinhole cameras against Blender's convention: looks along −z, x to the right, y up, square pixels."""

import numpy as np
import pytest

from mesoshell.render.camera import Camera, centred, in_pixel, look_at, outward, pixel_grid, rays


def test_the_corners_of_a_camera_at_rest():
    camera = Camera(np.eye(4), np.pi / 2, 200, 100)  # tan(fov/2) = 1: the image's upper edge lies at 45°
    o, d = rays(camera, np.array([[100, 50], [100, 0], [200, 50], [0, 100]], np.float64))
    np.testing.assert_array_equal(o, np.zeros((4, 3)))
    true = np.array([[0, 0, -1], [0, 1, -1], [2, 0, -1], [-2, -1, -1]], float)
    np.testing.assert_allclose(d, true / np.linalg.norm(true, axis=1, keepdims=True), atol=1e-15)


def test_a_matrix_as_blender_writes_it():
    """Blender's default camera: location (7.35889, −6.92579, 4.95831), rotation (63.5593°, 0, 46.6919°) in XYZ order."""
    x, z = np.radians([63.5593, 46.6919])
    about_x = np.array([[1, 0, 0], [0, np.cos(x), -np.sin(x)], [0, np.sin(x), np.cos(x)]])
    about_z = np.array([[np.cos(z), -np.sin(z), 0], [np.sin(z), np.cos(z), 0], [0, 0, 1]])
    m = np.eye(4)
    m[:3, :3], m[:3, 3] = about_z @ about_x, [7.35889, -6.92579, 4.95831]
    o, d = rays(Camera(m, 0.5, 4, 4), np.array([[2.0, 2.0]]))
    np.testing.assert_allclose(d[0], [-0.6516, 0.6142, -0.4453], atol=1e-4)
    np.testing.assert_array_equal(o[0], m[:3, 3])


@pytest.mark.parametrize("up", [(0.0, 1.0, 0.0), (0.0, 0.0, 1.0)])
@pytest.mark.parametrize("eye", [(3, 4, 5), (0, 5, 0), (0, -5, 0), (0, 0, 5), (0, 0, -5), (1e-12, 5, 0)])
def test_look_at_sees_its_target_in_the_middle(eye, up):
    m = look_at(eye, (0, 0, 0), up)
    np.testing.assert_allclose(m[:3, :3].T @ m[:3, :3], np.eye(3), atol=1e-12)
    assert np.linalg.det(m[:3, :3]) > 0
    np.testing.assert_allclose(-m[:3, 2], -np.array(eye) / np.linalg.norm(eye), atol=1e-9)
    assert m[:3, 1] @ np.array(up) >= -1e-9


def test_faults_are_said():
    with pytest.raises(ValueError, match="same point"):
        look_at((1, 2, 3), (1, 2, 3))
    for fov, width, said in ((0.0, 4, "not 0.0"), (np.pi, 4, "between 0 and π"), (1.0, 0, "0 x 4 has no pixels")):
        with pytest.raises(ValueError, match=said):
            Camera(np.eye(4), fov, width, 4)
    with pytest.raises(ValueError, match="holds NaN"):
        Camera(np.full((4, 4), np.nan), 1.0, 4, 4)
    with pytest.raises(ValueError, match="axes that lie in a plane"):
        Camera(np.diag([1.0, 0.0, 1.0, 1.0]), 1.0, 4, 4)
    for up in ((0.0, 0.0, 0.0), (0.0, np.nan, 1.0), (np.inf, 0.0, 0.0)):
        with pytest.raises(ValueError, match="up: must be a direction"):
            look_at((1, 2, 3), (0, 0, 0), up)


def test_the_grid_covers_pixels_evenly():
    camera = Camera(np.eye(4), 1.0, 3, 2)
    np.testing.assert_array_equal(pixel_grid(camera, 1, 0)[:4], [[0.5, 0.5], [1.5, 0.5], [2.5, 0.5], [0.5, 1.5]])
    points = np.stack([pixel_grid(camera, 64, k)[0] for k in range(64)])
    assert (points >= 0).all() and (points < 1).all()
    cells = np.unique((points * 4).astype(int) @ [1, 4], return_counts=True)[1]
    assert len(cells) == 16 and cells.min() >= 2


@pytest.mark.parametrize("n", [1, 2, 3, 4, 7, 16, 101])
def test_samples_lie_evenly_about_the_centre_of_their_pixel(n: int):
    """Else the picture is shifted. Of a sequence that may end anywhere an odd number does, since it begins with the centre."""
    lattice = np.stack([in_pixel(centred(n, k)) for k in range(n)])
    np.testing.assert_allclose(lattice.mean(axis=0), 0.5, atol=1e-12)
    sequence = np.stack([in_pixel(outward(k)) for k in range(n)])
    if n % 2:
        np.testing.assert_allclose(np.sort(sequence, axis=0), np.sort(lattice, axis=0), atol=1e-12)


def test_lines_through_a_pixel_are_seen_as_they_cover_it():
    """Shares of nine samples on one side of them: half as wrong as of samples drawn at random."""
    fine = (np.indices((64, 64)).reshape(2, -1).T + 0.5) / 64
    angles, offsets = np.meshgrid(np.linspace(0, np.pi, 12, endpoint=False), np.linspace(-0.6, 0.6, 25))
    normals = np.stack([np.cos(angles.ravel()), np.sin(angles.ravel())])

    def wrong(points: np.ndarray) -> float:
        share, wanted = (((p - 0.5) @ normals < offsets.ravel()).mean(axis=0) for p in (points, fine))
        return float(np.sqrt(np.mean((share - wanted) ** 2)))

    ours = wrong(np.stack([in_pixel(outward(k)) for k in range(9)]))
    drawn = np.mean([wrong(np.random.default_rng(k).random((9, 2))) for k in range(20)])
    assert ours < 0.6 * drawn and ours < 0.7 * wrong(np.stack([in_pixel(float(k)) for k in range(9)]))
