"""Cases that need no JAX: meshes, images, bundles, datasets, queries and captures."""

import io
import json
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from mesoshell.geometry.mesh import load_mesh
from mesoshell.io.bundle import read_bundle
from mesoshell.io.dataset import read_dataset
from mesoshell.io.dataset_check import check_dataset
from mesoshell.io.dataset_images import load_images
from mesoshell.io.image import read_exr, read_heights, read_picture, read_png
from mesoshell.io.poses import read_colmap, read_idr, read_poses
from mesoshell.io.query_dataset import read_patches
from mesoshell.io.surface import read_surface
from mesoshell.io.weights import read_weights
from mesoshell.neutex.capture import read_capture
from tests.helpers.hostile import samples
from tests.helpers.hostile.damage import THINGS, damaged, variants
from tests.helpers.hostile.trial import Case

FILES: dict[str, Callable[[Path], Any]] = {
    "quad.obj": lambda p: vars(load_mesh(p)),
    "ball.glb": lambda p: vars(load_mesh(p)),
    "ball.gltf": lambda p: vars(load_mesh(p)),
    "ball.off": lambda p: vars(load_mesh(p)),
    "ball.stl": lambda p: vars(load_mesh(p)),
    "ball.ply": lambda p: vars(load_mesh(p)),
    "text.ply": lambda p: vars(load_mesh(p)),
    "ball.dae": lambda p: vars(load_mesh(p)),
    "ball.zae": lambda p: vars(load_mesh(p)),
    "ball.3mf": lambda p: vars(load_mesh(p)),
    "ball.zip": lambda p: vars(load_mesh(p)),
    "ball.usda": lambda p: vars(load_mesh(p)),
    "ball.usdc": lambda p: vars(load_mesh(p)),
    "ball.usdz": lambda p: vars(load_mesh(p)),
    "shell.npz": lambda p: read_bundle(p).arrays,
    "surface.npz": lambda p: read_surface(p).arrays,
    "sky.exr": lambda p: read_exr(p).shape,
    "float.exr": lambda p: read_heights(p).shape,
    "a.png": read_png,
    "a.jpg": read_picture,
}


def cases(good: Path) -> Iterator[Case]:
    yield from of_files(good)
    yield from of_manifests(good)
    yield from of_datasets(good)
    yield from of_queries(good)
    yield from of_captures(good)


def of_files(good: Path) -> Iterator[Case]:
    """Files of one piece: damaged bytes, and other things in their places."""
    for name, read in FILES.items():
        for seed in range(18):
            data = damaged((good / name).read_bytes(), seed)

            def run(at: Path, name=name, read=read, data=data) -> Any:
                (at / name).write_bytes(data)
                return read(at / name)

            yield Case(name, f"damaged {seed}", (name,), run)
        for thing, put in THINGS.items():

            def found(at: Path, name=name, read=read, put=put) -> Any:
                put(at / name)
                return read(at / name)

            yield Case(name, thing, (name,), found)


def of_manifests(good: Path) -> Iterator[Case]:
    """Bundles with other fields."""
    random = np.random.default_rng(3)
    kinds = (
        ("shell.npz", samples.shell_manifest(), samples.shell_arrays(random), read_bundle),
        ("surface.npz", samples.surface_manifest(), samples.surface_arrays(random), read_surface),
    )
    for name, manifest, arrays, read in kinds:
        for what, said in variants(manifest, 30):

            def run(at: Path, name=name, said=said, arrays=arrays, read=read) -> Any:
                samples.shell(at / name, said, arrays)
                return read(at / name).arrays

            yield Case(f"{name} manifest", what, (name,), run)
        for key in list(arrays)[::3]:
            for wrong in (
                np.float64(1),
                np.zeros((0, 1), np.float32),
                arrays[key].astype(np.int8),
                arrays[key] * np.nan,
            ):

                def held(at: Path, name=name, manifest=manifest, arrays=arrays, key=key, wrong=wrong, read=read) -> Any:
                    samples.shell(at / name, manifest, arrays | {key: np.asarray(wrong)})
                    return read(at / name).arrays

                yield Case(f"{name} arrays", f"{key} {np.asarray(wrong).dtype}", (name,), held)


def _all_of(folder: Path) -> Any:
    """A dataset as all verbs read it; `check` must find what `read` refuses."""
    faults = check_dataset(folder)
    images = load_images(read_dataset(folder))
    return [images, np.array([len(f) for f in faults])]


def of_datasets(good: Path) -> Iterator[Case]:
    for kind in ("plain", "packed"):
        manifest = json.loads((good / kind / "manifest.json").read_text())
        rows = (good / kind / "samples.jsonl").read_text().splitlines()
        changes = [(f"manifest {what}", "manifest.json", json.dumps(said)) for what, said in variants(manifest, 24)]
        for what, said in variants(json.loads(rows[1]), 24):
            changes.append((f"row {what}", "samples.jsonl", "\n".join([rows[0], json.dumps(said), rows[2]]) + "\n"))
        files = ("samples.jsonl", "manifest.json", "shards/0000.npy" if kind == "packed" else "images/000001.exr")
        for file in files:
            data = (good / kind / file).read_bytes()
            changes += [(f"{file} damaged {seed}", file, damaged(data, seed)) for seed in range(9)]
        for what, file, data in changes:
            yield Case(f"dataset {kind}", what, ("/d/",), _changed(good / kind, file, data, _all_of))
        for file in files:
            for thing, put in THINGS.items():
                yield Case(f"dataset {kind}", f"{file} {thing}", ("/d/",), _put(good / kind, file, put, _all_of))


def of_queries(good: Path) -> Iterator[Case]:
    read = lambda folder: len(read_patches(folder).patches)  # noqa: E731  (NaN is found when it is fed)
    for file in ("manifest.json", "samples.jsonl", "patches/000000.npy"):
        data = (good / "queries" / file).read_bytes()
        for seed in range(9):
            yield Case(
                "queries", f"{file} {seed}", ("/d",), _changed(good / "queries", file, damaged(data, seed), read)
            )
        for thing, put in THINGS.items():
            yield Case("queries", f"{file} {thing}", ("/d",), _put(good / "queries", file, put, read))
        if file.startswith("patches"):
            continue
        for what, said in variants(json.loads(data), 12):
            text = json.dumps(said) + "\n"
            yield Case("queries", f"{file} {what}", ("/d",), _changed(good / "queries", file, text, read))


def of_captures(good: Path) -> Iterator[Case]:
    def read(folder: Path) -> Any:
        found = read_capture(folder, side=6)
        return [found.rgb, found.masks, found.centre]

    of = good / "capture"
    said = json.loads((of / "transforms.json").read_text())
    for what, other in variants(said, 40):
        yield Case("transforms", what, ("/d",), _changed(of, "transforms.json", json.dumps(other), read))
    for seed in range(9):
        for file in ("transforms.json", "images/0.png"):
            data = damaged((of / file).read_bytes(), seed)
            yield Case("transforms", f"{file} {seed}", ("/d",), _changed(of, file, data, read))
    for thing, put in THINGS.items():
        yield Case("transforms", thing, ("/d",), _put(of, "transforms.json", put, read_poses))
        yield Case("transforms", f"image {thing}", ("/d",), _put(of, "images/0.png", put, read))
    for seed in range(18):
        data = damaged((good / "cameras.npz").read_bytes(), seed)
        run = _changed(of, "cameras.npz", data, lambda folder: read_idr(folder / "cameras.npz").views[0].to_world)
        yield Case("cameras.npz", f"damaged {seed}", ("/d",), run)
    for file in ("cameras.txt", "images.txt", "points3D.txt"):
        for seed in range(9):
            data = damaged((of / "sparse/0" / file).read_bytes() or b"1 2 3", seed)
            run = _changed(
                of, f"sparse/0/{file}", data, lambda d: [v.to_world for v in read_colmap(d / "sparse/0").views]
            )
            yield Case("COLMAP", f"{file} {seed}", ("/d",), run)
        for thing in ("a folder", "an empty file", "zeros", "a link to itself"):
            run = _put(of, f"sparse/0/{file}", THINGS[thing], lambda d: len(read_colmap(d / "sparse/0").views))
            yield Case("COLMAP", f"{file} {thing}", ("/d",), run)
    for seed in range(9):
        state = damaged(_state_dict(), seed)
        yield Case("weights", f"{seed}", ("w.pth",), lambda at, state=state: _weights(at / "w.pth", state))


def _state_dict() -> bytes:
    """A zip that says it is PyTorch's."""
    import pickle
    import zipfile

    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as file:
        file.writestr("archive/data.pkl", pickle.dumps({}))
        file.writestr("archive/data/0", bytes(16))
    return stream.getvalue()


def _weights(path: Path, data: bytes) -> Any:
    path.write_bytes(data)
    return read_weights(path)


def _changed(good: Path, file: str, data: bytes | str, read: Callable[[Path], Any]) -> Callable[[Path], Any]:
    """The folder with another file in a file's place."""

    def put(path: Path) -> None:
        path.write_bytes(data if isinstance(data, bytes) else data.encode(errors="surrogatepass"))

    return _put(good, file, put, read)


def _put(good: Path, file: str, put: Callable[[Path], Any], read: Callable[[Path], Any]) -> Callable[[Path], Any]:
    def run(at: Path) -> Any:
        shutil.copytree(good, at / "d")
        (at / "d" / file).unlink(missing_ok=True)
        put(at / "d" / file)
        return read(at / "d")

    return run
