"""Pictures that must be the same in the mean, at two million paths each: z-tests of every pixel, and of the whole.

Notation
runs        independent pictures of one scene, (passes, H, W, C)
p           chance of a pixel's difference if the means are one (Welch); Šidák's correction for the least of many
"""

from dataclasses import replace
from typing import Any

import mitsuba as mi
import numpy as np
import pytest
from scipy.stats import ttest_ind

from mesoshell.pathtracer.load import load_dict
from mesoshell.render.effects import Effect
from mesoshell.render.quality import Quality
from tests.helpers.path_traced import QUALITY, scene, sensor, shell

PASSES, SPP, SIDE = 16, 128, 32
EXACT = QUALITY.with_changes(early_stop=0.0, skip=0.0, weight_cut=0.0)

pytestmark = pytest.mark.slow


def runs(made: Any, first: int = 0) -> np.ndarray:
    seeds = range(first, first + PASSES)
    return np.stack([np.array(mi.render(made, spp=SPP, seed=mi.UInt32(k)))[..., :3] for k in seeds])


def agree(a: np.ndarray, b: np.ndarray) -> None:
    """Every pixel's luminance, and the whole."""
    assert len(a) * SPP * SIDE**2 >= 2e6
    one, other = a.mean(axis=-1), b.mean(axis=-1)
    means, spread = np.stack([one, other]).mean(axis=1), np.stack([one, other]).std(axis=1)
    # where next to nothing arrives, or always the same, they are no normal numbers
    often = ((means > 0.02 * one.mean()) & (spread > 1e-4 * one.mean())).all(axis=0)
    result: Any = ttest_ind(one[:, often], other[:, often], equal_var=False)
    p = result.pvalue
    assert len(p) > 0.3 * SIDE**2
    assert 1 - (1 - p.min()) ** len(p) > 0.01
    whole: Any = ttest_ind(a.mean(axis=(1, 2, 3)), b.mean(axis=(1, 2, 3)), equal_var=False)
    assert whole.pvalue > 0.01 and a.std(axis=0).mean() < 0.1 * a.mean()


def stage(materials, depth: int = 5, **integrator) -> dict:
    """A rough shell beside a wall, under a sky, a lamp and a point."""
    wall = {
        "type": "rectangle",
        "to_world": mi.ScalarTransform4f().translate([0.5, 1.3, 0.5]).rotate([1, 0, 0], 90),
        "bsdf": {
            "type": "twosided",
            "b": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.7, 0.3, 0.2]}},
        },
    }
    lamp = {
        "type": "rectangle",
        "to_world": mi.ScalarTransform4f().translate([1.8, 0.2, 1.8]).rotate([0, 1, 0], -120).scale(0.3),
        "emitter": {"type": "area", "radiance": {"type": "rgb", "value": [6.0, 5.0, 4.0]}},
    }
    view = sensor()
    view["film"] = view["film"] | {"width": SIDE, "height": SIDE}
    parts = scene(
        shell(materials, "rough"), wall, lamp, light={"type": "constant", "radiance": 0.3}, depth=depth, eye=view
    )
    parts["integrator"] |= integrator
    return parts | {"point": {"type": "point", "position": [-0.5, 0.2, 1.5], "intensity": 1.0}}


def made(parts: dict, quality: Quality = EXACT) -> Any:
    return load_dict(parts, quality)


def test_effects_gated_and_all_compiled(materials) -> None:
    gated, full = made(stage(materials)), made(stage(materials))
    context = full.integrator().context
    every = {
        name: Effect(name not in ("quadrature", "surface_materials", "baked_density"), "for the test")
        for name in vars(context.effects)
    }
    context.effects = replace(context.effects, **every)
    agree(runs(gated), runs(full, PASSES))


def test_roulette_early_and_never(materials) -> None:
    agree(runs(made(stage(materials, rr_depth=2))), runs(made(stage(materials, rr_depth=50)), PASSES))


def test_collisions_drawn_and_samples_summed(materials) -> None:
    view = sensor()
    view["film"] = view["film"] | {"width": SIDE, "height": SIDE}
    summed, drawn = (
        made(scene(shell(materials, "rough"), eye=view), EXACT.with_changes(samples=256)) for _ in range(2)
    )
    assert summed.integrator().context.effects.quadrature.on
    context = drawn.integrator().context
    context.effects = replace(context.effects, quadrature=Effect(False, "for the test"))
    agree(runs(summed), runs(drawn, PASSES))


def test_it_would_be_seen_if_a_hundredth_were_missing(materials) -> None:
    """That the tests above can fail: the same scene, 1% brighter."""
    a = runs(made(stage(materials)))
    with pytest.raises(AssertionError):
        agree(a, 1.01 * runs(made(stage(materials)), PASSES))
