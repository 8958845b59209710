"""The networks as Flax modules: each has the configuration of its pure functions, and `__call__` is these in a row.

Batches are those of the pure functions: rows of generator, discriminator, critic and decoder; one query of a surface material,
one point of a captured object (`vmap` makes many of one).
"""

from typing import Any

import flax.linen as nn
import jax.numpy as jnp
from jax.typing import DTypeLike

from mesoshell.modules.network import Network
from mesoshell.neutex import field as captured
from mesoshell.neutex.field import Field, FieldConfig, init_field
from mesoshell.shell.generator import generator as generator_pure
from mesoshell.shell.generator import texture_critic as texture_critic_pure
from mesoshell.shell.generator.discriminator import DiscriminatorConfig
from mesoshell.shell.generator.generator import Phases, Texture
from mesoshell.shell.generator.plan import GeneratorConfig
from mesoshell.shell.generator.texture_critic import CriticConfig
from mesoshell.shell.material import decoder as decoder_pure
from mesoshell.surface_material import network as surface_network
from mesoshell.surface_material.network import OpacityEval, SurfaceConfig, SurfaceQuery
from mesoshell.train.gan.discriminators import AnyDiscriminator, kind_of
from mesoshell.typing import Array, Float, Int, Key, Scalar, Vec3


class Generator(Network):
    """F on a tile of `size` texels (v, u), and F(h) (shell/generator/generator). Its collection `averages` is not learned."""

    config: GeneratorConfig
    size: tuple[int, int]

    @classmethod
    def of_patch(cls, config: GeneratorConfig) -> "Generator":
        """On the texels of one patch."""
        return cls(config, (config.texels, config.texels))

    def draw(self, key: Key[Array, ""]) -> generator_pure.Generator:
        return generator_pure.init_generator(self.config, key)

    @nn.compact
    def averages(self) -> generator_pure.Averages:
        """The running averages, which are not learned, as a tree."""
        return self.declared("averages", lambda key: generator_pure.init_averages(self.config))

    def __call__(
        self, z: Float[Array, "B Z"], beta: Float[Array, "B G"], phases: Phases, tile: Int[Array, "2"]
    ) -> tuple[Texture, Float[Array, "B R C"]]:
        generator, averages = self.tree(), self.averages()
        w = generator_pure.map_latent(generator, z, beta)
        texture = generator_pure.synthesise(self.config, generator, averages, w, phases, tile, self.size)
        return texture, generator_pure.synthesise_height(self.config, generator, w)


class Discriminator(Network):
    """The logits of pictures y with labels c, of the configuration's kind (train/gan/discriminators). dtype: of the
    convolutions but the last."""

    config: DiscriminatorConfig
    dtype: DTypeLike = jnp.float32

    def draw(self, key: Key[Array, ""]) -> AnyDiscriminator:
        return kind_of(self.config).start(self.config, key)

    def __call__(self, y: Float[Array, "B S S I"], c: Float[Array, "B L"]) -> Float[Array, "B ..."]:
        kind = kind_of(self.config)
        return kind.judge(self.tree(), kind.perceive(y), c, dtype=self.dtype)


class TextureCritic(Network):
    """A grid of logits for views of textures (shell/generator/texture_critic)."""

    config: CriticConfig

    def draw(self, key: Key[Array, ""]) -> texture_critic_pure.Critic:
        return texture_critic_pure.init_critic(self.config, key)

    def __call__(self, y: Float[Array, "B S S I"], beta: Float[Array, "B G"]) -> Float[Array, "B s s"]:
        return texture_critic_pure.criticise(self.tree(), y, beta)


class Decoder(Network):
    """σ and ρ of features toward a viewer and a light (shell/material/decoder). inputs: numbers that the trunk sees; hidden:
    widths of trunk's and of head's layers."""

    inputs: int
    hidden: tuple[tuple[int, ...], tuple[int, ...]]

    @classmethod
    def like(cls, tree: decoder_pure.Decoder) -> "Decoder":
        """The module of an existing decoder."""
        trunk, head = (tuple(layer.bias.shape[0] for layer in layers) for layers in (tree.trunk, tree.head))
        return cls(tree.trunk[0].kernel.shape[0], (trunk, head))

    def draw(self, key: Key[Array, ""]) -> decoder_pure.Decoder:
        return decoder_pure.init_decoder(key, self.inputs, *self.hidden)

    def __call__(
        self, x: Float[Array, "*batch I"], w: Float[Array, "*batch 3"], w_light: Float[Array, "*batch 3"]
    ) -> tuple[Float[Array, "*batch"], Float[Array, "*batch 3"]]:
        decoder = self.tree()
        sigma, features = decoder_pure.trunk(decoder, x)
        return sigma, decoder_pure.head(decoder, decoder_pure.toward_viewer(decoder, features, w), w_light)


class SurfaceMaterial(Network):
    """The answer of a surface material to a query and a light: α with the features for reflectance, and ρ
    (surface_material/network). blur: of its textures, in texels; 1e-3 once it is trained."""

    config: SurfaceConfig

    def draw(self, key: Key[Array, ""]) -> surface_network.Surface:
        return surface_network.init_surface(self.config, key)

    def __call__(self, place: SurfaceQuery, light: Vec3, blur: Scalar) -> tuple[OpacityEval, Vec3]:
        table = surface_network.blur_textures(self.tree(), blur)
        opacity = surface_network.eval_opacity(self.config, table, place)
        return opacity, surface_network.reflectance(self.config, table, place, opacity, light)


class CapturedField(Network):
    """σ and colour of a point y seen along d, in the box's units (neutex/field); with reflectance, the normal and the lobes
    instead of a colour."""

    config: FieldConfig

    def draw(self, key: Key[Array, ""]) -> Field:
        return init_field(self.config, key)

    def __call__(self, y: Vec3, d: Vec3) -> tuple[Scalar, Any]:
        field = self.tree()
        sigma, features = captured.density(self.config, field, y)
        if self.config.colour != "reflectance":
            return sigma, captured.radiance(self.config, field, y, d, features)
        made = captured.lobes(self.config, field, captured.to_texture(field, y))
        return sigma, (captured.normal(field, y, features), made)
