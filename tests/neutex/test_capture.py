"""Captures: what is read, the box that is found, and one line for each way in which they can be wrong."""

import json
import shutil
from typing import Any

import numpy as np
import pytest
import trimesh
from PIL import Image

from mesoshell.errors import InputError
from mesoshell.io.image import linear_to_srgb, read_png, write_exr, write_png
from mesoshell.io.poses import FLIP
from mesoshell.neutex.cameras import photo_rays, rays_of
from mesoshell.neutex.capture import Capture, at_most, read_capture
from mesoshell.neutex.hull import CELLS
from tests.helpers import balls


@pytest.fixture(scope="module")
def ball(tmp_path_factory):
    return balls.write_capture(tmp_path_factory.mktemp("captures") / "ball")


@pytest.fixture(scope="module")
def capture(ball) -> Capture:
    return read_capture(ball)


@pytest.fixture
def own(ball, tmp_path):
    """A copy to spoil."""
    return shutil.copytree(ball, tmp_path / "ball")


def said(folder, **changes):
    path = folder / "transforms.json"
    about = json.loads(path.read_text())
    path.write_text(json.dumps({**about, **changes}))
    return about


def test_the_box_holds_the_object_closely(capture) -> None:
    assert len(capture.photos) == 16 and capture.agreement > 0.99 and not capture.warnings
    np.testing.assert_allclose(capture.centre, balls.CENTRE, atol=0.08)
    assert balls.AXES.max() < capture.half < 1.25 * balls.AXES.max()
    surface = capture.to_box(balls.cloud(noise=0.0))
    assert np.abs(surface).max() < 1
    cell = np.floor((surface + 1) * CELLS / 2).astype(int)
    assert capture.hull.inside[tuple(cell.T)].mean() > 0.97
    assert capture.points is not None and len(capture.points) > 480


def test_colours_are_linear_and_black_beside_the_object(ball, capture) -> None:
    image = read_png(ball / "images/003.png")
    np.testing.assert_array_equal(capture.rgb[3], image[..., :3])
    assert (capture.rgb[3][capture.masks[3] == 0] == 0).all()


def test_rays_of_counted_pixels_are_the_photographs_own(capture) -> None:
    photos = capture.photos
    pixel = np.array([0, 47, 48 * 48 - 1, 48 * 48, 5 * 48 * 48 + 100])
    o, d = rays_of(photos, pixel)
    for i, n in enumerate(pixel):
        view, rest = divmod(int(n), 48 * 48)
        wanted = photo_rays(photos[view], np.array([[rest % 48 + 0.5, rest // 48 + 0.5]]))
        np.testing.assert_allclose((o[i], d[i]), (wanted[0][0], wanted[1][0]), atol=1e-12)


def test_smaller_pictures_are_means_seen_by_the_same_camera(ball, capture) -> None:
    small = at_most(capture, 16)
    assert small.rgb[0].shape == (16, 16, 3) and small.photos[0].width == 16
    np.testing.assert_allclose(small.rgb[0][4, 5], capture.rgb[0][12:15, 15:18].mean(axis=(0, 1)), rtol=1e-6)
    corner = np.array([[0.0, 0.0]])
    np.testing.assert_allclose(
        photo_rays(small.photos[0], corner)[1], photo_rays(capture.photos[0], corner)[1], atol=1e-12
    )
    assert at_most(capture, 48).rgb[0].shape == (48, 48, 3)
    read = read_capture(ball, side=16)
    np.testing.assert_array_equal(read.rgb[0], small.rgb[0])
    np.testing.assert_allclose(read.half, capture.half, rtol=0.2)  # a pixel wider


@pytest.mark.parametrize("colour", ["black", "white"])
def test_a_background_stands_for_masks(capture, own, colour) -> None:
    truth = capture
    for i, path in enumerate(sorted((own / "images").iterdir())):
        rgba = read_png(path)
        seen = rgba[..., :3] + (colour == "white") * (1 - rgba[..., 3:])
        # an alpha that says nothing is as good as none
        write_png(path, seen if i == 0 else np.concatenate([seen, np.ones_like(seen[..., :1])], axis=-1))
    with pytest.raises(
        InputError, match=r"000.png: has neither a mask nor alpha: if its background is black or white, give `mesoshell"
    ):
        read_capture(own)
    capture = read_capture(own, colour)
    np.testing.assert_allclose(capture.half, 1.75, atol=0.2)
    assert capture.agreement > 0.97 and capture.background == colour
    sure = (truth.masks[0] == 0) | (truth.masks[0] == 1)
    np.testing.assert_array_equal(capture.masks[0][sure], truth.masks[0][sure])
    np.testing.assert_allclose(capture.rgb[0][sure], truth.rgb[0][sure], atol=0.01)


def test_masks_may_be_files(own) -> None:
    wanted = read_capture(own)
    about = said(own)
    (own / "masks").mkdir()
    for i, frame in enumerate(about["frames"]):
        rgba = read_png(own / frame["file_path"])
        write_png(own / f"masks/{i}.png", np.repeat((rgba[..., 3:] >= 0.5).astype(np.float32), 3, axis=-1))
        write_png(own / frame["file_path"], rgba[..., :3] + 0.5 * (1 - rgba[..., 3:]))
        frame["mask_path"] = f"masks/{i}.png"
    said(own, frames=about["frames"])
    capture = read_capture(own)
    np.testing.assert_allclose(capture.centre, wanted.centre, atol=0.05)
    assert (capture.rgb[0][capture.masks[0] == 0] == 0).all()


def as_arrays(folder, **more: Any) -> None:
    arrays: dict[str, Any] = {}
    for i, photo in enumerate(balls.photos()):
        fx, fy, cx, cy = photo.lens
        lens = np.array([[fx, 0, cx - 0.5], [0, fy, cy - 0.5], [0, 0, 1]])  # whole numbers are pixel centres
        arrays[f"world_mat_{i}"] = np.vstack([lens @ np.linalg.inv(photo.to_world @ FLIP)[:3], [0, 0, 0, 1]])
    np.savez(folder / "cameras.npz", **(arrays | more))


def as_idr(folder) -> None:
    as_arrays(folder)
    (folder / "mask").mkdir()
    for i, photo in enumerate(balls.photos()):
        Image.fromarray(codes(balls.picture(photo))).save(folder / f"image/{i:03d}.jpg", quality=95)
        write_png(folder / f"mask/{i:03d}.png", np.repeat(balls.picture(photo)[..., 3:], 3, axis=-1))
    trimesh.PointCloud(balls.cloud()).export(folder / "points.ply")


def as_colmap(folder) -> None:
    pytest.importorskip("pycolmap", reason="the extra `capture` is not installed")
    said = balls.photos()
    balls.write_colmap(folder, said, f"PINHOLE {' '.join(map(str, said[0].lens))}", balls.cloud(), "jpg")
    (folder / "masks").mkdir()
    for i, photo in enumerate(said):
        Image.fromarray(codes(balls.picture(photo))).save(folder / f"images/{i:03d}.jpg", quality=95)
        write_png(folder / f"masks/{i:03d}.jpg.png", np.repeat(balls.picture(photo)[..., 3:], 3, axis=-1))


def codes(rgba: np.ndarray) -> np.ndarray:
    """sRGB, before a grey wall."""
    return (linear_to_srgb(rgba[..., :3] + 0.2 * (1 - rgba[..., 3:])) * 255 + 0.5).astype(np.uint8)


@pytest.mark.parametrize(("form", "images"), [(as_idr, "image"), (as_colmap, "images")])
def test_other_forms_say_the_same(capture, tmp_path, form, images) -> None:
    """JPEG images with masks beside them, as IDR and COLMAP have them: the box, cameras, colours and points are the same."""
    (tmp_path / images).mkdir()
    form(tmp_path)
    found, wanted = read_capture(tmp_path), capture
    np.testing.assert_allclose(found.centre, wanted.centre, atol=0.05)
    assert found.half == pytest.approx(wanted.half, rel=0.05) and found.agreement > 0.99 and not found.warnings
    assert found.points is not None and len(found.points) > 480
    for a, b in zip(found.photos, wanted.photos, strict=True):
        np.testing.assert_allclose(a.to_world, b.to_world, atol=1e-6)
        np.testing.assert_allclose(a.lens, b.lens, atol=1e-6)
    for i in range(16):
        inside = wanted.masks[i] == 1
        assert np.abs(found.masks[i] - wanted.masks[i]).mean() < 0.02
        assert np.abs(found.rgb[i] - wanted.rgb[i])[inside].mean() < 0.03


def test_one_view_is_not_enough(own) -> None:
    said(own, frames=said(own)["frames"][:1])
    with pytest.raises(InputError, match=r"transforms.json: has 1 view: a shape needs at least 2$"):
        read_capture(own)


def test_few_views_are_a_guess(own) -> None:
    said(own, frames=said(own)["frames"][:4])
    assert read_capture(own).warnings == ("has only 4 views: the shape between them is a guess",)


def test_black_masks_are_named(own) -> None:
    path = own / "images/002.png"
    write_png(path, 0 * read_png(path))
    with pytest.raises(InputError, match=r"transforms.json: the mask of 002.png is empty"):
        read_capture(own)
    for path in (own / "images").iterdir():
        write_png(path, 0 * read_png(path))
    with pytest.raises(InputError, match=r"transforms.json: all masks are empty"):
        read_capture(own)


def test_what_is_lost_by_shrinking_is_said_so(own) -> None:
    path = own / "images/002.png"
    image = read_png(path)
    image[..., 3] = 0
    image[:2, :2, 3] = 1
    write_png(path, image)
    with pytest.raises(
        InputError, match=r"the mask of 002.png is empty at 4 pixels a side: no pixel shows the object$"
    ):
        read_capture(own, side=4)


def test_full_masks_tell_nothing(own) -> None:
    for path in (own / "images").iterdir():
        write_png(path, 0 * read_png(path) + 1)
    with pytest.raises(InputError, match=r"all masks are full: .*--background"):
        read_capture(own)


def test_views_of_different_things_have_no_shape(own) -> None:
    """Every camera turned round on its spot: what they see is nowhere."""
    frames = said(own)["frames"]
    for frame in frames:
        m = np.array(frame["transform_matrix"])
        m[:3, :3] = m[:3, :3] @ np.diag([-1, 1, -1])
        frame["transform_matrix"] = m.tolist()
    said(own, frames=frames)
    with pytest.raises(InputError, match=r"no point lies inside the masks of all views"):
        read_capture(own)


def test_openexr_has_linear_values(own) -> None:
    """Colours above 1, and a mask whose half is 0.5 and not the code's 0.21."""
    about = said(own)
    bright, cover = np.full((48, 48, 3), 3.0, np.float32), np.full((48, 48, 3), 0.4, np.float32)
    cover[16:32, 16:32] = 0.6
    write_exr(own / "images/000.exr", bright)
    write_exr(own / "cover.exr", cover)
    about["frames"][0] |= {"file_path": "images/000.exr", "mask_path": "cover.exr"}
    said(own, frames=about["frames"])
    found = read_capture(own)
    assert found.masks[0].sum() == 16 * 16 and (found.rgb[0][16:32, 16:32] == 3).all()


def test_a_box_that_cuts_the_object_is_warned_of(own) -> None:
    """IDR's scale_mat, of half the object's size; one that turns is refused."""
    (own / "transforms.json").unlink()
    (own / "images").rename(own / "image")
    as_arrays(own, scale_mat_0=np.array([[0.8, 0, 0, 3], [0, 0.8, 0, -1], [0, 0, 0.8, 2], [0, 0, 0, 1.0]]))
    found = read_capture(own)
    assert found.half == 0.8 and any("lies outside of the box that cameras.npz gives" in w for w in found.warnings)
    as_arrays(own, scale_mat_0=np.array([[2.0, 0, 0, 3], [0, 0, -2, -1], [0, 2, 0, 2], [0, 0, 0, 1]]))
    with pytest.raises(InputError, match=r"cameras\.npz: scale_mat_0 must be one scale for all axes"):
        read_capture(own)


def test_wrong_poses_are_warned_of(own) -> None:
    """Every second camera is a fifth of its distance beside where it was."""
    frames = said(own)["frames"]
    for frame in frames[::2]:
        m = np.array(frame["transform_matrix"])
        m[:3, 3] += 1.1 * m[:3, 0]
        frame["transform_matrix"] = m.tolist()
    said(own, frames=frames)
    assert any("masks of different views agree on" in w for w in read_capture(own).warnings)


def test_wrong_lenses_are_warned_of(own) -> None:
    """Twice the focal length: the masks agree on a smaller thing in the middle, the points do not."""
    about = said(own)
    said(own, fl_x=2 * about["fl_x"], fl_y=2 * about["fl_y"])
    assert any("of the points lie outside" in w for w in read_capture(own).warnings)


def test_pixels_that_are_not_finite_are_named(own) -> None:
    about = said(own)
    image = read_png(own / "images/000.png")
    image[3, 4, 1] = np.nan
    write_exr(own / "images/000.exr", image)
    about["frames"][0]["file_path"] = "images/000.exr"
    said(own, frames=about["frames"])
    with pytest.raises(InputError, match=r"000.exr: has pixels that are not finite"):
        read_capture(own)
