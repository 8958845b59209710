"""What checks of a scene found, as lines and as a map.

Notation
P           prisms of the scene's shells, or faces under a surface material
excess      of each of them: the worst place of edges, prisms, crossings and precision, or of hits' places, over what one may
            be off                                                                                                   (P,)
"""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Int

from mesoshell.stability.checks import Check
from mesoshell.stability.map import png_of


@dataclass(frozen=True, eq=False)
class Stability:
    """What was found; prints as a line each. picture: RGBA, as rendered; first: the prism that each pixel sees, −1 for none;
    kept: of each prism, the share of its thickness, None of a surface material; excess: as above; notes: what the user should
    know, a line each."""

    checks: tuple[Check, ...]
    picture: Float[np.ndarray, "H W 4"] = field(repr=False)
    first: Int[np.ndarray, "H W"] = field(repr=False)
    kept: Float[np.ndarray, "P"] | None = field(repr=False)
    excess: Float[np.ndarray, "P"] = field(repr=False)
    notes: tuple[str, ...] = ()

    @property
    def broken(self) -> tuple[Check, ...]:
        """The checks whose bound is broken."""
        return tuple(check for check in self.checks if check.broken)

    def map(self) -> bytes:
        """Where it is hard, as a PNG file, which a notebook displays."""
        return png_of(self.picture, self.first, self.kept, self.excess)

    def _repr_png_(self) -> bytes:
        return self.map()

    def __str__(self) -> str:
        return "\n".join(map(str, self.checks))
