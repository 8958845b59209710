"""Several meshes and their shells as one, for what traces rays through all of them (NumPy only; no JAX)."""

from collections.abc import Sequence

import numpy as np

from mesoshell.geometry.mesh import Mesh
from mesoshell.kept import constant, kept
from mesoshell.shell.geometry.extrude import Shell


def join_shells(grown: tuple[tuple[Mesh, Shell], ...]) -> tuple[Mesh, Shell]:
    """One mesh and one shell: vertices, faces and prisms of each follow those of the one before. Nothing is welded."""
    return grown[0] if len(grown) == 1 else _joined(grown)


@kept
def _joined(grown: tuple[tuple[Mesh, Shell], ...]) -> tuple[Mesh, Shell]:
    meshes, shells = [mesh for mesh, _ in grown], [shell for _, shell in grown]
    vertices, faces = _first([m.vertices for m in meshes]), _first([m.faces for m in meshes])
    posts, prisms = _first([s.base for s in shells]), _first([s.faces for s in shells])
    mesh = Mesh(
        vertices=np.concatenate([m.vertices for m in meshes]),
        faces=np.concatenate([m.faces + a for m, a in zip(meshes, vertices, strict=True)]),
        uv=np.concatenate([m.uv for m in meshes]),
        normals=np.concatenate([m.normals for m in meshes]),
        notes=(),
    )
    shell = Shell(
        base=np.concatenate([s.base for s in shells]),
        offset=np.concatenate([s.offset for s in shells]),
        faces=np.concatenate([s.faces + a for s, a in zip(shells, posts, strict=True)]),
        uv=np.concatenate([s.uv for s in shells]),
        neighbour=np.concatenate(
            [np.where(s.neighbour < 0, -1, s.neighbour + a) for s, a in zip(shells, prisms, strict=True)]
        ),
        neighbour_edge=np.concatenate([s.neighbour_edge for s in shells]),
        mesh_face=np.concatenate([s.mesh_face + a for s, a in zip(shells, faces, strict=True)]),
        notes=(),
    )
    return constant(mesh), constant(shell)


def _first(arrays: Sequence[np.ndarray]) -> np.ndarray:
    """Rows before each array, int32."""
    return np.cumsum([0, *(len(a) for a in arrays[:-1])], dtype=np.int32)
