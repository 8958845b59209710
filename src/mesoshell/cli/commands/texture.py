"""`mesoshell texture`: a texture of any extent by a material's generator. Imports JAX."""

import time
from dataclasses import replace

from mesoshell.cli.checks import pairs_of
from mesoshell.cli.compilation_cache import keep_compiled
from mesoshell.cli.options.texture import Options
from mesoshell.cli.progress import bar, stderr
from mesoshell.errors import InputError
from mesoshell.io.atomic import new_folder, probe_folder, probe_outputs
from mesoshell.io.bundle import Bundle, read_bundle, write_bundle
from mesoshell.io.kept_textures import to_folder
from mesoshell.io.material import find, parameter_vector
from mesoshell.limits import check_memory, check_seed, checked_latent
from mesoshell.scene.materials import read_params
from mesoshell.shell.generator.bake import patches_a_tile
from mesoshell.shell.generator.model import generator_model
from mesoshell.shell.generator.plan import halo_cost
from mesoshell.shell.generator.texture_synthesis import TextureRequest, bake_bundle, field_of

#: Texels of a side; what fits the machine is checked after it.
MAX_TEXELS = 2**24


def run(options: Options) -> None:
    """All of `mesoshell texture`."""
    begin = time.perf_counter()
    if options.out.suffix == ".npz":
        probe_outputs((options.out,))
    else:
        probe_folder(options.out, "--out")
    keep_compiled()
    bundle = read_bundle(find(options.material))
    config = generator_model(bundle, options.material).config
    size = _size(options, config.texels)
    if options.out.suffix == ".npz":
        held = 3 * bundle.channels * size[0] * size[1]  # float16, and a third more for coarser levels
        check_memory("--extent", f"a texture of {size[1]} × {size[0]} texels", held)
    elif max(size) > 2**20:
        raise InputError("--extent", f"{size[1]} × {size[0]} texels are more than {2**20} along a side")
    check_seed(options.seed)
    options = replace(options, latent=checked_latent(options.latent, options.material, config.z))
    coarser = _coarser(options, config.texels)
    wanted = replace(_wanted(options, bundle, (size[1] / config.texels, size[0] / config.texels)), coarser=coarser)
    console = stderr()
    with bar(console, "texture") as progress:
        if options.out.suffix == ".npz":
            made, share = bake_bundle(bundle, options.material, size, wanted, None, progress)
            options.out.parent.mkdir(parents=True, exist_ok=True)
            write_bundle(options.out, _with(made, share))
        else:
            _to_folder(options, bundle, size, wanted, progress)
    seconds, side = time.perf_counter() - begin, patches_a_tile(config.texels) * config.texels
    rate = size[0] * size[1] / seconds
    console.print(
        f"{size[1] >> coarser} × {size[0] >> coarser} texels in {seconds:.1f} s, {rate:,.0f} a second; tiles of "
        f"{side}² cost {halo_cost(config, side):.2f} times what they would without their halo",
        soft_wrap=True,
    )
    print(options.out)


def _to_folder(options: Options, bundle: Bundle, size: tuple[int, int], wanted: TextureRequest, progress) -> None:
    with new_folder(options.out) as folder:
        to_folder(
            folder,
            lambda allocate: _with(*bake_bundle(bundle, options.material, size, wanted, None, progress, allocate)),
        )


def _with(bundle: Bundle, share) -> Bundle:
    return replace(bundle, provenance=bundle.provenance | share._asdict())


def _size(options: Options, texels: int) -> tuple[int, int]:
    """Texels (V, U) of the extent."""
    u, v = options.extent
    if not all(1 <= x * texels <= MAX_TEXELS for x in (u, v)):
        most = f"at most {MAX_TEXELS / texels:g} patches"
        raise InputError("--extent", f"{u:g} {v:g}: must be two numbers of patches, at least a texel, and {most}")
    return round(v * texels), round(u * texels)


def _coarser(options: Options, texels: int) -> int:
    """How many of the finest levels to leave out."""
    finest = texels if options.texels is None else options.texels
    if finest < 1 or finest & (finest - 1) or finest > texels:
        raise InputError(
            "--texels", f"{finest}: the generator makes {texels}; fewer are {texels // 2}, {texels // 4}, ... 1"
        )
    return (texels // finest).bit_length() - 1


def _wanted(options: Options, bundle: Bundle, extent: tuple[float, float]) -> TextureRequest:
    """The parameters as numbers, or as images of geometry, each stretched once over the extent."""
    values, maps = read_params(bundle, pairs_of("--param", options.param))
    for p in bundle.parameters:
        if p.name in maps and p.role == "alpha":
            raise InputError("--param", f"{p.name}: an image varies appearance in a render only, not in a texture")
    parameter_vector(bundle, values, "beta")
    fields = {name: field_of(image, extent, False) for name, image in maps.items()}
    return TextureRequest(options.seed, values, fields, latent=options.latent)
