"""Rows of rays for each step of a fit, and the configuration that the data ask for.

Notation
R           rays a row, all of one patch
FEW         patches that the decoder learns from at first, or as many as a step has rows for, if these are more
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from mesoshell.errors import InputError
from mesoshell.io.exemplars import read_decoder
from mesoshell.io.material import digest, find
from mesoshell.shell.material.loader import decoder_of
from mesoshell.train.fit.patch_rays import FitData, Rays, rays_at
from mesoshell.train.fit.state import FitConfig

FEW = 4


def adapt(config: FitConfig, data: FitData) -> tuple[FitConfig, FitData]:
    """The configuration adapted to the data, with the given decoder. Raises InputError if that does not fit them."""
    config = replace(config, patches=len(data.learned), appearance=data.alpha.shape[1], tiles=data.tiles)
    if config.given:
        config, data = _given(config, data)
    return config, data


def _given(config: FitConfig, data: FitData) -> tuple[FitConfig, FitData]:
    """With a material's decoder and height feature. Raises InputError if the decoder takes other inputs than the data give."""
    path = find(config.given)
    arrays, appearance = read_decoder(path)
    decoder, height = decoder_of(arrays), arrays["height/0"]
    widths = {name: tuple(len(layer.bias) for layer in getattr(decoder, name)) for name in ("trunk", "head")}
    config = replace(config, channels=height.shape[1], height_rows=len(height), given_digest=digest(path), **widths)
    inputs, there = config.channels + 1 + 2 * config.octaves + config.appearance, len(decoder.trunk[0].kernel)
    if there != inputs:
        raise InputError(config.given, f"its decoder takes {there} numbers; the data give {inputs}")
    declared = data.manifest["parameters"].items()
    theirs = [(p.name, p.range) for p in appearance]
    ours = [(name, (float(p["range"][0]), float(p["range"][1]))) for name, p in declared if p["role"] == "alpha"]
    if theirs != ours:
        raise InputError(config.given, f"its decoder takes {_listed(theirs)}; the data give {_listed(ours)}")
    return config, replace(data, given=arrays)


def _listed(parameters: list[tuple[str, tuple[float, float]]]) -> str:
    return ", ".join(f"{name} from {low:g} to {high:g}" for name, (low, high) in parameters) or "no parameter"


def feed(config: FitConfig, data: FitData, host: int = 0, hosts: int = 1) -> Callable[[int], Rays]:
    """This host's rows of step i. Raises InputError if hosts cannot share them."""
    if config.batch % hosts:
        raise InputError("batch", f"{config.batch} is no multiple of the {hosts} hosts")
    mine = range(host * config.batch // hosts, (host + 1) * config.batch // hosts)

    def at(step: int) -> Rays:
        learning = step < config.stand * config.steps and not config.given and not config.tiles
        few = max(FEW, config.at_once) if learning else config.patches
        drawn = np.random.default_rng([config.seed % 2**32, step])
        group = drawn.permutation(min(few, config.patches))[: config.at_once]
        keys = drawn.integers(0, 2**32, (config.batch, 2), np.uint32)
        rows = []
        for row in mine:
            patch = int(group[row // config.together])
            random = np.random.default_rng([config.seed % 2**32, step, row + 1])
            pixels = data.learned[patch]
            rows.append(rays_at(data, pixels[random.integers(len(pixels), size=config.rays)], patch, keys[row]))
        return Rays(*(np.stack(column) for column in zip(*rows, strict=True)))

    return at
