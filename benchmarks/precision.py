"""What networks lose where matrix products round their operands: python -m benchmarks.precision [--size 256]

The decoder's products with operands of TF32 and of bfloat16 (benchmarks/products), as a GPU and a TPU may have them, computed
on whatever there is; all else is float32 as it is there. Last, as this machine does it. Errors are those of a bundle's
`decoder_error` (shell/material/precision), against float64; FLIP is of one render against that in float32.
"""

import argparse
import contextlib
from collections.abc import Callable
from functools import partial
from typing import Any
from unittest import mock

import jax
import numpy as np

from benchmarks.products import BITS, rounded
from benchmarks.scenes import spot
from mesoshell.io.bundle import read_bundle
from mesoshell.io.material import find
from mesoshell.measure.flip import flip
from mesoshell.render.effects import plan_effects
from mesoshell.render.quality import PRESETS
from mesoshell.scene.render_shell import facts
from mesoshell.shell.material import decoder as net
from mesoshell.shell.material.loader import decoder_of
from mesoshell.shell.material.precision import STEP, _error, _points, decode
from mesoshell.shell.render import kernels
from mesoshell.shell.render.renderer import render
from mesoshell.shell.render.scene import Scene


def errors(bits: int | None) -> dict[str, dict[str, float]]:
    """Of the grass's opacity over a sample's length, and of ρ times it, at 8192 points."""
    bundle = read_bundle(find("grass"))
    decoder = decoder_of(bundle.arrays)
    feature, height = (bundle.arrays[k].astype(np.float32) for k in ("features/0", "height/0"))
    x, w, w_light = _points(decoder, feature, height, bundle.height_octaves)
    sigma, rho = decode(decoder, x, w, w_light, np.dtype(np.float64))

    def answered(x: jax.Array, w: jax.Array, w_light: jax.Array) -> tuple[jax.Array, jax.Array]:
        sigma, found = net.trunk(decoder, x)
        return sigma, net.head(decoder, net.toward_viewer(decoder, found, w), w_light)

    short_sigma, short_rho = map(np.asarray, jax.jit(rounded(answered, bits) if bits else answered)(x, w, w_light))
    a, short_a = (-np.expm1(-STEP * s.astype(np.float64)) for s in (sigma, short_sigma))
    return {"sigma": _error(short_a, a), "rho": _error(short_a[:, None] * short_rho, a[:, None] * rho)}


def picture(scene: Scene, bits: int | None) -> np.ndarray:
    """x / (1 + x) of a render in normal quality whose decoder has operands of so many bits, or those of this machine."""
    short: Any = {}
    if bits:
        for name in ("density", "density_at"):
            kernel = partial(_of_program, getattr(kernels, name), bits)
            short[name] = jax.jit(kernel, static_argnums=0)
        short["transport"] = jax.jit(rounded(kernels.transport, bits))
    quality = PRESETS["normal"].with_changes(light_samples=0)  # which are drawn would differ by rounding
    with contextlib.ExitStack() as patched:
        for name, kernel in short.items():
            patched.enter_context(mock.patch.object(kernels, name, kernel))
        radiance = render(scene, quality, plan_effects(facts(scene), quality))[0][..., :3]
    return radiance / (1 + radiance)


def _of_program(kernel: Callable, bits: int, program: kernels.StaticConfig, *arguments: Any) -> Any:
    return rounded(partial(kernel, program), bits)(*arguments)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--size", type=int, default=256)
    size = parser.parse_args().size
    scene = spot(size)
    exact = picture(scene, 23)
    print("| operands | σ: rms, largest | ρ: rms, largest | FLIP | largest difference |")
    print("|---|---|---|---|---|")
    for name, bits in {"float32": 23, **BITS, "this machine's": None}.items():
        found = errors(bits)
        said = " | ".join(f"{found[k]['rms']:.1g}, {found[k]['largest']:.1g}" for k in ("sigma", "rho"))
        shown = picture(scene, bits)
        print(f"| {name} | {said} | {flip(shown, exact):.2g} | {np.abs(shown - exact).max():.2g} |")


if __name__ == "__main__":
    main()
