"""The generator against the machine's matrix rate: python -m benchmarks.generator [forward] [tiles] [step]

forward   a patch at batch 1 in float32: as we use it (no padding, a halo about the patch), and with the zero padding and
          sizes of the published schedule, which tests and other implementations compute
tiles     texels a second of tiles of 1, 2 and 4 patches, and of one whole of 8 × 8
step      a step of the preset `small` by part; memory of its compiled program, with and without mip-mapping

The floor is the operations of the generator's convolutions over the matrix rate, which is probed first and last: other work
on the machine shows as a difference. Seconds are the least of a few; cores: processor seconds over seconds.
"""

import argparse
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp

from benchmarks.rates import matrix_rate
from mesoshell.shell.generator.discriminator import discriminate
from mesoshell.shell.generator.generator import (
    Averages,
    Generator,
    draw_phases,
    init_averages,
    init_generator,
    synthesise,
)
from mesoshell.shell.generator.plan import CELL, GeneratorConfig, frequencies_of, halo_cost, rows_of, spans
from mesoshell.signal.filtered_lrelu import Activation, filtered_lrelu
from mesoshell.signal.fourier import fourier_map
from mesoshell.signal.modulated import modulated_conv
from mesoshell.train.gan.generate import ImageBatch, generate, label
from mesoshell.train.gan.presets import SMALL
from mesoshell.train.gan.state import GanConfig, sized_for, start
from mesoshell.train.gan.step import seen, step
from mesoshell.train.losses import r1
from mesoshell.train.parallel import in_turn
from mesoshell.train.update import Across
from mesoshell.typing import Array

T64 = GeneratorConfig(texels=64, channel_base=4096, channel_max=64)
CASES = {
    "T 256, 16384/256": GeneratorConfig(texels=256, channel_base=16384, channel_max=256),
    "T 128, 8192/128": GeneratorConfig(texels=128, channel_base=8192, channel_max=128),
    "T 64, 4096/64": T64,
    "R 64, 1024/32": GeneratorConfig(texels=64, config="R", channel_base=1024, channel_max=32),
}
REPEATS = 5


def timed(call: Callable, *arguments) -> tuple[float, float]:
    """Least seconds of a few calls after one, and the processor seconds of that call over them."""
    jax.block_until_ready(call(*arguments))
    found = []
    for _ in range(REPEATS):
        begin, used = time.perf_counter(), time.process_time()
        jax.block_until_ready(call(*arguments))
        found.append((time.perf_counter() - begin, time.process_time() - used))
    seconds, used = min(found)
    return seconds, used / seconds


def made(config: GeneratorConfig) -> tuple:
    """Arguments of `valid` and `padded`."""
    k = jax.random.split(jax.random.key(0), 3)
    w = jax.random.normal(k[1], (1, config.w), jnp.float32)
    return init_generator(config, k[0]), init_averages(config), w, draw_phases(config, k[2], 1)


def valid(config: GeneratorConfig, side: int, generator: Generator, averages: Averages, w: Array, phases) -> Array:
    return synthesise(config, generator, averages, w, phases, jnp.zeros(2, jnp.int32), (side, side)).feature


def padded(config: GeneratorConfig, generator: Generator, averages: Averages, w: Array, phases) -> Array:
    """The same layers with the schedule's sizes and zero padding, and no maps but the input's."""
    rows = rows_of(config)
    size, channels = rows[0].in_size[0], rows[0].in_channels
    start = jnp.zeros(2, jnp.int32)
    f = frequencies_of(config)
    phase, waves = phases.input[..., :channels], (jnp.asarray(f.input[:channels]), jnp.asarray(f.slow))
    x = fourier_map(*waves, phase, start, (size, size), CELL, 1, config.drift) @ generator.mix
    for row, layer, magnitude in zip(rows, generator.layers, averages.magnitude, strict=True):
        style = w @ layer.affine.kernel / w.shape[1] ** 0.5 + layer.affine.bias
        gain = jax.lax.rsqrt(magnitude)
        y = modulated_conv(x, layer.weight, style, gain, not row.is_torgb, row.conv_kernel - 1)
        left, right, top, bottom = row.padding
        x = filtered_lrelu(y + layer.bias, Activation(row, (left, right, top, bottom)))
    return x


def convolutions(config: GeneratorConfig, side: int | None) -> float:
    """Operations: of a patch or tile of `side` texels, or with padding."""
    rows = rows_of(config)
    work = [2 * row.conv_kernel**2 * row.in_channels * row.out_channels for row in rows]
    if side is None:
        sizes = [row.in_size[0] + row.conv_kernel - 1 for row in rows]
    else:
        sizes = [s.size - row.conv_kernel + 1 for row, s in zip(rows, spans(rows, side), strict=True)]
    return float(sum(a * n**2 for a, n in zip(work, sizes, strict=True)))


def forward() -> None:
    rate = matrix_rate(precision="highest")
    print(f"matrix product: {rate / 1e9:.0f} GFLOP/s\n")
    print("| generator | mode | GFLOP | floor, s | seconds | time / floor | cores |\n|---|---|---|---|---|---|---|")

    def row(name: str, mode: str, operations: float, call: Callable, arguments: tuple) -> None:
        seconds, cores = timed(jax.jit(call), *arguments)
        floor = operations / rate
        numbers = f"{operations / 1e9:.1f} | {floor:.3f} | {seconds:.3f} | {seconds / floor:.1f} | {cores:.1f}"
        print(f"| {name} | {mode} | {numbers} |", flush=True)

    for name, config in CASES.items():
        arguments, side = made(config), config.texels
        modes = {"padded": (partial(padded, config), None), "halo": (partial(valid, config, side), side)}
        for mode, (call, size) in modes.items():
            operations = convolutions(config, size)
            row(name, mode, operations, call, arguments)
            if config is T64:
                loss = lambda *a, call=call: jnp.sum(call(*a) ** 2)  # noqa: E731
                row(f"{name}, and backward", mode, 3 * operations, jax.grad(loss), arguments)
    print(f"\nmatrix product again: {matrix_rate(precision='highest') / 1e9:.0f} GFLOP/s\n")


def tiles() -> None:
    arguments, whole = made(T64), 8
    print("| patches a tile | time of all, s | texels a second | halo's cost, counted |\n|---|---|---|---|")
    for patches in (1, 2, 4, whole):
        side = patches * T64.texels

        def one(tile: Array, side: int = side) -> Array:
            generator, averages, w, phases = arguments
            return synthesise(T64, generator, averages, w, phases, tile, (side, side)).feature

        compiled = jax.jit(one)
        places = [jnp.array([v, u]) * CELL for v in range(0, whole, patches) for u in range(0, whole, patches)]
        some = places[: max(1, 4 // patches)]
        seconds = timed(lambda some=some, compiled=compiled: [compiled(p) for p in some])[0] / len(some) * len(places)
        rate = (whole * T64.texels) ** 2 / seconds
        print(f"| {patches} × {patches} | {seconds:.2f} | {rate:,.0f} | {halo_cost(T64, side):.2f} |", flush=True)
    print()


def batch_of(config: GanConfig) -> ImageBatch:
    """Random renders from straight above, of one appearance."""
    k, n = jax.random.split(jax.random.key(1), 3), config.batch
    above = jnp.eye(4).at[:3, 3].set(jnp.array([0.5, 0.5, 4.0]))
    every = lambda x: jnp.broadcast_to(x, (n, *x.shape))  # noqa: E731
    image = jax.random.uniform(k[0], (n, config.picture.size, config.picture.size, 4))
    light, parameters = jnp.array([0.6, 0.0, 0.8]), jax.random.uniform(k[1], (n, config.appearance))
    keys = jax.random.key_data(jax.random.split(k[2], n))
    return ImageBatch(image, parameters, jnp.zeros((n, 0)), every(above), every(light), every(jnp.full(3, 5.0)), keys)


def training() -> None:
    config = sized_for(SMALL, appearance=1, geometry=0)
    state, batch = start(config, jax.random.key(0)), batch_of(config)
    each = in_turn if jax.default_backend() == "cpu" else jax.vmap
    textures, size = config.batch // config.views, config.generator.texels
    k = jax.random.split(jax.random.key(2), 2)
    w = jax.random.normal(k[0], (textures, config.generator.w), jnp.float32)
    phases = draw_phases(config.generator, k[1], textures)
    c, y = label(batch), seen(config, batch.image)

    def features(generator: Generator) -> Array:
        return jnp.sum(valid(config.generator, size, generator, state.averages, w, phases) ** 2)

    def pictures(learner) -> Array:
        return jnp.sum(generate(config, learner, state.averages, batch, each)[0] ** 2)

    def logits(judge) -> Array:
        return jnp.sum(discriminate(judge, y, c)) ** 2

    def penalty(judge) -> Array:
        return r1(lambda y: discriminate(judge, y, c), y, config.gamma)

    def due(at: int) -> float:
        now = state._replace(step=jnp.asarray(at, jnp.int32))
        return timed(jax.jit(lambda s, b: step(config, s, b, Across(each=each))), now, batch)[0]

    parts = {"generator": timed(jax.jit(jax.grad(features)), state.learner.generator)[0]}
    parts["render"] = timed(jax.jit(jax.grad(pictures)), state.learner)[0] - parts["generator"]
    parts["discriminator, a batch"] = timed(jax.jit(jax.grad(logits)), state.discriminator)[0]
    parts["R1, every 16th step"] = timed(jax.jit(jax.grad(penalty)), state.discriminator)[0]
    parts["a step"] = (15 * due(1) + due(0)) / 16
    operations = 3 * textures * convolutions(config.generator, size)
    print("| part of a step, forward and backward | seconds |\n|---|---|")
    for name, seconds in parts.items():
        print(f"| {name} | {seconds:.2f} |")
    share = operations / parts["a step"] / matrix_rate(precision="highest")
    print(
        f"\n{config.batch / parts['a step']:.2f} images a second; the generator's convolutions alone are {share:.2f} of"
    )
    print("what the matrix rate could do in a step.\n")
    memory(config, state, batch, each)


def memory(config: GanConfig, state, batch: ImageBatch, each: Callable) -> None:
    print("| a step | temporary memory, MiB | with arguments and results |\n|---|---|---|")
    for name, filtering in (("mip-mapping", True), ("without", False)):
        other = replace(config, picture=replace(config.picture, filtering=filtering))
        one = lambda s, b, c=other: step(c, s, b, Across(each=each))  # noqa: E731
        compiled = jax.jit(one, donate_argnums=0).lower(state, batch).compile()
        found = compiled.memory_analysis()
        assert found is not None, "the backend tells"
        rest = found.argument_size_in_bytes + found.output_size_in_bytes
        held = found.temp_size_in_bytes
        print(f"| {name} | {held / 2**20:.0f} | {(held + rest) / 2**20:.0f} |", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    known = {"forward": forward, "tiles": tiles, "step": training}
    parser.add_argument("what", nargs="*", choices=[[], *known], help="which tables; all if none is named")
    for name in parser.parse_args().what or known:
        known[name]()


if __name__ == "__main__":
    main()
