"""What a step of the GAN sends between devices: python -m benchmarks.pods [tiny mini small base paper] [--devices 8]

Bytes of the compiled program's collectives, by kind, for a step spread by `jit` and by `pmap` over devices that are cores here;
the parameters' bytes beside it, and the step's operations a device. Nothing is run, and no array is made: programs are compiled
for shapes alone. --no-pmap, --no-jit: not that one; a large preset takes minutes each. --scaling: on paper, what 8, 64 and 256
devices would make of it, from operations, bytes and the vendors' rates; nothing is compiled (docs/results/pods.md).
"""

import argparse
import json
import os
import sys
import time
from collections import defaultdict
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

#: Operations a row of the dearest step, bytes summed in each step and in one of sixteen (R1's), rows a device: as counted.
COUNTED = {"base": (4.159e11, 37_070_984, 28_605_444, 2), "paper": (2.998e12, 231_057_664, 115_690_500, 4)}
#: Of each device: operations a second in float32 as JAX's HIGHEST has it (six products of bfloat16 on a TPU), and in bfloat16;
#: bytes a second that it sends, within 8 and beyond.
DEVICES = {
    "TPU v5e": (197e12 / 6, 197e12, 200e9, 200e9),
    "TPU v5p": (459e12 / 6, 459e12, 600e9, 600e9),
    "H100, NVLink, InfiniBand": (67e12, 989e12, 450e9, 50e9),
}
#: Of its peak that a device reaches, and seconds that each of a ring's 2 (n − 1) turns takes beside its bytes.
REACHED, TURN = 0.4, 2e-6


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("presets", nargs="*", default=["tiny"])
    parser.add_argument("--devices", type=int, default=8)
    parser.add_argument("--no-jit", action="store_true")
    parser.add_argument("--no-pmap", action="store_true")
    parser.add_argument("--scaling", action="store_true")
    asked = parser.parse_args()
    if asked.scaling:
        return scaling()
    os.environ["XLA_FLAGS"] = (
        f"{os.environ.get('XLA_FLAGS', '')} --xla_force_host_platform_device_count={asked.devices}"
    )
    import jax

    # a CPU takes pictures one at a time, from its cache, for which it gathers them all; asked is what accelerators compile
    jax.lax.platform_dependent = lambda *arguments, default, **_: default(*arguments)
    for name in asked.presets:
        for how in ("jit", "pmap"):
            if not getattr(asked, f"no_{how}"):
                print(json.dumps(told(name, how, asked.devices)), flush=True)


def scaling() -> None:
    """Milliseconds of a step's products and of its sums over devices, one after the other, and the products' share of them."""
    for name, (operations, every, some, rows) in COUNTED.items():
        for device, (single, half, near, far) in DEVICES.items():
            for precision, rate in (("float32", single), ("bfloat16", half)):
                cells = []
                for n in (8, 64, 256):
                    work = rows * operations / (REACHED * rate)
                    sent = 2 * (n - 1) / n * (every + some / 16) / (near if n <= 8 else far) + 2 * (n - 1) * TURN
                    cells.append(f"{1000 * work:.3g} + {1000 * sent:.2g}: {work / (work + sent):.0%}")
                print(f"| {name}, {rows} rows | {device} | {precision} | {' | '.join(cells)} |")


def told(name: str, how: str, devices: int) -> dict[str, Any]:
    """A row: bytes and number of collectives by kind, those of R1's steps apart."""
    import jax

    from mesoshell.measure.collectives import collectives_of
    from mesoshell.measure.flops import count_operations
    from mesoshell.train.gan.presets import PRESETS
    from mesoshell.train.gan.state import sized_for, start
    from mesoshell.train.gan.step import step

    config = sized_for(PRESETS[name], 2, 2)
    config = replace(config, batch=-(-config.batch // devices) * devices)
    state = jax.eval_shape(lambda: start(config, jax.random.key(0)))
    batch = shown(config)
    begin = time.perf_counter()
    text = compiled(lambda s, b, across: step(config, s, b, across), config, how, devices, (state, batch)).as_text()
    sums: dict[str, list[int]] = defaultdict(lambda: [0, 0])
    for c in collectives_of(text or ""):
        key = f"{c.kind}{' of R1' if c.some else ''}"
        sums[key][0] += c.bytes * c.turns
        sums[key][1] += c.turns
    learned = {k: _bytes(getattr(state, k)) for k in ("learner", "discriminator")}
    work = count_operations(lambda s, b: step(config, s, b), state, batch) if how == "jit" else None
    return {
        "preset": name,
        "how": how,
        "batch": config.batch,
        "devices": devices,
        "collectives": {k: {"bytes": v[0], "count": v[1]} for k, v in sorted(sums.items())},
        "parameters": learned,
        "state": _bytes(state),
        "operations": work,
        "seconds": round(time.perf_counter() - begin),
    }


def compiled(step: Callable, config: Any, how: str, devices: int, given: tuple[Any, Any]) -> Any:
    """The program that train/parallel makes of a step, compiled for shapes."""
    import jax
    import numpy as np
    from jax.sharding import Mesh, NamedSharding
    from jax.sharding import PartitionSpec as P

    from mesoshell.train import parallel

    caught: list[Any] = []
    make = getattr(jax, how)
    setattr(jax, how, lambda *a, **k: caught.append(make(*a, **k)) or caught[-1])
    parallel.spread_step(step, config.batch, how, config.views)
    setattr(jax, how, make)
    mesh = Mesh(np.array(jax.devices()), (parallel.AXIS,))

    def shaped(x: Any, spread: bool) -> Any:
        if how == "jit":
            spec = P(parallel.AXIS) if spread else P()
            return jax.ShapeDtypeStruct(x.shape, x.dtype, sharding=NamedSharding(mesh, spec))
        shape = (devices, x.shape[0] // devices, *x.shape[1:]) if spread else (devices, *x.shape)
        return jax.ShapeDtypeStruct(shape, x.dtype)

    parts = [jax.tree.map(partial(shaped, spread=spread), x) for x, spread in zip(given, (False, True), strict=True)]
    return caught[0].lower(*parts).compile()


def shown(config: Any) -> Any:
    """Shapes of a batch."""
    import jax
    import numpy as np

    from mesoshell.train.gan.generate import ImageBatch

    b, s = config.batch, config.picture.size
    shapes = ((b, s, s, 4), (b, 2), (b, 2), (b, 4, 4), (b, 3), (b, 3), (b, 2))
    kinds = [np.float32] * 6 + [np.uint32]
    return ImageBatch(*(jax.ShapeDtypeStruct(x, k) for x, k in zip(shapes, kinds, strict=True)))


def _bytes(tree: Any) -> int:
    import jax
    import numpy as np

    return sum(int(np.prod(x.shape)) * x.dtype.itemsize for x in jax.tree.leaves(tree))


if __name__ == "__main__":
    sys.exit(main())
