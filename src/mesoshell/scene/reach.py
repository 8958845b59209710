"""The picture of a scene up to a goal, with settings chosen for it unless they are given."""

from mesoshell.render.effects import MARCH
from mesoshell.render.quality import Quality
from mesoshell.scene.accumulate import Goal, accumulate
from mesoshell.scene.choose import choose
from mesoshell.scene.picture import Picture, Prepared, Progress


def picture_of(prepared: Prepared, quality: Quality, goal: Goal | None, free: bool, progress: Progress) -> Picture:
    """The picture of a scene that is prepared with this quality: with as many samples as it says or, pass by pass, up to the
    goal. free: whether its other settings may be changed for the goal; only those of marches are."""
    if goal is None:
        return prepared.picture(progress)
    marches = prepared.engine == MARCH.name and prepared.effects is not None and prepared.effects.shells.on
    if not (free and marches and (goal.budget or goal.error)):
        return prepared.presented(accumulate(prepared.passes(None), goal, progress))
    choice = choose(prepared, quality, goal)
    rendered = accumulate(choice.passes, goal.less(choice.bias), progress, warm=True)
    reached = rendered.record["goal"]
    reached |= {"settings": choice.settings, "bias": choice.bias}
    reached["promised"]["error"] = goal.error
    return prepared.presented(rendered._replace(seconds={"probe": choice.seconds, **rendered.seconds}))
