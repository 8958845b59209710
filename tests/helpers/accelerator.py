"""Pictures on the host's CPU, and with all but the walk on another device, as on an accelerator; a process of its own.

The second of two virtual devices stands for the accelerator. Prints one JSON object: the largest difference of the pictures,
the devices of the walk, of the chart, of the decoder and of baked density.
"""

import json
import os
import sys
from dataclasses import replace
from pathlib import Path

if __name__ == "__main__":
    os.environ["XLA_FLAGS"] = os.environ.get("XLA_FLAGS", "") + " --xla_force_host_platform_device_count=2"

import jax
import numpy as np

from mesoshell.io.bundle import read_bundle
from mesoshell.render.effects import Effect
from mesoshell.render.quality import Quality
from mesoshell.render.tiles import RenderReport
from mesoshell.shell.render.renderer import _Renderer, render
from tests.helpers import scenes

QUALITY = Quality(pixel_samples=1)
BAKED = Effect(True, "for the test")


def main() -> None:
    pictures, device = [], {}
    for name in ("cpu", "gpu"):
        jax.clear_caches()
        jax.default_backend = lambda name=name: name
        jax.config.update("jax_default_device", jax.devices()[name == "gpu"])  # of every thread
        scene = scenes.slab(read_bundle(Path(sys.argv[1])))
        plan = scenes.effects(scene, QUALITY)
        baked = replace(plan, baked_density=BAKED)
        pictures.append(np.stack([render(scene, QUALITY, effects)[0] for effects in (plan, baked)]))
        renderer = _Renderer(scene, QUALITY, baked, RenderReport())
        table = renderer.media.each[0].table
        held = {"walk": renderer.boundary.prisms, "chart": table.chart, "decoder": table.material.decoder}
        held["density"] = table.baked
        device = {name: sorted({x.device.id for x in jax.tree.leaves(tree)}) for name, tree in held.items()}
    print(json.dumps({"differ": float(np.abs(pictures[1] - pictures[0]).max()), **device}))


if __name__ == "__main__":
    main()
