"""Three ways to say the same cameras, and what is wrong with each."""

import json

import numpy as np
import pytest
import trimesh

from mesoshell.errors import InputError
from mesoshell.io.image import write_png
from mesoshell.io.poses import FLIP, read_poses
from tests.helpers import balls

PHOTOS = balls.photos(views=4, size=24)
LENS = (30.0, 28.0, 11.0, 12.5)


def matrices() -> list[np.ndarray]:
    """World to image, as OpenCV has it; pixel centres at whole numbers."""
    k = np.array([[LENS[0], 0, LENS[2] - 0.5], [0, LENS[1], LENS[3] - 0.5], [0, 0, 1]])
    return [k @ np.linalg.inv(p.to_world @ FLIP)[:3] for p in PHOTOS]


def transforms(folder, **changes):
    frames = [{"file_path": f"{i}.png", "transform_matrix": p.to_world.tolist()} for i, p in enumerate(PHOTOS)]
    about = {"fl_x": LENS[0], "fl_y": LENS[1], "cx": LENS[2], "cy": LENS[3], "w": 24, "h": 24, "frames": frames}
    (folder / "transforms.json").write_text(json.dumps({**about, **changes}))


def idr(folder, scale=1.0, **changes):
    for name in ("image", "mask"):
        (folder / name).mkdir()
        for i in range(4):
            write_png(folder / name / f"{i:03d}.png", np.ones((24, 24, 3), np.float32))
    arrays = {f"world_mat_{i}": scale * np.vstack([p, [0, 0, 0, 1]]) for i, p in enumerate(matrices())}
    # those of IDR's and NeuS's data have more beside them
    arrays |= {f"world_mat_inv_{i}": np.linalg.inv(arrays[f"world_mat_{i}"]) for i in range(4)}
    arrays |= {"camera_mat_0": np.eye(4), "scale_mat_inv_0": np.eye(4)}
    arrays["scale_mat_0"] = np.array([[2.0, 0, 0, 3], [0, 2, 0, -1], [0, 0, 2, 2], [0, 0, 0, 1]])
    np.savez(folder / "cameras.npz", **{**arrays, **changes})


def colmap(folder, camera="PINHOLE 30 28 11 12.5"):
    (folder / "images").mkdir()
    balls.write_colmap(folder, PHOTOS, camera, np.array([[1.5, 2.5, 3.5]]))


def agrees(found) -> None:
    assert len(found.views) == 4
    for view, photo in zip(found.views, PHOTOS, strict=True):
        np.testing.assert_allclose(view.to_world, photo.to_world, atol=1e-6)
        np.testing.assert_allclose(view.lens, LENS, atol=1e-6)


def test_transforms(tmp_path) -> None:
    transforms(tmp_path)
    agrees(read_poses(tmp_path))


def test_an_angle_of_view_waits_for_the_image(tmp_path) -> None:
    frames = [{"file_path": "./train/r_0", "transform_matrix": np.eye(4).tolist()}]
    (tmp_path / "transforms.json").write_text(json.dumps({"camera_angle_x": 0.69, "frames": frames}))
    (tmp_path / "train").mkdir()
    (tmp_path / "train/r_0.png").touch()
    (view,) = read_poses(tmp_path).views
    assert view.angle == 0.69 and view.lens is None and view.image == tmp_path / "train/r_0.png"


def test_a_cloud_beside_transforms(tmp_path) -> None:
    transforms(tmp_path, ply_file_path="points.ply")
    with pytest.raises(InputError, match=r"points.ply: no such file"):
        read_poses(tmp_path)
    trimesh.PointCloud(balls.cloud(50)).export(tmp_path / "points.ply")
    points = read_poses(tmp_path).points
    assert points is not None and points.shape == (50, 3)


@pytest.mark.parametrize("scale", [1.0, -0.25, 7.0])
def test_idr_up_to_any_scale(tmp_path, scale) -> None:
    idr(tmp_path, scale)
    found = read_poses(tmp_path)
    agrees(found)
    assert found.box is not None and found.box[1] == 2.0
    np.testing.assert_array_equal(found.box[0], [3, -1, 2])
    assert found.views[1].mask == tmp_path / "mask/001.png"


def test_colmap(tmp_path) -> None:
    pytest.importorskip("pycolmap", reason="the extra `capture` is not installed")
    colmap(tmp_path)
    found = read_poses(tmp_path)
    agrees(found)
    assert found.points is not None
    np.testing.assert_allclose(found.points, [[1.5, 2.5, 3.5]])


def test_colmap_with_distortion_is_refused(tmp_path) -> None:
    pytest.importorskip("pycolmap", reason="the extra `capture` is not installed")
    colmap(tmp_path, "SIMPLE_RADIAL 30 12 12 0.1")
    with pytest.raises(InputError, match=r"000.png has a SIMPLE_RADIAL camera: run `colmap image_undistorter` first"):
        read_poses(tmp_path)


@pytest.mark.parametrize(
    ("changes", "fault"),
    [
        ({"frames": []}, "has no frames"),
        ({"frames": [{}]}, "frame 0 has no file_path"),
        ({"k1": 0.1}, r"frame 0 is distorted \(k1 is 0.1\): undistort the images first"),
        ({"fl_x": -3}, "frame 0 has no lens"),
        ({"fl_x": "wide"}, "frame 0 has no lens"),
        (
            {"frames": [{"file_path": "a", "transform_matrix": [[1]]}]},
            "transform_matrix of frame 0 is not a 4 x 4 matrix",
        ),
        (
            {"frames": [{"file_path": "a", "transform_matrix": np.diag([1.0, 1, -1, 1]).tolist()}]},
            "transform_matrix of frame 0 is not a rotation and a shift",
        ),
        ({"frames": [{"file_path": "a", "transform_matrix": np.full((4, 4), np.nan).tolist()}]}, "not a 4 x 4 matrix"),
    ],
)
def test_faults_of_transforms(tmp_path, changes, fault) -> None:
    transforms(tmp_path, **changes)
    with pytest.raises(InputError, match=rf"transforms.json: .*{fault}"):
        read_poses(tmp_path)


@pytest.mark.parametrize("text", ["", "[]", "{", "3"])
def test_transforms_that_are_none(tmp_path, text) -> None:
    (tmp_path / "transforms.json").write_text(text)
    with pytest.raises(InputError, match=r"transforms.json: (not JSON|is not a JSON object)"):
        read_poses(tmp_path)


def test_faults_of_idr(tmp_path) -> None:
    idr(tmp_path, world_mat_2=np.zeros((4, 4)))
    with pytest.raises(InputError, match=r"cameras.npz: world_mat_2 is not a camera"):
        read_poses(tmp_path)
    np.savez(tmp_path / "cameras.npz", world_mat_0=np.eye(4))
    with pytest.raises(InputError, match=r"cameras.npz: has 1 cameras for 4 images"):
        read_poses(tmp_path)
    np.savez(
        tmp_path / "cameras.npz",
        world_mat_0=np.eye(4),
        world_mat_1=np.eye(4),
        world_mat_2=np.eye(4),
        world_mat_3=np.eye(4),
    )
    (tmp_path / "mask/003.png").unlink()
    with pytest.raises(InputError, match=r"mask: has 3 masks for 4 images"):
        read_poses(tmp_path)
    (tmp_path / "cameras.npz").write_bytes(b"PK no")
    with pytest.raises(InputError, match=r"cameras.npz: not an npz file of cameras"):
        read_poses(tmp_path)


def test_folders_that_are_no_capture(tmp_path) -> None:
    with pytest.raises(InputError, match=r"no capture: it has no transforms.json, no cameras.npz and no COLMAP model"):
        read_poses(tmp_path)
    with pytest.raises(InputError, match="no such folder"):
        read_poses(tmp_path / "none")
