"""Which effects a scene calls for (NumPy only; no JAX). What is off is not in the compiled program.

`plan_effects` decides from facts about the scene, before anything is compiled or traced; each decision comes with its
reason, which `--explain` prints and the report keeps.
"""

from dataclasses import dataclass

from mesoshell.render.quality import Quality


@dataclass(frozen=True)
class TwinFacts:
    """Of a surface material that was distilled from the shell. finest: the least footprint (standard deviation) that the camera
    can have on the shell, patches; errors: its error by footprint (io/twin); misfit: why it is not this shell's, or nothing."""

    finest: float
    errors: tuple[tuple[float, float], ...]
    misfit: str


@dataclass(frozen=True)
class Facts:
    """What the decisions rest on. coarsest: the largest footprint in texels that the camera can have on this mesh (one standard
    deviation to either side); convex: no part of the mesh can shadow another part."""

    lights: int
    environment: bool
    objects: int
    convex: bool
    coarsest: float
    varying: tuple[str, ...]
    transparent: bool
    twin: TwinFacts | None = None


@dataclass(frozen=True)
class Effect:
    on: bool
    why: str


@dataclass(frozen=True)
class Effects:
    """One field an effect; see `plan_effects` for what each means."""

    distant_lights: Effect
    several_lights: Effect
    environment: Effect
    mesh_shadow: Effect
    object_shadow: Effect
    filtering: Effect
    anisotropic_filtering: Effect
    varying_parameters: Effect
    background: Effect
    twin: Effect

    def as_dict(self) -> dict[str, dict[str, object]]:
        return {name: {"on": e.on, "why": e.why} for name, e in vars(self).items()}


def plan_effects(facts: Facts, quality: Quality) -> Effects:
    """Decide each effect."""
    lit = facts.lights > 0 or facts.environment
    varying = ", ".join(facts.varying)
    level = facts.coarsest > 1
    return Effects(
        distant_lights=Effect(facts.lights > 0, f"{facts.lights} distant" if facts.lights else "no distant light"),
        several_lights=Effect(facts.lights > 1, f"{facts.lights} distant lights share one trunk evaluation"),
        environment=Effect(facts.environment, "an environment was given" if facts.environment else "no environment"),
        mesh_shadow=_mesh_shadow(facts, lit),
        object_shadow=Effect(
            lit and facts.objects > 0, f"{facts.objects} other objects" if facts.objects else "no other objects"
        ),
        filtering=_filtering(facts, quality, level),
        anisotropic_filtering=Effect(
            level and quality.filtering and quality.anisotropy > 1, f"{quality.anisotropy} taps by quality"
        ),
        varying_parameters=Effect(bool(varying), f"maps for {varying}" if varying else "every parameter is one number"),
        background=Effect(
            facts.environment and not facts.transparent,
            "rays that leave the shell see the environment"
            if facts.environment and not facts.transparent
            else "the background is transparent",
        ),
        twin=plan_twin(facts.twin, quality),
    )


def twin_reach(errors: tuple[tuple[float, float], ...], bound: float) -> float:
    """The least footprint, patches, from which on no error exceeds the bound; infinite if there is none."""
    reach = float("inf")
    for radius, error in reversed(errors):
        if error > bound:
            break
        reach = radius
    return reach


def plan_twin(twin: TwinFacts | None, quality: Quality) -> Effect:
    """Whether a distilled surface material stands in for the shell, in either engine."""
    if twin is None:
        return Effect(False, "the material has no distilled twin")
    if quality.twin == 0:
        return Effect(False, "switched off by quality")
    if twin.misfit:
        return Effect(False, f"the distilled twin is of another shell: {twin.misfit}")
    reach = twin_reach(twin.errors, quality.twin)
    if reach == float("inf"):
        return Effect(False, f"it looks {twin.errors[-1][1]:.3f} FLIP different from afar, above {quality.twin:g}")
    least = f"from {reach:.2g} on it looks {quality.twin:g} FLIP different at most"
    said = f"footprints begin at {twin.finest:.2g} patches; {least}"
    return Effect(twin.finest >= reach, said)


def _mesh_shadow(facts: Facts, lit: bool) -> Effect:
    if not lit:
        return Effect(False, "no light")
    if facts.convex:
        return Effect(False, "the mesh is convex: it cannot shadow its own shell beyond the horizon")
    return Effect(True, "the mesh is not convex")


def _filtering(facts: Facts, quality: Quality, level: bool) -> Effect:
    if not quality.filtering:
        return Effect(False, "switched off by quality")
    if not level:
        return Effect(False, f"footprints reach {facts.coarsest:.2g} texels at most: the finest level everywhere")
    return Effect(True, f"footprints reach {facts.coarsest:.1f} texels")
