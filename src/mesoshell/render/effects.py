"""Which effects a scene calls for (NumPy only; no JAX): one table of effects for all engines.

`plan_effects` decides from `Facts`, a description of the scene (render/facts), before anything is compiled or traced; each
decision comes with its reason, which `--explain` prints and the report keeps. What is off is not in the compiled program. An
`Engine` says which effects it can compute: what a scene calls for beyond these is off, and its reason says so.
"""

from dataclasses import dataclass, fields

from mesoshell.render.facts import Facts, TwinFacts
from mesoshell.render.quality import WIDEST, Quality

#: Share of directions from a surface that meet a surface again, above which a note says that interreflection is left out. For
#: diffuse surfaces of albedo a it adds about a times this share.
ENCLOSED = 0.25
NO_TWIN = "there is no distilled twin to stand in"
BY_QUALITY = "switched off by quality"
#: Numbers that grids of σ may hold, some eight seconds on two cores; how wide their columns may be seen, over a footprint.
MAX_BAKED, MAX_MAGNIFIED = 2**25, 2.0
#: Of a march: numbers of its grids for each sample of a ray a pixel, at most, for else they take longer to make than they save
#: in a picture of two rays a pixel; and texels of its largest footprint, of which few rays average no more.
MAX_NUMBERS, MAX_TEXELS = 2.5, 16.0


@dataclass(frozen=True)
class Effect:
    """missing: the scene calls for it, and the engine cannot compute it."""

    on: bool
    why: str
    missing: bool = False


@dataclass(frozen=True)
class Effects:
    """One field an effect.

    shells: rays are marched through them. surface_materials: a query per hit; opacity: rays may pass silhouettes. twin: a
    distilled surface material stands in for a shell. direct_light: emitters are sampled at each event. environment,
    area_light: emitters that a ray may meet. background: the environment is seen. mesh_shadow, object_shadow, shell_shadow:
    what dims the way to a light. bounces: light goes from one event to another. roulette: paths end by chance. quadrature:
    all samples of a ray are summed, in place of one that is drawn. camera_in_shell: rays may begin in a shell.
    baked_density: σ is read from a grid. filtering: features are averaged over the pixel; anisotropic_filtering: along its
    long side too. varying_parameters, varying_geometry: over the surface. corner_tiles: a hash chooses the patch of a torus
    that is read.

    Some are gated by what the scene holds: without emitting surfaces, opacity or maps there is nothing of them to compile.
    """

    shells: Effect
    surface_materials: Effect
    opacity: Effect
    twin: Effect
    direct_light: Effect
    environment: Effect
    area_light: Effect
    background: Effect
    mesh_shadow: Effect
    object_shadow: Effect
    shell_shadow: Effect
    bounces: Effect
    roulette: Effect
    quadrature: Effect
    camera_in_shell: Effect
    baked_density: Effect
    filtering: Effect
    anisotropic_filtering: Effect
    varying_parameters: Effect
    varying_geometry: Effect
    corner_tiles: Effect

    def as_dict(self) -> dict[str, dict[str, object]]:
        return {name: {"on": e.on, "why": e.why} for name, e in vars(self).items()}

    def __str__(self) -> str:
        """One line an effect: whether it is compiled, and why."""
        effects = vars(self).items()
        return "\n".join(f"{'on ' if e.on else 'off'} {name.replace('_', ' ')}: {e.why}" for name, e in effects)


@dataclass(frozen=True)
class Engine:
    """can: the effects that it can compute. draws: it draws a collision where it need not sum all samples of a ray."""

    name: str
    can: frozenset[str]
    draws: bool = False


_MARCHED = (
    "shells twin direct_light environment background mesh_shadow object_shadow quadrature camera_in_shell baked_density "
    "filtering anisotropic_filtering varying_parameters varying_geometry corner_tiles"
)
_QUERIED = "surface_materials opacity twin direct_light environment background mesh_shadow object_shadow"
#: Shells marched in JAX; meshes with a surface material, in JAX; paths in Mitsuba.
MARCH = Engine("jax", frozenset(_MARCHED.split()))
SURFACE = Engine("jax", frozenset(_QUERIED.split()))
PATHS = Engine("mitsuba", frozenset(f.name for f in fields(Effects)), draws=True)


def plan_effects(facts: Facts, quality: Quality, engine: Engine = MARCH) -> Effects:
    """Decide each effect."""
    reached = not engine.draws or quality.max_depth > 1
    called = _light(facts, reached) | _detail(facts)
    bounces = _bounces(facts, quality, engine)
    called |= {"bounces": bounces, "roulette": _roulette(quality, engine, bounces.on)}
    called["quadrature"] = _quadrature(facts, engine, reached and not bounces.on)
    called["baked_density"] = _baked(facts, quality, engine, called["quadrature"].on)
    called["filtering"] = _filtering(facts, quality, called, engine)
    called["anisotropic_filtering"] = Effect(
        called["filtering"].on and quality.anisotropy > 1,
        f"{quality.anisotropy} taps by quality" if called["filtering"].on else "nothing is filtered",
    )
    called["twin"] = plan_twin(facts.twin, quality)
    return Effects(**{name: _if_it_can(name, effect, engine) for name, effect in called.items()})


def _if_it_can(name: str, effect: Effect, engine: Engine) -> Effect:
    if not effect.on or name in engine.can:
        return effect
    return Effect(False, f"{effect.why}; engine {engine.name} cannot, engine mitsuba can", missing=True)


def left_out(effects: Effects) -> tuple[str, ...]:
    """Notes on effects that the engine cannot compute, a line each. Missing shell shadows get no note, only their reason: they
    are less visible."""
    bounces = effects.bounces
    return (f"bounces are left out: {bounces.why}",) if bounces.missing else ()


def twin_reach(errors: tuple[tuple[float, float], ...], bound: float) -> float:
    """The least footprint, patches, from which on no error exceeds the bound; infinite if there is no such footprint."""
    reach = float("inf")
    for radius, error in reversed(errors):
        if error > bound:
            break
        reach = radius
    return reach


def plan_twin(twin: TwinFacts | None, quality: Quality) -> Effect:
    """Whether a distilled surface material stands in for the shell, in either engine."""
    if twin is None:
        return Effect(False, NO_TWIN)
    if quality.twin == 0:
        return Effect(False, BY_QUALITY)
    if twin.misfit:
        return Effect(False, f"the distilled twin is of another shell: {twin.misfit}")
    reach = twin_reach(twin.errors, quality.twin)
    if reach == float("inf"):
        return Effect(False, f"it looks {twin.errors[-1][1]:.3f} FLIP different from afar, above {quality.twin:g}")
    least = f"from {reach:.2g} on it looks {quality.twin:g} FLIP different at most"
    why = f"footprints begin at {twin.finest:.2g} patches; {least}"
    return Effect(twin.finest >= reach, why)


def _either(on: bool, why: str, why_not: str) -> Effect:
    return Effect(on, why if on else why_not)


def _light(f: Facts, reached: bool) -> dict[str, Effect]:
    """Emitters, and what blocks their light. reached: paths are long enough for an event."""
    kinds = ((f.distant, "distant"), (f.point, "point"), (f.area, "area"), (int(f.environment), "environment"))
    emitters = "emitters: " + (", ".join(f"{n} {kind}" for n, kind in kinds if n) or "none")
    dark = "there is no light"
    others = f"{f.objects} other {'surfaces' if f.objects > 1 else 'surface'}" if f.objects else "no other surfaces"
    self_shadow = f.lit and f.shells + f.surfaces > 0 and (not f.convex or f.low)
    several = f.shells + f.surfaces > 1
    shadowing = "a mesh may stand in another's light" if several else "the mesh is not convex"
    shadowing = "light may come from below the horizon of a face" if f.convex else shadowing
    return {
        "direct_light": Effect(
            f.lit and reached, emitters if reached or not f.lit else "paths end before their first event"
        ),
        "environment": _either(f.environment, "an environment was given", "no environment"),
        "area_light": _either(f.area > 0, f"rays may meet {f.area} emitters", "no emitter nearby that a ray can meet"),
        "background": _either(
            f.environment and f.seen, "rays that leave the scene see the environment", "the background is transparent"
        ),
        "mesh_shadow": _either(
            self_shadow, shadowing, "the mesh is convex: it cannot shadow itself beyond the horizon" if f.lit else dark
        ),
        "object_shadow": Effect(f.lit and f.objects > 0, others if f.lit else dark),
        "shell_shadow": _either(
            f.lit and f.shells > 0 and not f.alone,
            "light may cross shells on its way",
            dark if not f.lit else "no shells" if not f.shells else "one shell, on a convex mesh: light leaves it once",
        ),
    }


def _detail(f: Facts) -> dict[str, Effect]:
    """Shells, surface materials and what they look up."""
    varying = ", ".join(f.varying)
    return {
        "shells": _either(
            f.shells > 0, f"rays are marched through {f.shells} {'shells' if f.shells > 1 else 'shell'}", "no shells"
        ),
        "surface_materials": _either(f.surfaces > 0, f"on {f.surfaces} of the meshes", "no mesh has one"),
        "opacity": _either(
            f.passable,
            "rays may pass a silhouette, and go on behind",
            "the surface material is opaque" if f.surfaces else "no mesh has a surface material",
        ),
        "camera_in_shell": _either(
            f.inside, "a camera may be within the shells' bounds", "cameras are outside all shells"
        ),
        "varying_parameters": _either(bool(varying), f"maps for {varying}", "every parameter is one number"),
        "varying_geometry": _either(f.shaped, "the texture holds geometry that varies", "geometry does not vary"),
        "corner_tiles": _either(f.tiled, "the texture is sixteen tiles, laid by a hash", "no texture is of tiles"),
    }


def _bounces(f: Facts, quality: Quality, engine: Engine) -> Effect:
    """Bounces, where the scene gives them light to add. An engine without paths leaves them out, and says so where that is
    visible."""
    share = f"surfaces meet surfaces in {f.enclosed:.0%} of directions"
    if not f.lit:
        return Effect(False, "there is no light")
    if f.alone and not f.objects and f.ground <= quality.dark_ground:
        return Effect(False, "one shell, on a convex mesh and dark ground: there is little to bounce from")
    if not engine.draws:
        return _either(f.enclosed > ENCLOSED, share, f"{share}: little light goes from one to another")
    if quality.max_depth <= 2:
        return Effect(False, f"max_depth is {quality.max_depth}: paths end at their first event")
    return Effect(True, "light may go from one surface, or shell, to another")


def _roulette(quality: Quality, engine: Engine, bounces: bool) -> Effect:
    if not (engine.draws and bounces):
        return Effect(False, "no paths are drawn" if not engine.draws else "paths are short")
    if quality.max_depth <= quality.rr_depth:
        return Effect(False, f"paths end at length {quality.max_depth}")
    return Effect(True, f"paths end by chance from length {quality.rr_depth} on")


def _quadrature(f: Facts, engine: Engine, one_event: bool) -> Effect:
    if not f.shells:
        return Effect(False, "no shells")
    if not engine.draws:
        return Effect(True, "all samples of a ray are summed")
    sums = f.alone and one_event and f.distant > 0 and not (f.point or f.area or f.environment)
    return _either(
        sums,
        "distant lights, one event: all samples of a ray are summed, with little noise",
        "paths go on, or light is not distant alone: collisions are drawn" if f.lit else "there is no light",
    )


def _baked(f: Facts, quality: Quality, engine: Engine, sums: bool) -> Effect:
    if not f.shells:
        return Effect(False, "no shells")
    if (engine.draws and sums) or (not engine.draws and quality.light_samples == 0):
        return Effect(False, "samples that are all lit need the network's features")
    if not engine.draws and f.coarsest > MAX_TEXELS:
        return Effect(False, f"footprints reach {f.coarsest:.3g} texels, which few rays do not average")
    if not engine.draws and f.baked > MAX_NUMBERS * f.pixels * quality.samples:
        return Effect(False, f"grids of {f.baked / 1e6:.2g} million numbers would take longer than the picture")
    if f.baked > MAX_BAKED:
        return Effect(False, f"grids would hold {f.baked / 1e6:.0f} million numbers, above {MAX_BAKED / 1e6:.0f}")
    if f.magnified == float("inf"):
        return Effect(False, "how near a camera sees its columns is not known")
    if f.magnified == 0:
        return Effect(False, "no camera sees a surface")
    if f.magnified > MAX_MAGNIFIED:
        return Effect(False, f"nearby, a column of its grid is {f.magnified:.3g} times as wide as a pixel's footprint")
    if quality.density == "network":
        return Effect(False, BY_QUALITY)
    return Effect(
        True,
        f"from {f.baked / 1e6:.2g} million numbers; nearby, a column is {f.magnified:.2g} times as wide as a footprint",
    )


def _filtering(f: Facts, quality: Quality, called: dict[str, Effect], engine: Engine) -> Effect:
    if not f.shells:
        return Effect(False, "no shells")
    if not quality.filtering:
        return Effect(False, BY_QUALITY)
    if called["baked_density"].on:
        return Effect(False, "density is baked: what a pixel's rays average is not filtered")
    opens = engine.draws and (called["bounces"].on or f.area > 0 or f.environment)
    if opens:
        return Effect(True, "footprints open at an event")
    coarsest = quality.footprint * f.coarsest if quality.footprint else 0.0
    if coarsest > 1:
        return Effect(True, f"footprints reach {coarsest:.1f} texels")
    if quality.anisotropy > 1:
        return Effect(True, "taps lie along footprints, whose long side has no bound")
    if not f.alone or quality.spacing == "interval":
        return Effect(True, "how far apart samples lie in height has no bound")
    apart = (1 if quality.spacing == "length" else WIDEST) / quality.samples
    spaced = 2 * f.rows * quality.height_filter * apart / 3**0.5  # a ray goes down and comes up again at most
    if spaced > 1:
        return Effect(True, f"heights are averaged over up to {spaced:.1f} rows of the height feature")
    return Effect(False, f"footprints reach {coarsest:.2g} texels at most: the finest level everywhere")
