"""The plan of effects: one row a rule, facts to what must be on; everything else as in the plain scene."""

from dataclasses import fields, replace

import numpy as np
import pytest

from mesoshell.render.effects import (
    MARCH,
    PATHS,
    SURFACE,
    Effects,
    Engine,
    left_out,
    plan_effects,
    twin_reach,
)
from mesoshell.render.facts import Facts, TwinFacts
from mesoshell.render.quality import Quality
from mesoshell.render.used import quality_used

#: A shell on a convex mesh under one distant light.
PLAIN = Facts(shells=1, distant=1, convex=True, ground=0.09, coarsest=0.5, rows=32)
SURFACE_ONLY = replace(PLAIN, shells=0, surfaces=1, passable=True)
TWIN = TwinFacts(finest=0.5, errors=((0.01, 0.1), (0.1, 0.02), (0.4, 0.01)), misfit="")
ALWAYS = {"shells", "direct_light", "quadrature"}
SHARED = [
    ({}, {}, set()),
    ({"distant": 2}, {}, set()),
    ({"coarsest": 3.0}, {}, {"filtering"}),
    ({"coarsest": 1.8}, {}, set()),
    ({"coarsest": 1.8}, {"footprint": 1.0}, {"filtering"}),
    ({"coarsest": np.inf}, {"footprint": 0.0}, set()),
    ({"coarsest": 3.0}, {"anisotropy": 4}, {"filtering", "anisotropic_filtering"}),
    ({"coarsest": 3.0}, {"anisotropy": 4, "filtering": False}, set()),
    ({"coarsest": 0.9}, {"anisotropy": 4}, {"filtering", "anisotropic_filtering"}),  # long sides have no bound
    (
        {},
        {"samples": 32, "height_filter": 1.0},
        {"filtering"},
    ),  # down and up again, a sample is wider than one of 32 rows
    ({"low": True}, {}, {"mesh_shadow"}),
    ({"varying": ("dryness",)}, {}, {"varying_parameters"}),
    ({"shaped": True}, {}, {"varying_geometry"}),
    ({"tiled": True}, {}, {"corner_tiles"}),
    ({"inside": True}, {}, {"camera_in_shell"}),
    ({"twin": TWIN}, {}, {"twin"}),
    ({"twin": TWIN}, {"twin": 0.0}, set()),
    ({"twin": TWIN}, {"twin": 0.005}, set()),
    ({"twin": replace(TWIN, misfit="it is another")}, {}, set()),
    ({"twin": replace(TWIN, finest=0.2)}, {"twin": 0.015}, set()),
    ({"twin": replace(TWIN, finest=0.2)}, {"twin": 0.02}, {"twin"}),
]
MARCHED = [
    ({"environment": True}, {}, {"environment"}),
    ({"environment": True, "seen": True}, {}, {"environment", "background"}),
    ({"seen": True}, {}, set()),
    ({"convex": False, "enclosed": 0.1}, {}, {"mesh_shadow", "filtering"}),
    ({"convex": False, "distant": 0}, {}, {"direct_light", "filtering"}),
    ({}, {"spacing": "interval"}, {"filtering"}),
    ({}, {"spacing": "density"}, {"filtering"}),  # some samples stand for half of a ray, and reach over rows
    ({"rows": 4}, {"spacing": "density"}, set()),
    ({"objects": 1, "enclosed": 0.5}, {}, {"object_shadow"}),
    ({"objects": 1, "distant": 0}, {}, {"direct_light"}),
    ({"distant": 0}, {}, {"direct_light"}),
    ({}, {"max_depth": 1}, set()),
]
#: Where paths bounce, collisions are drawn; footprints open at an event.
GOING = {"bounces", "roulette", "quadrature", "filtering"}
TRACED = [
    ({"distant": 0}, {}, {"direct_light", "quadrature"}),
    ({"rows": 16}, {"spacing": "density"}, {"filtering"}),
    ({}, {"max_depth": 1}, {"direct_light", "quadrature"}),
    ({"environment": True}, {}, {"environment", "quadrature", "filtering"}),
    ({"area": 1}, {}, {"area_light", "quadrature", "filtering"}),
    ({"point": 1, "distant": 0}, {}, {"quadrature"}),
    ({"ground": 0.5}, {}, GOING),
    ({"ground": 0.09}, {"dark_ground": 0.0}, GOING),
    ({"ground": 0.0}, {"dark_ground": 0.0}, set()),
    ({"ground": 0.5}, {"max_depth": 2}, set()),
    ({"ground": 0.5}, {"rr_depth": 8}, GOING - {"roulette"}),
    ({"shells": 2, "objects": 2}, {}, GOING | {"object_shadow", "shell_shadow"}),
    ({"convex": False, "enclosed": 1.0}, {}, GOING | {"mesh_shadow", "shell_shadow"}),
    ({"convex": False}, {"max_depth": 2}, {"mesh_shadow", "shell_shadow", "quadrature", "filtering"}),
    ({"objects": 1, "enclosed": 1.0}, {}, GOING | {"object_shadow"}),
]
RULES = [(engine, *rule) for engine in (MARCH, PATHS) for rule in SHARED]
RULES += [(MARCH, *rule) for rule in MARCHED] + [(PATHS, *rule) for rule in TRACED]


def on(effects: Effects) -> set[str]:
    return {name for name, effect in vars(effects).items() if effect.on}


@pytest.mark.parametrize(("engine", "facts", "quality", "changed"), RULES)
def test_one_rule(engine: Engine, facts: dict, quality: dict, changed: set):
    plan = plan_effects(
        replace(PLAIN, **facts), Quality(spacing="length", anisotropy=1).with_changes(**quality), engine
    )
    assert on(plan) == ALWAYS ^ changed
    assert all(isinstance(r["on"], bool) and str(r["why"]) for r in plan.as_dict().values())
    assert "nan" not in str(plan.filtering.why)


def test_a_surface_material_is_queried_by_either_engine():
    plain, both = (
        {"surface_materials", "opacity", "direct_light"},
        replace(SURFACE_ONLY, environment=True, seen=True, objects=1),
    )
    assert on(plan_effects(SURFACE_ONLY, Quality(), SURFACE)) == plain
    assert on(plan_effects(both, Quality(), SURFACE)) == plain | {"environment", "background", "object_shadow"}
    assert on(plan_effects(SURFACE_ONLY, Quality(), PATHS)) == plain | {"bounces", "roulette"}
    assert on(plan_effects(replace(SURFACE_ONLY, passable=False), Quality(), SURFACE)) == plain - {"opacity"}


def test_an_engine_says_what_it_cannot():
    """An effect that a scene calls for is on, or missing and said so; a room calls for bounces, a cow hardly does."""
    room = replace(PLAIN, convex=False, enclosed=0.9, area=1)
    marched, traced = (plan_effects(room, Quality(), engine) for engine in (MARCH, PATHS))
    assert {name for name, e in vars(marched).items() if e.missing} == {"area_light", "shell_shadow", "bounces"}
    assert all("engine jax cannot, engine mitsuba can" in e.why for e in vars(marched).values() if e.missing)
    (line,) = left_out(marched)
    assert line.startswith("bounces are left out: surfaces meet surfaces in 90% of directions") and "\n" not in line
    assert not left_out(traced) and traced.bounces.on and not any(e.missing for e in vars(traced).values())
    assert not left_out(plan_effects(replace(room, enclosed=0.09), Quality(), MARCH))


@pytest.mark.parametrize(
    "changes, density, on, why",
    [
        ({}, "baked", True, "from 0.001 million numbers; nearby, a column is 1.5 times as wide as a footprint"),
        ({}, "network", False, "switched off by quality"),
        (
            {"magnified": 2.5},
            "baked",
            False,
            "nearby, a column of its grid is 2.5 times as wide as a pixel's footprint",
        ),
        ({"magnified": np.inf}, "baked", False, "how near a camera sees its columns is not known"),
        ({"baked": 2**26}, "network", False, "grids would hold 67 million numbers, above 34"),
        ({"environment": False}, "baked", False, "samples that are all lit need the network's features"),
        ({"shells": 0}, "baked", False, "no shells"),
    ],
)
def test_a_density_is_baked_for_drawn_paths_that_see_no_finer(changes: dict, density: str, on: bool, why: str):
    """And nothing is filtered then."""
    facts = replace(PLAIN, **{"environment": True, "baked": 1000, "magnified": 1.5, "coarsest": 3.0} | changes)
    effects = plan_effects(facts, Quality(density=density), PATHS)
    assert effects.baked_density.on == on and effects.baked_density.why.startswith(why)
    assert not (on and (effects.filtering.on or effects.anisotropic_filtering.on))
    assert not effects.baked_density.missing


@pytest.mark.parametrize(
    ("changes", "quality", "on", "why"),
    [
        ({}, {}, True, "from 0.001 million numbers"),
        ({"coarsest": 16.0}, {}, True, "from"),
        ({"coarsest": 17.0}, {}, False, "footprints reach 17 texels, which few rays do not average"),
        ({"baked": 70_000_000, "pixels": 10**6}, {}, False, "grids would hold 70 million numbers, above 34"),
        ({"baked": 700_000}, {}, True, "from 0.7 million numbers"),
        ({"baked": 700_001}, {}, False, "grids of 0.7 million numbers would take longer than the picture"),
        ({"baked": 700_000}, {"samples": 27}, False, "grids of 0.7 million numbers would take longer"),
        ({"magnified": 0.0}, {}, False, "no camera sees a surface"),
        ({}, {"light_samples": 0}, False, "samples that are all lit need the network's features"),
        ({}, {"density": "network"}, False, "switched off by quality"),
        ({"magnified": 2.5}, {}, False, "nearby, a column of its grid is 2.5 times as wide as a pixel's footprint"),
    ],
)
def test_a_march_has_its_density_baked_where_that_pays(changes: dict, quality: dict, on: bool, why: str):
    """If few rays average its footprints, not all that it samples is lit, and a grid takes less than it saves."""
    facts = replace(PLAIN, **{"baked": 1000, "magnified": 1.5, "coarsest": 3.0, "pixels": 10_000} | changes)
    asked = Quality().with_changes(**quality)
    effects = plan_effects(facts, asked, MARCH)
    assert effects.baked_density.on == on and effects.baked_density.why.startswith(why)
    assert effects.filtering.on != on
    assert quality_used(asked, effects, MARCH).get("density") == (
        "network" if "density" in quality else "baked" if on else None
    )


@pytest.mark.parametrize("engine", [MARCH, SURFACE, PATHS])
def test_engines_can_what_there_is(engine: Engine):
    assert engine.can <= {f.name for f in fields(Effects)}


def test_every_field_of_quality_applies_somewhere_and_nowhere_without_reason():
    """What is reported is what was used: fields of paths in paths, of sums where samples are summed."""
    lone = replace(PLAIN, rows=4)
    room = replace(lone, objects=1, enclosed=1.0, coarsest=3.0, twin=TWIN)
    sky = replace(room, environment=True)

    def used(facts: Facts, engine: Engine, **changes: object) -> set[str]:
        quality = Quality(anisotropy=1).with_changes(**changes)
        found = quality_used(quality, plan_effects(facts, quality, engine), engine)
        assert all(found[name] == getattr(quality, name) for name in found)
        return set(found)

    marched = {"pixel_samples", "samples", "spacing", "coordinates", "early_stop", "weight_cut", "filtering"}
    marched |= {"base_samples", "light_samples"}
    assert used(lone, MARCH) == marched
    assert used(lone, MARCH, spacing="length") == marched | {"skip"}
    filtered = {"height_filter", "footprint", "anisotropy"}
    assert used(sky, MARCH) == marched | filtered | {"visibility", "twin", "environment_samples"}
    assert used(replace(lone, distant=0), MARCH) == marched - {"weight_cut", "base_samples", "light_samples"}
    own = {"pixel_samples", "early_stop", "curvature_filter", "curve_length"}
    assert used(SURFACE_ONLY, SURFACE) == own
    assert used(SURFACE_ONLY, SURFACE, curvature_filter="point") == own - {"curve_length"}
    paths = {"samples", "spacing", "coordinates", "early_stop", "skip", "filtering", "spp", "dark_ground"}
    assert used(lone, PATHS) == paths | {"weight_cut"}
    assert used(lone, PATHS, max_depth=2) == paths | {"weight_cut", "max_depth"}
    assert used(room, PATHS) == paths | filtered | {"max_depth", "twin", "rr_depth", "bounce_spread"}
    drawn = replace(room, baked=100, magnified=1.0)
    most = used(room, PATHS)
    assert used(drawn, PATHS) == most - filtered - {"filtering", "bounce_spread"} | {"density"}
    assert used(drawn, PATHS, density="network") == most | {"density"}
    near = replace(drawn, environment=True, pixels=100)
    assert used(near, MARCH) == used(replace(sky, baked=2**26), MARCH) - filtered - {"filtering"} | {"density"}
    everywhere = used(drawn, PATHS) | used(sky, MARCH) | used(room, PATHS) | used(SURFACE_ONLY, SURFACE)
    assert everywhere == {f.name for f in fields(Quality)}


def test_a_twin_reaches_down_to_the_last_error_that_is_too_large():
    """However small errors are below."""
    errors = ((0.01, 0.01), (0.1, 0.3), (0.2, 0.04), (0.4, 0.02))
    assert [twin_reach(errors, bound) for bound in (0.5, 0.3, 0.2, 0.03, 0.01)] == [0.01, 0.01, 0.2, 0.4, float("inf")]
