"""Render and explain scenes. Importing it loads no JAX."""

from typing import Any, Literal

from mesoshell.render.effects import Effects
from mesoshell.render.quality import Quality
from mesoshell.scene.accumulate import accumulate, goal_of
from mesoshell.scene.picture import Picture, Prepared, Progress
from mesoshell.scene.prepare import prepare, quality_of
from mesoshell.scene.scene import Scene

Engine = Literal["jax", "mitsuba"]


def render(
    scene: Scene,
    quality: str | Quality = "normal",
    *,
    engine: Engine = "jax",
    budget: float | None = None,
    error: float | None = None,
    max_samples: int | None = None,
    progress: Progress = lambda share: None,
    **changes: Any,
) -> Picture:
    """A picture of a scene, as `mesoshell render` makes it, bit for bit.

    quality: "draft", "normal", "reference" or a Quality; changes: of its fields, such as samples=64. engine: "jax" marches
    rays, with direct light only; "mitsuba" traces paths, with indirect light too. progress: called with the
    share done, 0 to 1, while it renders. Raises InputError, which names the argument or the file at fault.
    """
    goal = goal_of(budget, error, max_samples, changes)
    ready = _prepared(scene, quality, engine, changes)
    return ready.picture(progress) if goal is None else ready.presented(accumulate(ready.passes(None), goal, progress))


def explain(scene: Scene, quality: str | Quality = "normal", *, engine: Engine = "jax", **changes: Any) -> Effects:
    """Which effects a scene calls for, and why; prints as a line each. Nothing is rendered. Arguments: see `render`."""
    effects = _prepared(scene, quality, engine, changes).effects
    assert effects is not None  # None only for a scene of Mitsuba's own
    return effects


def _prepared(scene: Scene, quality: str | Quality, engine: Engine, changes: dict[str, Any]) -> Prepared:
    return prepare(scene, quality_of(quality, engine, changes), engine)
