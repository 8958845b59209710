"""Options of `mesoshell materials`."""

from dataclasses import dataclass

import tyro


@dataclass(frozen=True)
class Options:
    """List the materials that come with the package, with their parameters."""

    #: Materials to describe instead: names, .npz files, or folders of large textures.
    names: tyro.conf.Positional[tuple[str, ...]] = ()
