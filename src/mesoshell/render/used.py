"""Which fields of a quality affected a picture, for its report (NumPy only; no JAX)."""

from mesoshell.render.effects import BY_QUALITY, NO_TWIN, Effects, Engine
from mesoshell.render.quality import Quality


def quality_used(quality: Quality, effects: Effects, engine: Engine) -> dict[str, object]:
    """Fields that affect a picture with these effects by this engine, with their values."""
    shells, surfaces, paths, sums = effects.shells.on, effects.surface_materials.on, engine.draws, effects.quadrature.on
    lit, opens = effects.direct_light.on, effects.bounces.on or effects.area_light.on or effects.environment.on
    applies = {
        "pixel_samples": not paths,
        "samples": shells,
        "spacing": shells,
        "height_filter": effects.filtering.on,
        "coordinates": shells,
        "early_stop": shells or not paths,
        "skip": shells and (paths or quality.spacing != "density"),
        "weight_cut": sums and lit,
        "light_samples": shells and lit and not paths,
        "density": effects.baked_density.on or effects.baked_density.why == BY_QUALITY,
        "filtering": shells and not effects.baked_density.on,
        "footprint": effects.filtering.on,
        "anisotropy": effects.filtering.on,
        "visibility": sums and lit and (effects.mesh_shadow.on or effects.object_shadow.on),
        "environment_samples": effects.environment.on and not paths,
        "base_samples": shells and lit and not paths,
        "spp": paths,
        "max_depth": paths and (effects.bounces.on or quality.max_depth <= 2),
        "rr_depth": effects.roulette.on,
        "dark_ground": paths and shells,
        "bounce_spread": paths and lit and opens and (effects.filtering.on or surfaces),
        "twin": effects.twin.why != NO_TWIN,
        "curvature_filter": surfaces,
        "curve_length": surfaces and quality.curvature_filter in ("curve", "unscaled"),
    }
    return {name: value for name, value in quality.as_dict().items() if applies[name]}
