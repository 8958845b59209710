"""The plan of effects: one row a rule, facts to what must be on; everything else as in the plain scene."""

from dataclasses import replace

import pytest

from mesoshell.render.effects import Facts, TwinFacts, plan_effects, twin_reach
from mesoshell.render.quality import Quality

PLAIN = Facts(lights=1, environment=False, objects=0, convex=True, coarsest=0.5, varying=(), transparent=True)
TWIN = TwinFacts(finest=0.5, errors=((0.01, 0.1), (0.1, 0.02), (0.4, 0.01)), misfit="")
ON_IN_PLAIN = {"distant_lights"}
RULES = [
    ({}, {}, set()),
    ({"lights": 0}, {}, {"distant_lights"}),
    ({"lights": 2}, {}, {"several_lights"}),
    ({"environment": True}, {}, {"environment"}),
    ({"environment": True, "transparent": False}, {}, {"environment", "background"}),
    ({"transparent": False}, {}, set()),
    ({"convex": False}, {}, {"mesh_shadow"}),
    ({"convex": False, "lights": 0}, {}, {"distant_lights"}),
    ({"objects": 1}, {}, {"object_shadow"}),
    ({"objects": 1, "lights": 0}, {}, {"distant_lights"}),
    ({"coarsest": 3.0}, {}, {"filtering"}),
    ({"coarsest": 3.0}, {"anisotropy": 4}, {"filtering", "anisotropic_filtering"}),
    ({"coarsest": 3.0}, {"anisotropy": 4, "filtering": False}, set()),
    ({"coarsest": 0.9}, {"anisotropy": 4}, set()),
    ({"varying": ("dryness",)}, {}, {"varying_parameters"}),
    ({"twin": TWIN}, {}, {"twin"}),
    ({"twin": TWIN}, {"twin": 0.0}, set()),
    ({"twin": TWIN}, {"twin": 0.005}, set()),
    ({"twin": replace(TWIN, misfit="it is another")}, {}, set()),
    ({"twin": replace(TWIN, finest=0.2)}, {"twin": 0.015}, set()),
    ({"twin": replace(TWIN, finest=0.2)}, {"twin": 0.02}, {"twin"}),
]


@pytest.mark.parametrize(("facts", "quality", "changed"), RULES)
def test_one_rule(facts: dict, quality: dict, changed: set):
    plan = plan_effects(replace(PLAIN, **facts), Quality(**quality))
    assert {name for name, effect in vars(plan).items() if effect.on} == ON_IN_PLAIN ^ changed


@pytest.mark.parametrize(("facts", "quality", "changed"), RULES)
def test_every_decision_has_a_reason(facts: dict, quality: dict, changed: set):
    record = plan_effects(replace(PLAIN, **facts), Quality(**quality)).as_dict()
    assert all(isinstance(r["on"], bool) and str(r["why"]) for r in record.values())


def test_a_twin_reaches_down_to_the_last_error_that_is_too_large():
    """However small errors are below."""
    errors = ((0.01, 0.01), (0.1, 0.3), (0.2, 0.04), (0.4, 0.02))
    assert [twin_reach(errors, bound) for bound in (0.5, 0.3, 0.2, 0.03, 0.01)] == [0.01, 0.01, 0.2, 0.4, float("inf")]
