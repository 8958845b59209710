"""`mesoshell materials`: the materials that come with the package, and their parameters."""

from mesoshell.cli.options.materials import Options
from mesoshell.io.bundle import Bundle, Parameter
from mesoshell.io.material import INSTALL, WITH, bundled_materials
from mesoshell.scene.materials import Material, load_material

_ROLES = {"alpha": "appearance", "beta": "geometry"}


def run(options: Options) -> None:
    """All of `mesoshell materials`: nothing is printed if one of the materials cannot be read."""
    for line in [
        line for name in options.names or tuple(bundled_materials()) for line in lines_of(load_material(name))
    ]:
        print(line)
    absent = [name for name in WITH if name not in bundled_materials()]
    if absent and not options.names:
        print(f"{', '.join(absent)}: in a package of their own, {INSTALL}")


def lines_of(material: Material) -> list[str]:
    """What a material is, and a line for each of its parameters."""
    lines = [f"{material.name}: {_kind(material)}"]
    bundle = material.bundle
    baked = isinstance(bundle, Bundle) and bundle.generator is None
    for p in material.parameters.values():
        free = f"  --param {p.name}={p.default:g}  {_range(p)}"
        lines.append(f"  {p.name}={p.default:g}  fixed: {p.meaning}" if baked and p.role == "beta" else free)
    return lines


def _kind(material: Material) -> str:
    bundle = material.bundle
    if not isinstance(bundle, Bundle):
        return "surface material, one query a hit; no parameters"
    texels = f"{bundle.texel_density:g} texels a patch"
    if not bundle.baked:
        return f"shell with a generator, {texels}: endless, a texture for each --seed"
    if bundle.tiles is not None:
        return f"shell, {texels}: endless, of 16 tiles; another order of them for each --seed"
    return f"shell, {texels}: one patch that repeats" if bundle.wraps else f"shell, {texels}: one texture with edges"


def _range(p: Parameter) -> str:
    unit = "" if p.unit == "1" else f" {p.unit}"
    return f"from {p.range[0]:g} to {p.range[1]:g}{unit} ({_ROLES[p.role]}): {p.meaning}"
