"""The settings that trade accuracy for time, as fields of `Quality` (NumPy only; no JAX).

`draft` is for previews, `normal` for pictures, `reference` to measure the others against. Which fields affect a
picture depends on the engine and on what the scene calls for: `render/used`.
"""

from dataclasses import asdict, dataclass, field, fields, replace
from difflib import get_close_matches
from numbers import Integral, Real
from typing import Any, NamedTuple

#: A sample stands for at most so many times its even share of a ray, if `spacing` is "density".
WIDEST = 10
#: Share of a cell's bound that matter has on average, about: bounds are of the densest point, and leave a margin.
EXPECTED = 0.025
#: Samples of density: this share of them by the light that is expected to be lost, and by whether there may be anything.
LOST_SHARE, OCCUPIED_SHARE = 0.5, 0.5 - 1 / WIDEST
_WORDS = {int: "a whole number", float: "a number", bool: "true or false", str: "a word"}


class Setting(NamedTuple):
    """What a field of `Quality` does. bias: what its cheaper values do to the expected picture, "" if they only add noise;
    engine: the only one that uses it, "" for both; least, below: its range; words: its values, if they are words."""

    meaning: str
    bias: str = ""
    engine: str = ""
    least: float = 0
    below: float | None = None
    words: tuple[str, ...] = ()


def _setting(default: Any, meaning: str, bias: str = "", **more: Any) -> Any:
    """A field of `Quality`."""
    return field(default=default, metadata={"setting": Setting(meaning, bias, **more)})


@dataclass(frozen=True)
class Quality:
    """The settings of a render. Raises ValueError for a value out of range."""

    pixel_samples: int = _setting(2, "rays a pixel; more rays give smoother silhouettes", engine="jax", least=1)
    samples: int = _setting(
        28, "samples a ray, spread over all its intervals", "opacity of what is thinner than their distance", least=1
    )
    #: "interval" is the paper's.
    spacing: str = _setting(
        "density",
        "density: samples where the material's σ grid suggests that a ray loses its light; length: in proportion to length; "
        "interval: as many in each interval, by engine jax alone",
        "opacity, where samples are few",
        words=("density", "length", "interval"),
    )
    #: 1 is the paper's, which takes few samples for many heights: grass of 24 samples a ray was a fifth too bright.
    height_filter: float = _setting(
        0.4,
        "features are averaged over this share of the heights that a sample stands for",
        "colour and opacity: a network of averaged features is not the average of the network",
        below=2,
    )
    #: "interpolated" is the paper's.
    coordinates: str = _setting(
        "interpolated",
        "(u, v, h) linear between an interval's ends, or by the inverse of the prism's map",
        "places of blades in thick shells on curved meshes",
        words=("interpolated", "exact"),
    )
    early_stop: float = _setting(
        0.005, "transmittance below which a ray stops", "colour and alpha, by at most this", below=1
    )
    #: A sample is not decoded if the material's σ grid bounds it below its share of this, by length.
    skip: float = _setting(
        0.05,
        "optical depth that a ray may lose where empty space is skipped; with spacing=density a march loses none, and a path "
        "at most this much a patch",
        "alpha",
        below=1,
    )
    weight_cut: float = _setting(
        0.048,
        "samples of a weight below weight_cut / samples are not lit, so at most this share of a ray's opacity is unlit; with "
        "light_samples above 0, engine jax applies it to the ground only",
        "colour, by at most this share",
        below=1,
    )
    #: As with any estimate by few samples, pictures of many rays a pixel average it.
    light_samples: int = _setting(
        8,
        "expected number of lit samples a ray, drawn in proportion to their weights; more where the σ grid underestimates "
        "opacity; 0 lights every sample that weight_cut keeps",
        engine="jax",
    )
    density: str = _setting(
        "baked",
        "where density is from: baked, a grid of the finest texture level, unfiltered, where the scene and the picture's size "
        "allow it; network, the network, filtered if filtering is on",
        "edges that are sharper than half a texel",
        words=("baked", "network"),
    )
    filtering: bool = _setting(
        True,
        "filter features over the pixel's footprint; without it, distant surfaces are noisy",
        "distant surfaces: a network of averaged features is not the average of the network; a correction removes part of this",
    )
    #: 1 is the paper's. Rays that share a pixel show more of what is finer than it.
    footprint: float = _setting(
        0.5,
        "width of a shell's filter across a ray, in pixels (of a ray that scattered, in its cones); less is sharper, and "
        "noisier with few rays a pixel",
        "as filtering does",
        below=4,
    )
    #: 1 is the paper's r = min(a, b).
    anisotropy: int = _setting(
        2,
        "taps along the footprint's long axis; few leave noise where a surface is seen at a slant",
        "a little, as filtering does",
        least=1,
    )
    visibility: str = _setting(
        "interval",
        "where a light's visibility is tested: once an interval, or at every sample",
        "edges of shadows, by an interval's length",
        words=("interval", "sample"),
    )
    environment_samples: int = _setting(8, "directions a ray drawn from the environment", engine="jax", least=1)
    base_samples: int = _setting(
        8, "samples of the shell's shadow on the surface underneath", "the shadow's depth", engine="jax", least=1
    )
    #: A Mitsuba scene file sets its own number and depth.
    spp: int = _setting(48, "paths a pixel", engine="mitsuba", least=1)
    max_depth: int = _setting(
        8,
        "maximum number of segments of a path; 2 is direct light",
        "darker: light of later bounces",
        engine="mitsuba",
        least=1,
    )
    rr_depth: int = _setting(
        5, "length from which on paths end by chance (Russian roulette)", engine="mitsuba", least=1
    )
    #: At 0.1 dense grass loses 0.1% of its light, a shell that lets half of it through a few percent.
    dark_ground: float = _setting(
        0.1,
        "largest albedo of the ground at which light between it and one shell on a convex mesh is not traced",
        "darker: light between ground and shell",
        engine="mitsuba",
        below=1,
    )
    bounce_spread: float = _setting(
        0.25,
        "growth of a footprint where light scatters, relative to the cone of solid angle 1 / p about a direction drawn with "
        "density p; 0 keeps the camera's",
        "blurs what is seen indirectly",
        engine="mitsuba",
        below=1,
    )
    #: A just noticeable step of lightness (L* by 1) is 0.058, and draft allows two.
    twin: float = _setting(
        0.05,
        "mean FLIP up to which a distilled surface material may stand in for a march; 0: never",
        "all of the picture, by this much",
        below=1,
    )
    curvature_filter: str = _setting(
        "curve",
        "curvature for surface materials: the least on a curve through a hit along the ray, or that at the point; for "
        "comparison: the mean of all directions, or the curve's, unscaled by the period",
        "silhouettes of curved meshes",
        words=("curve", "point", "mean", "unscaled"),
    )
    curve_length: float = _setting(
        0.5,
        "length of that curve, periods of the texture",
        "silhouettes, where curvature changes fast",
        below=float("inf"),
    )

    def __post_init__(self) -> None:
        given = {name: getattr(self, name) for name in SETTINGS}
        wrong = [f"{k} {fault}" for k, x in given.items() if (fault := wrong_kind(k, x) or out_of_range(k, x))]
        if wrong:
            raise ValueError("; ".join(wrong))

    @property
    def least_weight(self) -> float:
        """Least weight of a lit sample: a ray of `samples` leaves at most `weight_cut` unlit."""
        return self.weight_cut / self.samples

    def with_changes(self, **changes: object) -> "Quality":
        return replace(self, **changes)  # type: ignore[arg-type]

    def as_dict(self) -> dict[str, object]:
        return asdict(self)


SETTINGS: dict[str, Setting] = {field.name: field.metadata["setting"] for field in fields(Quality)}


def unknown(name: str) -> str:
    """How a name is that of no field; "" if it is one's."""
    if name in SETTINGS:
        return ""
    near = get_close_matches(name, SETTINGS, 1)
    return "is no field of Quality" + (f"; did you mean {near[0]}?" if near else "")


def kind_of(name: str) -> type:
    """The type of a field's values."""
    return type(getattr(Quality, name))


def wrong_kind(name: str, value: object) -> str:
    """How a value is not of its field's type; "" if it is."""
    kind = kind_of(name)
    fits = isinstance(value, {int: Integral, float: Real}.get(kind, kind))
    return "" if fits and isinstance(value, bool) == (kind is bool) else f"must be {_WORDS[kind]}, not {value!r}"


def out_of_range(name: str, value: Any) -> str:
    """How a value of the right type lies out of its field's range; "" if it does not."""
    setting = SETTINGS[name]
    if setting.words:
        return "" if value in setting.words else f"must be one of {', '.join(setting.words)}"
    if setting.below is None:
        return "" if value >= setting.least else f"must be at least {setting.least}"
    return "" if setting.least <= value < setting.below else f"must lie in {range_of(name)}"


def range_of(name: str) -> str:
    """The values that a field may have, in words."""
    setting = SETTINGS[name]
    if kind_of(name) is bool:
        return "true or false"
    if setting.words:
        return ", ".join(setting.words)
    return f"{setting.least} or more" if setting.below is None else f"[{setting.least}, {setting.below:g})"


PRESETS = {
    "draft": Quality(
        pixel_samples=1,
        samples=10,
        height_filter=0.3,
        light_samples=4,
        early_stop=0.05,
        footprint=0.7,
        anisotropy=1,
        environment_samples=2,
        base_samples=4,
        spp=16,
        max_depth=4,
        twin=0.1,
    ),
    "normal": Quality(),
    "reference": Quality(
        pixel_samples=32,
        samples=256,
        spacing="length",
        light_samples=0,
        coordinates="exact",
        early_stop=0.0,
        skip=0.0,
        weight_cut=0.0,
        density="network",
        filtering=False,
        footprint=0.25,  # this and the taps are for `filtering=True`
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
