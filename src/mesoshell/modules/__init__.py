"""The networks as Flax modules, and the state of a run as Flax's train states: `ms.modules.Decoder`
(docs/tutorials/library.md). The pure functions that they call know nothing of Flax."""

from flax.training.train_state import TrainState

from mesoshell.modules.networks import CapturedField, Decoder, Discriminator, Generator, SurfaceMaterial, TextureCritic
from mesoshell.modules.states import train_states, with_train_states
from mesoshell.modules.stored import networks_of

__all__ = [
    "CapturedField",
    "Decoder",
    "Discriminator",
    "Generator",
    "SurfaceMaterial",
    "TextureCritic",
    "TrainState",
    "networks_of",
    "train_states",
    "with_train_states",
]
