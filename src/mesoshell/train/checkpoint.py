"""Checkpoints of a run through orbax: the newest three, written whole or not at all."""

from pathlib import Path
from typing import Any

import jax
import orbax.checkpoint as ocp


class Checkpoints:
    """The checkpoints of a run in `folder`; a context manager, so that what is being written is finished."""

    def __init__(self, folder: Path):
        options = ocp.CheckpointManagerOptions(max_to_keep=3, create=True)
        self.manager = ocp.CheckpointManager(folder.resolve(), options=options)

    def __enter__(self) -> "Checkpoints":
        return self

    def __exit__(self, *_: object) -> None:
        self.manager.wait_until_finished()
        self.manager.close()

    def save(self, step: int, tree: Any) -> None:
        self.manager.save(step, args=ocp.args.StandardSave(tree))

    def newest(self, like: Any) -> tuple[int, Any] | None:
        """Step and state of the newest checkpoint, shaped as `like`; None if there is none."""
        step = self.manager.latest_step()
        if step is None:
            return None
        abstract = jax.tree.map(ocp.utils.to_shape_dtype_struct, like)
        return step, self.manager.restore(step, args=ocp.args.StandardRestore(abstract))
