"""The networks of a loaded bundle or model, as modules with their parameters."""

from mesoshell.io.bundle import Bundle
from mesoshell.io.surface import SurfaceBundle
from mesoshell.modules.network import Network
from mesoshell.modules.networks import CapturedField, Decoder, Generator, SurfaceMaterial
from mesoshell.neutex.store import NeuTexModel
from mesoshell.shell.generator.model import generator_model
from mesoshell.shell.material.loader import decoder_of
from mesoshell.surface_material.loader import load_device_material


def networks_of(stored: Bundle | SurfaceBundle | NeuTexModel) -> dict[str, Network]:
    """By name, each bound to its parameters: a shell's `decoder`, and `generator` (of one patch) if there is one; a surface
    material's `surface`; a captured object's `field`. A bound module is called as it is; `unbind` gives module and variables.
    Raises InputError if a generator's weights do not fit its configuration."""
    if isinstance(stored, NeuTexModel):
        return {"field": CapturedField(stored.config).bind({"params": stored.field})}
    if isinstance(stored, SurfaceBundle):
        loaded = load_device_material(stored)
        return {"surface": SurfaceMaterial(loaded.config).bind({"params": loaded.table.surface})}
    decoder = decoder_of(stored.arrays)
    networks: dict[str, Network] = {"decoder": Decoder.like(decoder).bind({"params": decoder})}
    if stored.generator is not None:
        maker = generator_model(stored, "bundle")
        generator = Generator.of_patch(maker.config)
        networks["generator"] = generator.bind({"params": maker.generator, "averages": maker.averages})
    return networks
