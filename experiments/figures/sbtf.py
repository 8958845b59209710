"""Neural materials on curved surfaces, figures 1, 8 and 9: python -m experiments.figures.sbtf WEAVE.npz [--neumip NEUMIP.npz]

A torus of woven yarns, as geometry and with a surface material on its mesh. WEAVE.npz is of `mesoshell distill weave`,
NEUMIP.npz of experiments/weave_neumip.py: it knows neither curvature nor opacity, as NeuMIP does not.

1   Without these, the silhouette is the mesh's own.
8   Asked with the mean curvature instead of the one along the ray, it is too wide where the two differ.
9   Curvature is one over a length: where the texture is scaled, to a period of 0.3, so must curvature be.
"""

import argparse
import tempfile
from pathlib import Path

import numpy as np
from jaxtyping import Float

import mesoshell as ms
from benchmarks.silhouettes import of_geometry, over, torus
from experiments.figures.sheet import draw
from mesoshell.datasets.queries.sources import source
from mesoshell.geometry.mesh import load_mesh, uv_stretch
from mesoshell.io.image import linear_to_srgb
from mesoshell.scene.setup import describe_surface

SIDE, CAMERA, PATHS, RAYS = 320, (0.0, 0.9, 2.6, 0.55, 0.05, 0.3, 30.0), 256, 36


def scene(mesh: Path, bundle: str, period: float) -> ms.Scene:
    """The torus with a surface material. period: in texture units."""
    scale = period * uv_stretch(load_mesh(mesh))
    return ms.Scene(mesh, ms.load_material(bundle), scale=scale, irradiance=4.0, camera=CAMERA, size=(SIDE, SIDE))


def geometry(made: ms.Scene) -> Float[np.ndarray, "H W 3"]:
    """The yarns themselves, path-traced."""
    d = describe_surface(made)
    one, two, *_ = of_geometry(source("weave"), d.mesh, d, PATHS // 2)
    return shown((one + two) / 2)


def material(made: ms.Scene, curvature: str = "curve") -> Float[np.ndarray, "H W 3"]:
    """The surface material, asked with a curvature."""
    return shown(ms.render(made, pixel_samples=RAYS, curvature_filter=curvature).rgba)


def shown(image: np.ndarray) -> Float[np.ndarray, "H W 3"]:
    """Over a blue backdrop, sRGB."""
    return linear_to_srgb(np.clip(over(image), 0, 1))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("weave")
    parser.add_argument("--neumip", default=None)
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        mesh = torus(Path(folder) / "torus.obj")
        wide, narrow = (scene(mesh, asked.weave, period) for period in (0.6, 0.3))
        true, ours = geometry(wide), material(wide)
        if asked.neumip is not None:
            without = material(scene(mesh, asked.neumip, 0.6))
            draw("sbtf_1", [[true, ours, without]], ("geometry", "ours", "no curvature, no opacity"), wide=3.4)
        draw(
            "sbtf_8", [[true, ours, material(wide, "mean")]], ("geometry", "along the ray", "mean curvature"), wide=3.4
        )
        pictures = [geometry(narrow), material(narrow), material(narrow, "unscaled")]
        draw("sbtf_9", [pictures], ("geometry", "scaled curvature", "not scaled"), wide=3.4)


if __name__ == "__main__":
    main()
