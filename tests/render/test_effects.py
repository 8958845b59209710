"""The plan of effects: one row a rule, facts to what must be on; everything else as in the plain scene."""

from dataclasses import replace

import pytest

from mesoshell.render.effects import Facts, plan_effects
from mesoshell.render.quality import Quality

PLAIN = Facts(lights=1, environment=False, objects=0, convex=True, coarsest=0.5, varying=(), transparent=True)
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
]


@pytest.mark.parametrize(("facts", "quality", "changed"), RULES)
def test_one_rule(facts: dict, quality: dict, changed: set):
    plan = plan_effects(replace(PLAIN, **facts), Quality(**quality))
    assert {name for name, effect in vars(plan).items() if effect.on} == ON_IN_PLAIN ^ changed


@pytest.mark.parametrize(("facts", "quality", "changed"), RULES)
def test_every_decision_has_a_reason(facts: dict, quality: dict, changed: set):
    record = plan_effects(replace(PLAIN, **facts), Quality(**quality)).as_dict()
    assert all(isinstance(r["on"], bool) and str(r["why"]) for r in record.values())
