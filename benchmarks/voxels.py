"""What the true blades reach as a grid of densities, on the grass's images: python -m benchmarks.voxels DATASET

DATASET shows one patch (`mesoshell dataset render grass --patch 0 ...`).

The blades themselves, cut into cubes that are opaque in proportion to the leaf area inside, and seen along the test
images' rays. Blades have no thickness and their edges are sharp: this is what cubes and few samples a ray lose of them. A
comparison, no bound: a learnt field may place its density better.
"""

import argparse
from pathlib import Path

import numpy as np
import trimesh

from data_gen import grass
from mesoshell.io.dataset import read_dataset
from mesoshell.train.fit.patch_rays import Rays, box_span, gather_fit_data, rays_at

POINTS, RAYS = 8_000_000, 20_000


def leaf_area(cubes: int, patch: int) -> np.ndarray:
    """Leaf area in each cube over the area of its face, (N, N, N) in u, v, h."""
    blades = grass.grow(np.random.default_rng(patch), 1, {})
    count, size = blades.points.shape[:2]
    faces = (np.arange(count)[:, None, None] * size + blades.elements[None]).reshape(-1, 3)
    mesh = trimesh.Trimesh(blades.points.reshape(-1, 3), faces, process=False)
    points, _ = trimesh.sample.sample_surface(mesh, POINTS, seed=0)
    points = np.asarray(points)
    points[:, :2] %= 1
    grid = np.zeros((cubes,) * 3)
    np.add.at(grid, tuple(np.clip((points * cubes).astype(int), 0, cubes - 1).T), mesh.area / POINTS)
    return grid * cubes**2


def alpha_psnr(area: np.ndarray, rays: Rays, samples: int) -> float:
    """Best over one factor from area to extinction."""
    near, far = box_span(rays.origin, rays.direction)
    begin, end = (rays.origin + t[:, None] * rays.direction for t in (near, far))
    f = ((np.arange(samples) + 0.5) / samples)[None, :, None]
    points = begin[:, None] + f * (end - begin)[:, None]
    cubes = len(area)
    seen = area[tuple(np.moveaxis(np.clip((points * cubes).astype(int), 0, cubes - 1), -1, 0))].sum(axis=1)
    seen *= np.linalg.norm(end - begin, axis=1) / samples * cubes
    return max(float(-10 * np.log10(np.mean((-np.expm1(-k * seen) - rays.target[:, 3]) ** 2))) for k in (0.5, 1, 2, 4))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("dataset", type=Path)
    dataset = read_dataset(parser.parse_args().dataset)
    data = gather_fit_data([dataset])
    chosen = np.random.default_rng(0).choice(data.learned[0], RAYS)
    rays = rays_at(data, chosen, 0, np.zeros(2, np.uint32))
    print(f"a constant alpha: {-10 * np.log10(rays.target[:, 3].var()):.1f} dB\n")
    print("| cubes | samples a ray | alpha |\n|---|---|---|")
    for cubes in (64, 128, 192):
        area = leaf_area(cubes, dataset.manifest["patch"])
        for samples in (32, 96, 256):
            print(f"| {cubes}³ | {samples} | {alpha_psnr(area, rays, samples):.1f} dB |")


if __name__ == "__main__":
    main()
