"""The parameters that a command line gives for a material."""

from pathlib import Path

import numpy as np

from mesoshell.cli.render import parse_params
from mesoshell.errors import InputError
from mesoshell.io.bundle import Bundle
from mesoshell.io.image import read_picture
from mesoshell.io.material import check_name


def given(bundle: Bundle, params: tuple[str, ...]) -> tuple[dict[str, float], dict[str, np.ndarray]]:
    """NAME=VALUE pairs: numbers, in the parameters' units, and grey images (H, W) in [0, 1]. Raises InputError for a name that
    the material does not have, or what is neither a number nor an image."""
    values, maps = {}, {}
    for name, text in parse_params(params).items():
        check_name(bundle, name)
        try:
            values[name] = float(text)
        except ValueError:
            if not Path(text).is_file():
                raise InputError("--param", f"{name}={text} is neither a number nor an image file") from None
            image = read_picture(Path(text))[..., :3].mean(axis=-1).astype(np.float32)
            if not ((image >= 0) & (image <= 1)).all():
                raise InputError("--param", f"{name}={text} holds values outside 0 to 1") from None
            maps[name] = image
    return values, maps
