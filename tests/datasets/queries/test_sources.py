"""Mesostructures: they repeat without a seam, stay under the bounding surface, and an image's heights are what they were."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from mesoshell.datasets.queries.sources import CELLS, HIGH, LOW, PROCEDURES, of_heights, source
from mesoshell.datasets.queries.tile import Tile
from mesoshell.errors import InputError
from mesoshell.io.image import write_exr

NAMES = sorted(PROCEDURES)


def on_the_torus(points: np.ndarray) -> KDTree:
    """u and v are the same a whole period on; heights are not."""
    wrapped = np.concatenate([points[:, :2] % 1.0, points[:, 2:] + 5], axis=1)
    wrapped[:, :2][wrapped[:, :2] >= 1] = 0
    return KDTree(wrapped, boxsize=[1, 1, 100])


def joined(tile: Tile) -> np.ndarray:
    """Faces, whose corners have one number where they are one place of the endless surface; none without area."""
    pairs = on_the_torus(tile.vertices).query_pairs(1e-7, output_type="ndarray")
    n = len(tile.vertices)
    _, label = connected_components(coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(n, n)))
    corner = label[tile.faces]
    distinct = (corner != np.roll(corner, 1, axis=1)).all(axis=1)
    return corner[distinct]


def uses(corner: np.ndarray) -> np.ndarray:
    """How many faces have each edge."""
    edges = np.sort(np.concatenate([corner[:, [0, 1]], corner[:, [1, 2]], corner[:, [2, 0]]]), axis=1)
    return np.unique(edges, axis=0, return_counts=True)[1]


def off(points: np.ndarray, shift: tuple[float, float]) -> float:
    """How far points of the endless surface are, at most, from those that are there when it is shifted."""
    here, there = on_the_torus(points), on_the_torus(points + np.array([*shift, 0]))
    return max(here.query(there.data)[0].max(), there.query(here.data)[0].max())


def grid_of(tile: Tile, rows: int, columns: int) -> np.ndarray:
    return tile.vertices.reshape(rows + 1, columns + 1, 3)


def smooth(rows: int, columns: int) -> np.ndarray:
    v, u = (np.arange(rows) + 0.5) / rows, (np.arange(columns) + 0.5) / columns
    return (0.5 + 0.3 * np.sin(2 * np.pi * u) + 0.2 * np.cos(2 * np.pi * v[:, None] - 1)).astype(np.float32)


def fault_of(call, *args) -> str:
    with pytest.raises(InputError) as caught:
        call(*args)
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize("depth", [None, 0.03, 1.0])
@pytest.mark.parametrize("name", NAMES)
def test_a_procedure_stays_under_the_bounding_surface(name: str, depth: float | None):
    """And above the body; it nearly fills the depth, and has colours that a surface can have."""
    tile = source(name, depth)
    assert tile.depth == (PROCEDURES[name][1] if depth is None else depth)
    low, high = tile.vertices[:, 2].min(), tile.vertices[:, 2].max()
    assert -tile.depth <= low < -0.95 * tile.depth and -0.05 * tile.depth < high <= 0
    assert tile.faces.min() >= 0 and tile.faces.max() < len(tile.vertices)
    for albedo in (tile.albedo, np.array(tile.body)):
        assert albedo.min() >= 0 and albedo.max() <= 1
    assert np.ptp(tile.albedo, axis=0).min() > 0.05


@pytest.mark.parametrize("name", NAMES)
def test_a_procedure_is_the_same_each_time(name: str):
    one, two = source(name), source(name)
    for field in ("vertices", "faces", "albedo"):
        np.testing.assert_array_equal(getattr(one, field), getattr(two, field))


@pytest.mark.parametrize("name", ["weave", "spheres"])
def test_yarns_and_spheres_have_no_edge(name: str):
    """On the endless surface each edge lies between two faces: where a copy begins, the one before it ends."""
    used = uses(joined(source(name)))
    assert (used == 2).all()


@pytest.mark.parametrize(
    ("name", "shift"),
    [
        ("weave", (0.5, 0.0)),
        ("weave", (0.25, 0.25)),
        ("scales", (0.25, 0.0)),
        ("scales", (0.125, 0.25)),
        ("spheres", (0.25, 0.0)),
        ("spheres", (0.125, 0.25)),
    ],
)
def test_a_pattern_goes_on_over_the_border_of_its_period(name: str, shift: tuple[float, float]):
    """A pattern of many alike has its own steps, and the border of a period is none of them; half of a step is none either."""
    points = source(name).vertices
    if name == "spheres":  # which are not all of one size: where they stand
        points = points.reshape(16, -1, 3)[:, 0] * [1, 1, 0]
    assert off(points, shift) < 1e-9
    assert off(points, (shift[0] / 2, shift[1] / 2)) > 0.003


def test_yarns_go_over_and_under_each_other():
    """At each crossing the higher yarn changes from the one to the other, as on a chessboard."""
    tile = source("weave")
    red = tile.albedo[:, 0] > tile.albedo[:, 2]
    wraps = tile.vertices[:, :2] % 1.0
    over = np.empty((4, 4), bool)
    for i in range(4):
        for j in range(4):
            near = np.abs(wraps - (np.array([i, j]) + 0.5) / 4).max(axis=1) < 0.04
            over[i, j] = tile.vertices[near & red, 2].max() > tile.vertices[near & ~red, 2].max()
    i, j = np.indices(over.shape)
    np.testing.assert_array_equal(over, ((i + j) % 2 == 0) == over[0, 0])


def test_spheres_are_spheres():
    tile = source("spheres")
    balls = tile.vertices.reshape(16, -1, 3)
    centre = (balls.min(axis=1) + balls.max(axis=1)) / 2
    radius = np.linalg.norm(balls - centre[:, None], axis=-1)
    np.testing.assert_allclose(radius, np.broadcast_to(radius[:, :1], radius.shape), rtol=1e-12)
    np.testing.assert_allclose(balls[..., 2].min(axis=1), -tile.depth, atol=1e-12)
    assert set(np.round(radius[:, 0], 9)) == {0.1, 0.075}


@pytest.mark.parametrize("shape", [(CELLS, CELLS), (3, 5), (1, 7), (40, CELLS)])
def test_a_height_field_has_no_edge(shape: tuple[int, int]):
    """It covers its period once, and joins its copies."""
    tile = of_heights(smooth(*shape), 0.1)
    a, b, c = (tile.vertices[tile.faces[:, i], :2] for i in range(3))
    flat = ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]) / 2
    assert (flat > 0).all() or (flat < 0).all()
    np.testing.assert_allclose(np.abs(flat).sum(), 1, rtol=1e-12)
    if min(shape) > 2:  # of one or two rows, edges fall together
        assert (uses(joined(tile)) == 2).all()


@pytest.mark.parametrize("shape", [(CELLS, CELLS), (2 * CELLS, 3 * CELLS), (7, 2 * CELLS)])
def test_heights_are_the_means_of_an_images_pixels(shape: tuple[int, int]):
    """Lowest at −D, highest at 0; u to the right, v down, a cell's middle where its texels' middle was."""
    image = smooth(*shape)
    rows, columns = (min(n, CELLS) for n in shape)
    means = image.astype(float).reshape(rows, shape[0] // rows, columns, shape[1] // columns).mean(axis=(1, 3))
    share = (means - means.min()) / np.ptp(means)
    grid = grid_of(of_heights(image, 0.2), rows, columns)
    np.testing.assert_allclose(grid[:-1, :-1, 2], 0.2 * (share - 1), atol=1e-12)
    np.testing.assert_array_equal(grid[-1, :, 2], grid[0, :, 2])
    np.testing.assert_array_equal(grid[:, -1, 2], grid[:, 0, 2])
    np.testing.assert_allclose(grid[:, 2, 1], (np.arange(rows + 1) + 0.5) / rows)
    np.testing.assert_allclose(grid[0, :, 0], (np.arange(columns + 1) + 0.5) / columns)


def test_where_cells_are_no_whole_pixels_they_share_them():
    """200 pixels in 128 cells: as if each pixel were 16 and each cell 25 of these."""
    image = np.random.default_rng(3).random((5, 200), np.float32)
    means = np.repeat(image.astype(float), 16, axis=1).reshape(5, CELLS, 25).mean(axis=-1)
    grid = grid_of(of_heights(image, 1.0), 5, CELLS)
    np.testing.assert_allclose(grid[:-1, :-1, 2], (means - means.min()) / np.ptp(means) - 1, atol=1e-10)


def test_a_ramp_rises_to_the_right_and_falls_off_at_the_border():
    tile = of_heights(np.tile(np.arange(4, dtype=np.float32), (4, 1)), 0.3)
    grid = grid_of(tile, 4, 4)
    np.testing.assert_allclose(grid[1, :, 2], [-0.3, -0.2, -0.1, 0, -0.3], atol=1e-15)
    albedo = tile.albedo.reshape(5, 5, 3)
    np.testing.assert_allclose(albedo[1, 0], LOW)
    np.testing.assert_allclose(albedo[1, 3], HIGH)
    assert (np.diff(albedo[1, :4], axis=0) > 0).all() and tile.body == LOW


def test_units_of_heights_do_not_matter():
    image = smooth(20, 30)
    plain = of_heights(image, 0.1).vertices
    np.testing.assert_allclose(of_heights(250 * image - 80, 0.1).vertices, plain, atol=1e-6)
    upside_down = of_heights(-image, 0.1).vertices
    np.testing.assert_allclose(upside_down[:, 2], -0.1 - plain[:, 2], atol=1e-9)


def test_a_rolled_image_is_a_shifted_texture():
    image = np.random.default_rng(4).random((6, 8), np.float32)
    plain, rolled = of_heights(image, 0.1), of_heights(np.roll(image, (2, 3), axis=(0, 1)), 0.1)
    distance, _ = on_the_torus(plain.vertices + np.array([3 / 8, 2 / 6, 0])).query(on_the_torus(rolled.vertices).data)
    assert distance.max() < 1e-9
    distance, _ = on_the_torus(plain.vertices).query(on_the_torus(rolled.vertices).data)
    assert distance.max() > 1e-3


def test_all_kinds_of_files_give_one_tile(tmp_path: Path):
    """8 and 16 bits and OpenEXR, to what the codes can hold; as deep as heights are if nothing is said, or as it is said."""
    image = smooth(24, 36)
    Image.fromarray(np.round(image * 255).astype(np.uint8)).save(tmp_path / "8.png")
    Image.fromarray(np.round(image * 65535).astype(np.uint16)).save(tmp_path / "16.png")
    write_exr(tmp_path / "a.exr", np.stack([image, 0 * image, 0 * image], -1), half=False)
    expected = of_heights(image, 0.12)
    # codes are off by half a step, the least and the greatest too, of heights that span Δ
    step = 0.12 / np.ptp(image)
    for name, error in (("8.png", 2 * step / 255), ("16.png", 2 * step / 65535), ("a.exr", 1e-12)):
        found = source(str(tmp_path / name))
        assert found.depth == 0.12
        np.testing.assert_allclose(found.vertices, expected.vertices, atol=error)
        np.testing.assert_array_equal(found.faces, expected.faces)
    np.testing.assert_allclose(
        source(str(tmp_path / "a.exr"), 0.3).vertices, of_heights(image, 0.3).vertices, atol=1e-12
    )


def test_what_is_no_source_is_said_in_one_line(tmp_path: Path):
    assert fault_of(source, "moss") == "moss: neither an image file nor one of weave, scales, spheres, fibres"
    assert fault_of(source, str(tmp_path)).startswith(f"{tmp_path}: neither")
    (tmp_path / "a.txt").write_text("weave\n")
    assert fault_of(source, str(tmp_path / "a.txt")) == f"{tmp_path / 'a.txt'}: not an image file, or a corrupt one"


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_heights_that_are_not_finite(value: float, tmp_path: Path):
    image = smooth(4, 4)
    image[1, 2] = value
    write_exr(tmp_path / "a.exr", np.stack([image] * 3, -1), half=False)
    assert fault_of(source, str(tmp_path / "a.exr")).startswith(f"{tmp_path / 'a.exr'}: has no heights")


def chess(size: int) -> np.ndarray:
    return (np.indices((size, size)).sum(axis=0) % 2 * 0.6 + 0.1).astype(np.float32)


@pytest.mark.parametrize("image", [np.full((4, 5), 0.3, np.float32), np.ones((1, 1), np.float32)])
def test_heights_that_are_all_the_same(image: np.ndarray):
    assert fault_of(of_heights, image, 0.1, "a.png").startswith("a.png: has no heights: one value everywhere")


@pytest.mark.parametrize("scale", [1.0, 1e-3, 1e5 / 3])
def test_a_pattern_finer_than_the_cells_leaves_nothing(scale: float):
    """The means of a chessboard are one but for rounding, which is not blown up to the whole depth."""
    fault = fault_of(of_heights, np.float32(scale) * chess(2 * CELLS), 0.1, "a.png")
    assert fault == "a.png: has no heights: its pattern is finer than 128 cells, whose means are all equal"


def test_a_chessboard_of_whole_cells_is_kept():
    grid = grid_of(of_heights(np.kron(chess(CELLS), np.ones((2, 2), np.float32)), 0.1), CELLS, CELLS)
    np.testing.assert_allclose(np.unique(np.round(grid[..., 2], 9)), [-0.1, 0])
