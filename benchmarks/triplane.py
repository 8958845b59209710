"""A surface of triplanes, each patch turned at random, against one texture: python -m benchmarks.triplane OURS.npz TRIPLANE.npz

Both bundles are snapshots of training runs (experiments/grass.py and experiments/triplane.py). The surface is a hill of
--patches × --patches square patches. Ours is one chart under one generated texture. Of triplanes every patch is a chart of its
own, turned by a quarter, two or three, with planes of its own. Compilation, and the making of features, come before the
clock starts; the latter is printed. Writes both pictures.

MesoGAN (figure 12) reports 9.78.
"""

import argparse
import time
from functools import partial
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from mesoshell.geometry.mesh import Mesh, check_mesh
from mesoshell.io.bundle import GRID_CELLS, Bundle, read_bundle
from mesoshell.io.image import write_png
from mesoshell.render.camera import Camera, look_at
from mesoshell.render.effects import plan_effects
from mesoshell.render.light import Distant
from mesoshell.render.quality import PRESETS
from mesoshell.render.tiles import RenderReport
from mesoshell.scene.render_shell import facts
from mesoshell.shell.generator.generator import synthesise
from mesoshell.shell.generator.model import GeneratorModel, generator_model, grown
from mesoshell.shell.generator.texture_synthesis import TextureRequest, grow
from mesoshell.shell.geometry.extrude import extrude
from mesoshell.shell.material.density_bounds import bounds
from mesoshell.shell.material.field import Layout, Material
from mesoshell.shell.material.loader import DeviceMaterial, Grid, load_device_material
from mesoshell.shell.material.triplane import pack_planes
from mesoshell.shell.render.renderer import render
from mesoshell.shell.render.scene import Scene
from mesoshell.texture import mip

HEIGHT, PROBES = 16, 24
THICKNESS = 0.5


def hill(patches: int, rng: np.random.Generator | None, steps: int = 4) -> Mesh:
    """A square of patches over a bell; with a generator of random numbers, each patch's chart is turned."""
    n = patches * steps + 1
    x, y = np.meshgrid(np.linspace(0, patches, n), np.linspace(0, patches, n))
    z = patches / 4 * np.exp(-(((x - patches / 2) ** 2 + (y - patches / 2) ** 2) / (patches / 3) ** 2))
    vertices = np.stack([x, y, z], axis=-1).reshape(-1, 3).astype(np.float32)
    i, j = (k.ravel() for k in np.meshgrid(np.arange(n - 1), np.arange(n - 1)))
    corner = j * n + i
    faces = np.concatenate(
        [np.stack([corner, corner + 1, corner + n + 1], 1), np.stack([corner, corner + n + 1, corner + n], 1)]
    )
    cell = np.tile(np.stack([i // steps, j // steps], axis=1), (2, 1))[:, None]
    uv = np.stack([x, y], axis=-1).reshape(-1, 2)[faces]
    if rng is not None:
        quarter = rng.integers(0, 4, (patches, patches))[cell[:, 0, 1], cell[:, 0, 0]]
        c, s = np.cos(quarter * np.pi / 2).round(), np.sin(quarter * np.pi / 2).round()
        middle = cell + 0.5
        turn = np.stack([np.stack([c, -s], -1), np.stack([s, c], -1)], -2)
        uv = np.einsum("fij,fkj->fki", turn, uv - middle) + middle
    return check_mesh(vertices, faces.astype(np.int32), uv.astype(np.float32), "hill")


def ours(bundle: Bundle, name: str, mesh: Mesh) -> DeviceMaterial:
    found, origin = grow(bundle, name, extrude(mesh, THICKNESS, 1.0).uv, TextureRequest())
    return load_device_material(found, origin)


def planes(bundle: Bundle, maker: GeneratorModel, patches: int) -> DeviceMaterial:
    """Planes of every patch, each of a seed of its own."""
    texels = maker.config.texels

    @jax.jit
    def one(seed):
        g = grown(maker, seed, np.zeros(maker.config.betas, np.float32))
        corner = jnp.zeros(2, jnp.int32)
        return synthesise(
            maker.config, maker.generator, maker.averages, g.w, g.phases, corner, (texels, texels)
        ).feature[0]

    made = np.stack([np.asarray(one(k), np.float16) for k in range(patches**2)])
    whole = made.reshape(patches, patches, texels, texels, -1).transpose(0, 2, 1, 3, 4)
    feature = jnp.asarray(whole.reshape(patches * texels, patches * texels, -1))
    sizes = tuple((texels >> i, texels >> i) for i in range(texels.bit_length()))
    layout = Layout(sizes, ((1, 1),), float(texels), maker.octaves, open=True, cells=(patches, patches))
    nothing = mip.Pyramid(jnp.zeros((1, maker.config.channels), jnp.float16))
    material = Material(pack_planes(feature, sizes), nothing, maker.decoder)
    shapes = [(HEIGHT, patches * min(GRID_CELLS, n), patches * min(GRID_CELLS, n)) for n, _ in sizes]
    corner = np.array([[0.0, 0.0], [patches, patches]])
    grids = [bounds(layout, material, i, shape, corner, PROBES) for i, shape in enumerate(shapes)]
    names = tuple(p.name for p in bundle.parameters if p.role == "alpha")
    flat = np.concatenate([g.ravel() for g in grids]).astype(np.float32)
    return DeviceMaterial(material, layout, Grid(jnp.asarray(flat)), tuple(shapes), names)


def pictured(material: DeviceMaterial, mesh: Mesh, size: int, quality: str) -> tuple[np.ndarray, RenderReport]:
    shell = extrude(mesh, THICKNESS, 1.0)
    n = float(mesh.vertices[:, :2].max())
    camera = Camera(look_at((n / 2, -0.75 * n, 0.9 * n), (n / 2, n / 2, 0.1 * n), (0.0, 0.0, 1.0)), 0.75, size, size)
    lights = (Distant(np.array([0.48, 0.36, 0.8]), np.full(3, 12.0)),)
    scene = Scene(mesh, shell, material, camera, lights, alpha=np.full(len(material.names), 0.3, np.float32))
    chosen = PRESETS[quality].with_changes(density="network")
    draw = partial(render, scene, chosen, plan_effects(facts(scene), chosen))
    draw()
    return draw()


class Compared(NamedTuple):
    """A picture of the hill: linear RGBA, seconds that its features took, the render's report, MiB of features."""

    image: Float[np.ndarray, "H W 4"]
    made: float
    report: RenderReport
    size: float


def compared(ours_path: Path, triplane_path: Path, patches: int, size: int, quality: str) -> dict[str, Compared]:
    """The hill under one texture, and under triplanes."""
    rows = {}
    for name, path in (("one texture", ours_path), ("triplanes", triplane_path)):
        begin, bundle = time.perf_counter(), read_bundle(path)
        if name == "triplanes":
            mesh = hill(patches, np.random.default_rng(0))
            material = planes(bundle, generator_model(bundle, str(path)), patches)
        else:
            mesh = hill(patches, None)
            material = ours(bundle, str(path), mesh)
        made = time.perf_counter() - begin
        image, report = pictured(material, mesh, size, quality)
        rows[name] = Compared(image, made, report, material.material.texture.rows.nbytes / 2**20)
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("ours", type=Path)
    parser.add_argument("triplane", type=Path)
    parser.add_argument("--patches", type=int, default=6)
    parser.add_argument("--size", type=int, default=384)
    parser.add_argument("--quality", default="normal")
    parser.add_argument("--out", type=Path, default=Path("out/triplane"))
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    rows = compared(options.ours, options.triplane, options.patches, options.size, options.quality)
    print(
        "| | making, s | render, s | density queries | transport queries | features, MiB |\n|---|---|---|---|---|---|"
    )
    for name, row in rows.items():
        write_png(options.out / f"{name.replace(' ', '_')}.png", row.image.astype(np.float32))
        counts = row.report.counts
        queries = f"{counts['density_queries']:,} | {counts.get('transport_queries', 0):,}"
        print(f"| {name} | {row.made:.1f} | {row.report.seconds['wall']:.2f} | {queries} | {row.size:.0f} |")
    times = [row.report.seconds["wall"] for row in rows.values()]
    print(f"\ntriplanes over one texture: {times[1] / times[0]:.2f} times the render's time")


if __name__ == "__main__":
    main()
