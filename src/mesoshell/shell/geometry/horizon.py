"""Whether light comes from above the horizon everywhere on a shell (NumPy only; no JAX).

Notation
n           unit normal of a face, of the base and of the top: between these is the third row of J⁻¹
L           unit direction toward a distant light

Where n · L > 0 on all faces of a convex mesh, no part of the mesh lies between its shell and the light. Elsewhere one may: ρ
fades to 0 only a little below the horizon, and the mesh shadows what is behind it.
"""

import numpy as np
from jaxtyping import Float

from mesoshell.shell.geometry.extrude import Shell


def lowest(shell: Shell, toward: Float[np.ndarray, "L 3"]) -> float:
    """Least n · L over faces and lights; 1 without light."""
    foot = shell.base.astype(np.float64)
    corners = np.concatenate([foot[shell.faces], (foot + shell.offset)[shell.faces]])
    n = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size = np.linalg.norm(n, axis=1, keepdims=True)
    n = n[size[:, 0] > 0] / size[size[:, 0] > 0]
    return float((n @ toward.T).min(initial=1.0))
