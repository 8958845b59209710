"""Cameras of posed photographs, from three formats of captures (NumPy, SciPy).

Notation
M           camera to world, 4 × 4, rigid; the camera looks along −z, y up in the image (OpenGL)
lens        (fx, fy, cx, cy), pixels; (0, 0) is the image's upper left corner, pixel centres at + 0.5
P           world to image, of a camera that looks along +z with y down (OpenCV): P = K [R | t]

Each keeps its own frame and units. Lenses with distortion are refused: undistort first.
"""

import os
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from mesoshell.errors import InputError
from mesoshell.io.records import read_object

#: From an OpenCV camera's axes to an OpenGL camera's.
FLIP = np.diag([1.0, -1.0, -1.0, 1.0])
DISTORTION = ("k1", "k2", "k3", "k4", "p1", "p2")
IMAGES = (".png", ".jpg", ".jpeg", ".exr")


@dataclass(frozen=True)
class Posed:
    """A photograph that has not been read yet. size: (width, height) that the lens refers to, if known; mask: its mask file, if
    it has one."""

    image: Path
    to_world: Float[np.ndarray, "4 4"]
    lens: tuple[float, float, float, float] | None
    size: tuple[int, int] | None
    mask: Path | None
    #: Full horizontal angle of view, radians, if nothing else is known of the lens.
    angle: float | None = None


@dataclass(frozen=True)
class Poses:
    """source: the file that they were read from. box: centre and half side of the box that the object lies in; flash: E⊥ per
    channel at distance 1 of a light at the camera; None if not given."""

    source: Path
    views: tuple[Posed, ...]
    points: Float[np.ndarray, "P 3"] | None
    box: tuple[Float[np.ndarray, "3"], float] | None = None
    flash: float | None = None


def read_poses(folder: Path) -> Poses:
    """Read a capture's folder: the first of transforms.json, cameras.npz and a COLMAP model that exists. Raises InputError that
    names the file and the fault."""
    if not folder.is_dir():
        raise InputError(folder, "no such folder")
    ways: tuple[tuple[Path, Callable[[Path], Poses]], ...] = (
        (folder / "transforms.json", read_transforms),
        (folder / "cameras.npz", read_idr),
        *((model, read_colmap) for model in (folder / "sparse/0", folder / "sparse", folder) if _is_model(model)),
    )
    for path, read in ways:
        if path.exists():
            return read(path)
    if (folder / "transforms_train.json").exists():
        raise InputError(
            folder / "transforms_train.json", "is only part of a capture: copy it to transforms.json to use it"
        )
    raise InputError(folder, "no capture: it has no transforms.json, no cameras.npz and no COLMAP model (sparse/0)")


def read_transforms(path: Path) -> Poses:
    """Read transforms.json of nerfstudio or Blender, and the points of its `ply_file_path`."""
    fields = read_object(path)
    frames = fields.get("frames")
    if not isinstance(frames, list) or not frames:
        raise InputError(path, "has no frames")
    views = []
    for i, frame in enumerate(frames):
        if not isinstance(frame, dict) or not isinstance(frame.get("file_path"), str):
            raise InputError(path, f"frame {i} has no file_path")
        own = {**fields, **frame}
        bent = [k for k in DISTORTION if own.get(k)]
        if bent:
            raise InputError(path, f"frame {i} is distorted ({bent[0]} is {own[bent[0]]}): undistort the images first")
        if "FISHEYE" in str(own.get("camera_model")).upper():
            raise InputError(path, f"frame {i} has a {own['camera_model']} camera: undistort the images first")
        try:
            size = (int(own["w"]), int(own["h"])) if "w" in own and "h" in own else None
            lens, angle = _lens(own, size)
        except (KeyError, TypeError, ValueError, OverflowError):
            raise InputError(path, f"frame {i} has no lens: it needs fl_x with w and h, or camera_angle_x") from None
        image = _image(path.parent / frame["file_path"])
        mask = path.parent / frame["mask_path"] if isinstance(frame.get("mask_path"), str) else None
        matrix = _rigid(path, f"transform_matrix of frame {i}", frame.get("transform_matrix"))
        views.append(Posed(image, matrix, lens, size, mask, angle))
    cloud = fields.get("ply_file_path")
    flash = fields.get("flash")
    if flash is not None and not (type(flash) in (int, float) and 0 < flash < 1e300):
        raise InputError(path, f"flash must be a number above 0, not {flash!r}")
    points = _cloud(path.parent / cloud) if isinstance(cloud, str) else None
    return Poses(path, tuple(views), points, flash=None if flash is None else float(flash))


def read_idr(path: Path) -> Poses:
    """DTU in IDR's format: cameras.npz with world_mat_i (P) and scale_mat_i (unit sphere to world), beside image/ and mask/;
    points from points.ply, if it exists."""
    from scipy.linalg import rq

    try:
        with np.load(path, allow_pickle=False) as file:
            # the file also holds their inverses and other derived matrices
            names = [k for k in file.files if re.fullmatch(r"(world|scale)_mat_\d+", k)]
            if any(file.zip.getinfo(f"{k}.npy").file_size > 4096 for k in names):
                raise InputError(path, "holds a camera that is not a 4 x 4 matrix")
            arrays = {k: np.asarray(file[k], np.float64) for k in names}
    except InputError:
        raise
    except Exception as error:  # zipfile and NumPy raise a dozen types
        raise InputError(path, "not an npz file of cameras, or a damaged one") from error
    images, masks = (_files(path.parent / name) for name in ("image", "mask"))
    if not images:
        raise InputError(path.parent / "image", "has no images")
    cameras = sum(name.startswith("world_mat_") for name in arrays)
    if cameras != len(images):
        raise InputError(path, f"has {cameras} cameras for {len(images)} images")
    if masks and len(masks) != len(images):
        raise InputError(path.parent / "mask", f"has {len(masks)} masks for {len(images)} images")
    views = []
    for i, image in enumerate(images):
        p = arrays.get(f"world_mat_{i}")
        if p is None or p.shape not in ((3, 4), (4, 4)) or not np.isfinite(p).all():
            raise InputError(path, f"has no camera for {image.name}: world_mat_{i} is missing, or not a 4 x 4 matrix")
        if abs(np.linalg.det(p[:3, :3])) < 1e-12:
            raise InputError(path, f"world_mat_{i} is not a camera: its first three columns are dependent")
        k, r = rq(p[:3, :3])
        signs = np.sign(np.diag(k))
        k, r = k * signs, signs[:, None] * r
        t = np.linalg.solve(k, p[:3, 3])
        if np.linalg.det(r) < 0:  # P is known up to its sign
            r, t = -r, -t
        k /= k[2, 2]
        if abs(k[0, 1]) > 1e-3 * k[0, 0]:
            raise InputError(path, f"world_mat_{i} has skewed pixels")
        inverse = np.eye(4)
        inverse[:3, :3], inverse[:3, 3] = r.T, -r.T @ t
        # their pixel centres lie at whole numbers
        lens = (float(k[0, 0]), float(k[1, 1]), float(k[0, 2]) + 0.5, float(k[1, 2]) + 0.5)
        views.append(Posed(image, inverse @ FLIP, lens, None, masks[i] if masks else None))
    box = None
    if "scale_mat_0" in arrays:
        s = arrays["scale_mat_0"]
        if s.shape != (4, 4) or not np.isfinite(s).all() or not s[0, 0] > 0:
            raise InputError(path, "scale_mat_0 is not a scale and a shift")
        if np.abs(s[:3, :3] / s[0, 0] - np.eye(3)).max() > 1e-4:
            raise InputError(path, "scale_mat_0 must be one scale for all axes and a shift, without rotation")
        box = s[:3, 3].copy(), float(s[0, 0])
    points = path.parent / "points.ply"
    return Poses(path, tuple(views), _cloud(points) if points.exists() else None, box)


def read_colmap(path: Path) -> Poses:
    """Read a COLMAP model beside images/ and perhaps masks/ (NAME.png of each image). Raises InputError without pycolmap."""
    try:
        import pycolmap
    except ImportError:
        raise InputError(path, "a COLMAP model needs pycolmap: pip install mesoshell[capture]") from None
    try:
        model = pycolmap.Reconstruction(str(path))
    except Exception as error:
        raise InputError(path, "not a COLMAP model, or a damaged one") from error
    root = next((p for p in (path, *path.parents[:2]) if (p / "images").is_dir()), None)
    if root is None:
        raise InputError(path, "has no images/ beside it")
    views = []
    for image in sorted(model.images.values(), key=lambda image: image.name):
        camera = model.cameras[image.camera_id]
        kind = camera.model.name
        if kind not in ("PINHOLE", "SIMPLE_PINHOLE"):
            raise InputError(path, f"{image.name} has a {kind} camera: run `colmap image_undistorter` first")
        pose: Any = image.cam_from_world() if callable(image.cam_from_world) else image.cam_from_world
        world = np.eye(4)
        world[:3] = np.asarray(pose.inverse().matrix(), np.float64)
        lens = (camera.focal_length_x, camera.focal_length_y, camera.principal_point_x, camera.principal_point_y)
        masks = [root / "masks" / f"{image.name}.png", (root / "masks" / image.name).with_suffix(".png")]
        mask = next((p for p in masks if p.exists()), None)
        size = int(camera.width), int(camera.height)
        views.append(Posed(root / "images" / image.name, world @ FLIP, tuple(map(float, lens)), size, mask))  # type: ignore[arg-type]
    points = np.array([p.xyz for p in model.points3D.values()], np.float64).reshape(-1, 3)
    return Poses(path, tuple(views), points if len(points) else None)


def _is_model(folder: Path) -> bool:
    return any((folder / f"cameras{suffix}").exists() for suffix in (".bin", ".txt"))


def _lens(
    own: dict[str, Any], size: tuple[int, int] | None
) -> tuple[tuple[float, float, float, float] | None, float | None]:
    """The lens of a frame; or only its angle of view, if the rest needs the image's size."""
    if "fl_x" in own and size:
        fx = float(own["fl_x"])
        lens = fx, float(own.get("fl_y", fx)), float(own.get("cx", size[0] / 2)), float(own.get("cy", size[1] / 2))
        if not (np.isfinite(lens).all() and lens[0] > 0 and lens[1] > 0):
            raise ValueError
        return lens, None
    angle = float(own["camera_angle_x"])
    if not 0 < angle < np.pi:
        raise ValueError
    return None, angle


def _rigid(path: Path, name: str, rows: Any) -> Float[np.ndarray, "4 4"]:
    try:
        m = np.array(rows, np.float64)
    except (TypeError, ValueError):
        m = np.zeros(0)
    if m.shape == (3, 4):
        m = np.vstack([m, [0, 0, 0, 1]])
    if m.shape != (4, 4) or not np.isfinite(m).all():
        raise InputError(path, f"{name} is not a 4 x 4 matrix")
    turned = m[:3, :3]
    if np.abs(turned @ turned.T - np.eye(3)).max() > 1e-3 or np.linalg.det(turned) < 0:
        raise InputError(path, f"{name} is not a rotation and a shift: its axes are not orthonormal and right-handed")
    return m


def _image(path: Path) -> Path:
    """The file, with the first suffix of an existing image if it has none: Blender's frames leave it out."""
    if path.suffix.lower() in IMAGES:
        return path
    return next((p for p in (path.with_name(path.name + s) for s in IMAGES) if os.path.exists(p)), path)


def _files(folder: Path) -> list[Path]:
    return sorted(p for p in folder.glob("*") if p.suffix.lower() in IMAGES)


def _cloud(path: Path) -> Float[np.ndarray, "P 3"]:
    import trimesh

    if not os.path.exists(path):
        raise InputError(path, "no such file")
    try:
        points = np.asarray(trimesh.load(path).vertices, np.float64)  # type: ignore[union-attr]
    except Exception as error:  # trimesh raises many types
        raise InputError(path, "not a point cloud, or a damaged one") from error
    points = points[np.isfinite(points).all(axis=1)]
    if not len(points):
        raise InputError(path, "has no points")
    return points
