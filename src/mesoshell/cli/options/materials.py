"""`mesoshell materials`: what there is to grow, and what can be set of it."""

from dataclasses import dataclass

import tyro


@dataclass(frozen=True)
class Options:
    """List the materials that come with the package, with their parameters."""

    #: materials to describe instead: names, .npz files, or folders of large textures.
    names: tyro.conf.Positional[tuple[str, ...]] = ()
