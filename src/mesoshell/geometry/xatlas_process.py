"""Unwrap FOLDER/mesh.npz by xatlas: python -m mesoshell.geometry.xatlas_process FOLDER

Writes FOLDER/uv.npz (geometry/unwrap). Imports little, since each mesh without texture coordinates starts it.
"""

import sys
from pathlib import Path

import numpy as np
import xatlas


def run_xatlas(folder: Path) -> None:
    """Read mesh.npz (vertices, faces, parts) in a folder; write uv.npz: corner UVs, (F, 3, 2), and how many charts."""
    chart, pack = xatlas.ChartOptions(), xatlas.PackOptions()
    chart.fix_winding = True
    pack.rotate_charts = False  # it rotates by exchanging u and v, which mirrors
    atlas = xatlas.Atlas()
    with np.load(folder / "mesh.npz") as mesh:
        vertices, faces, parts = mesh["vertices"], mesh["faces"], mesh["parts"]
    members = [np.flatnonzero(parts == k) for k in np.unique(parts)]
    for member in members:
        used, corner = np.unique(faces[member], return_inverse=True)
        atlas.add_mesh(vertices[used], corner.reshape(-1, 3).astype(np.uint32))
    atlas.generate(chart, pack)
    uv = np.zeros((len(faces), 3, 2), np.float32)
    size = np.array([atlas.width, atlas.height], np.float64)
    for k, member in enumerate(members):
        _, corner, placed = atlas[k]
        uv[member] = placed[corner] * (size / size.max())
    np.savez(folder / "uv.npz", uv=uv, charts=atlas.chart_count)


if __name__ == "__main__":
    run_xatlas(Path(sys.argv[1]))
