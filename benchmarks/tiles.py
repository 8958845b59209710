"""What corner tiles cost a render: a patch, and the same patch as all sixteen tiles, which is the same picture.

    python -m benchmarks.tiles [MATERIAL]

Both are rendered in turn, the first time to compile; then the least of three. The ratio is that of the lookup: samples,
decoding and light are the same.
"""

import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

import mesoshell as ms
from data_gen.tiles import COLOURS
from mesoshell.geometry.mesh import check_mesh
from mesoshell.io.bundle import Bundle, read_bundle, write_bundle
from mesoshell.io.corner_tiles import SIDE
from mesoshell.io.material import find

SIZE, TURNS = (320, 180), 3


def main() -> None:
    corners = np.array([[0, 0, 0], [12, 0, 0], [12, 0, -12], [0, 0, -12]], np.float64)
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    field = check_mesh(corners, faces, (corners[:, [0, 2]] * [1, -1] / 12)[faces], "field")
    one = read_bundle(find(sys.argv[1] if len(sys.argv) > 1 else "grass"))
    with tempfile.TemporaryDirectory() as folder:
        paths = {"one patch": Path(folder) / "one.npz", "sixteen tiles": Path(folder) / "tiles.npz"}
        for path, bundle in zip(paths.values(), (one, as_tiles(one)), strict=True):
            write_bundle(path, bundle)
        view = {"size": SIZE, "camera": (6, 5.5, 3.5, 6, 0.2, -4.5, 42), "thickness": 1.0, "scale": 1.0}
        scenes = {name: ms.Scene(field, ms.load_material(path), **view) for name, path in paths.items()}
        for engine in ("jax", "mitsuba"):
            least, pictures = dict.fromkeys(scenes, np.inf), {}
            for turn in range(1 + TURNS):
                for name, scene in scenes.items():
                    picture = ms.render(scene, "draft", engine=engine)
                    pictures[name] = picture.rgba
                    spent = picture.report["seconds"]
                    if turn:
                        least[name] = min(least[name], spent["total"] - spent["setup"])
            apart = float(np.abs(np.subtract(*pictures.values())).max())
            ratio = least["sixteen tiles"] / least["one patch"]
            print(
                f"{engine}: {', '.join(f'{k} {v:.2f} s' for k, v in least.items())}; ratio {ratio:.3f}; apart {apart:.1e}"
            )


def as_tiles(bundle: Bundle) -> Bundle:
    """A torus whose tiles are all the patch of a bundle."""
    arrays = dict(bundle.arrays)
    levels = int(bundle.texel_density).bit_length()
    for i in range(levels):
        arrays[f"features/{i}"] = np.tile(arrays[f"features/{i}"], (SIDE, SIDE, 1))
        arrays[f"grid/{i}"] = np.tile(arrays[f"grid/{i}"], (1, SIDE, SIDE))
    for i, side in enumerate((2, 1), levels):
        arrays[f"features/{i}"] = arrays[f"features/{levels - 1}"][:side, :side]
        arrays[f"grid/{i}"] = arrays[f"grid/{levels - 1}"][:, :side, :side]
    if "correction" in arrays:
        arrays["correction"] = np.concatenate([arrays["correction"], arrays["correction"][[-1, -1]]])
    return replace(bundle, arrays=arrays, tiles=COLOURS, twin=None)


if __name__ == "__main__":
    main()
