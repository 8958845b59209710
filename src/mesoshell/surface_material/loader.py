"""A surface material's bundle, ready to be evaluated."""

from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp

from mesoshell.io.surface import SurfaceBundle
from mesoshell.nets.mlp import Dense
from mesoshell.surface_material.network import BlurredSurface, Module, Surface, SurfaceConfig, blur_textures


@dataclass(frozen=True, eq=False)
class DeviceMaterial:
    """curvature: the range of κ that the material was trained for."""

    config: SurfaceConfig
    table: BlurredSurface
    curvature: tuple[float, float]


def load_device_material(bundle: SurfaceBundle) -> DeviceMaterial:
    """A bundle's network, ready to be evaluated."""
    hidden = tuple(
        bundle.arrays[f"reflectance/hidden/{i}/bias"].shape[0]
        for i in range(sum(key.startswith("reflectance/hidden/") for key in bundle.arrays) // 2)
    )
    options: Any = (bundle.opacity, bundle.sees_curvature, bundle.step, bundle.offset)
    config = SurfaceConfig(bundle.texels, bundle.channels, hidden, *options)
    return DeviceMaterial(config, blur_textures(surface_of(bundle), jnp.asarray(1e-3, jnp.float32)), bundle.curvature)


def surface_of(bundle: SurfaceBundle) -> Surface:
    """The network of a bundle, its textures not blurred."""

    def module(name: str) -> Module:
        a = {key.removeprefix(name + "/"): x for key, x in bundle.arrays.items() if key.startswith(name + "/")}
        layer = lambda key: Dense(jnp.asarray(a[f"{key}/kernel"]), jnp.asarray(a[f"{key}/bias"]))  # noqa: E731
        levels = [jnp.asarray(a[f"texture/{i}"], jnp.float32) for i in range(bundle.texels.bit_length())]
        depth = sum(key.startswith("hidden/") and key.endswith("kernel") for key in a)
        return Module(levels, [layer(f"hidden/{i}") for i in range(depth)], layer("last"))

    return Surface(*(module(name) for name in Surface._fields))
