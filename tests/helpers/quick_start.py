"""Textures that begin with less of their exemplars' statistics, for tests of what comes after."""

import pytest

from mesoshell.train.textures import natural_start


def begin_soon(patch: pytest.MonkeyPatch) -> None:
    """As long as the patch holds, a start looks at two textures seven times instead of at eight forty-five times."""
    for name, value in (("_TEXTURES", 2), ("_ROUNDS", 1), ("_PASSES", 1)):
        patch.setattr(natural_start, name, value)
