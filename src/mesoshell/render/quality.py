"""The settings that trade accuracy for time, as fields of `Quality` (NumPy only; no JAX).

`draft` is for previews, `normal` for pictures, `reference` to measure the others against. Which fields affect a
picture depends on the engine and on what the scene calls for: `render/used`.
"""

from dataclasses import asdict, dataclass, replace

SPACINGS = ("length", "interval")
COORDINATES = ("interpolated", "exact")
VISIBILITIES = ("interval", "sample")
CURVATURE_FILTERS = ("curve", "point", "mean", "unscaled")
_PATHS = ("spp", "max_depth", "rr_depth")


@dataclass(frozen=True)
class Quality:
    """The settings of a render. Raises ValueError for a value out of range."""

    #: Rays a pixel where rays are marched: what smooths silhouettes (inside them, filtering does).
    pixel_samples: int = 4
    #: Samples a ray, spread over all its intervals.
    samples: int = 48
    #: "length": samples in proportion to canonical length; "interval": the same number in each interval (the paper).
    spacing: str = "length"
    #: "interpolated": (u, v, h) linear between an interval's ends (the paper); "exact": the inverse of the prism's map.
    coordinates: str = "interpolated"
    #: A ray stops once its transmittance is below this, which bounds the error of its colour and alpha.
    early_stop: float = 0.01
    #: Optical depth that a ray may lose to skipping: a sample is not decoded if the material's σ grid bounds it below its
    #: share of this, by length.
    skip: float = 0.05
    #: Opacity that a ray may leave unlit: skip lighting for samples with weight below weight_cut / samples.
    weight_cut: float = 0.048
    #: Features are filtered over the pixel's footprint.
    filtering: bool = True
    #: Taps along the footprint's long axis; 1 is the paper's r = min(a, b).
    anisotropy: int = 1
    #: Where visibility of a light is tested: once an "interval", or at every "sample".
    visibility: str = "interval"
    #: Directions a ray drawn from the environment.
    environment_samples: int = 4
    #: Samples of the shell's shadow on the surface underneath.
    base_samples: int = 8
    #: Paths a pixel, in path tracing. A Mitsuba scene file sets its own number and depth.
    spp: int = 64
    #: Segments of a path at most: 2 is light straight from its sources.
    max_depth: int = 8
    #: Length from which on paths end by chance (Russian roulette): no bias, but noise.
    rr_depth: int = 5
    #: In path tracing, albedo of the ground up to which one shell on a convex mesh is not traced for light between the two: at
    #: 0.1 dense grass loses 0.1% of its light, a shell that lets half of it through a few percent.
    dark_ground: float = 0.1
    #: In path tracing, how wide footprints open at an event, relative to the radius of the circle of solid angle 1 / p for a
    #: direction drawn with density p. 0 keeps the camera's cone; larger values blur what is seen indirectly.
    bounce_spread: float = 0.25
    #: Mean FLIP up to which a distilled surface material may stand in for a march; 0 is never. A just noticeable step of
    #: lightness (L* by 1) is 0.058, and draft allows two.
    twin: float = 0.05
    #: Curvature for surface materials: the least on a "curve" through a hit along the ray, or that at the "point". For
    #: comparison: the "mean" of all directions, or the curve's value "unscaled", as if a period were one unit long.
    curvature_filter: str = "curve"
    #: Length of that curve, periods of the texture.
    curve_length: float = 0.5

    def __post_init__(self) -> None:
        counts = ("pixel_samples", "samples", "anisotropy", "environment_samples", "base_samples", *_PATHS)
        wrong = [f"{n} must be at least 1" for n in counts if getattr(self, n) < 1]
        bounded = ("early_stop", "skip", "weight_cut", "dark_ground", "bounce_spread", "twin")
        wrong += [f"{n} must lie in [0, 1)" for n in bounded if not 0 <= getattr(self, n) < 1]
        for name, allowed in (
            ("spacing", SPACINGS),
            ("coordinates", COORDINATES),
            ("visibility", VISIBILITIES),
            ("curvature_filter", CURVATURE_FILTERS),
        ):
            if getattr(self, name) not in allowed:
                wrong.append(f"{name} must be one of {', '.join(allowed)}")
        if not 0 <= self.curve_length < float("inf"):
            wrong.append("curve_length must be finite and not negative")
        if wrong:
            raise ValueError("; ".join(wrong))

    @property
    def least_weight(self) -> float:
        """Least weight of a lit sample: whatever their number, a ray leaves at most `weight_cut` unlit."""
        return self.weight_cut / self.samples

    def with_changes(self, **changes: object) -> "Quality":
        return replace(self, **changes)  # type: ignore[arg-type]

    def as_dict(self) -> dict[str, object]:
        return asdict(self)


PRESETS = {
    "draft": Quality(
        pixel_samples=1,
        samples=24,
        early_stop=0.05,
        environment_samples=2,
        base_samples=4,
        spp=16,
        max_depth=4,
        twin=0.1,
    ),
    "normal": Quality(),
    "reference": Quality(
        pixel_samples=16,
        samples=256,
        coordinates="exact",
        early_stop=0.0,
        skip=0.0,
        weight_cut=0.0,
        anisotropy=16,
        visibility="sample",
        environment_samples=16,
        base_samples=32,
        spp=512,
        max_depth=64,
        rr_depth=64,
        dark_ground=0.0,
        bounce_spread=0.0,
        twin=0.0,
    ),
}
