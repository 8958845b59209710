"""The settings that a tradeoff varies, and their values in order, mostly from cheap to accurate.

The number of samples a pixel is no knob: a point has an error for each number. Of spacings, both engines have these two.
"""

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from mesoshell.render.quality import PRESETS, SETTINGS, Quality

VALUES: dict[str, tuple[Any, ...]] = {
    "samples": (7, 10, 14, 20, 28, 40, 56, 80, 112, 160, 256),
    "spacing": ("length", "density"),
    "height_filter": (1.0, 0.6, 0.4, 0.3, 0.2, 0.0),
    "coordinates": ("interpolated", "exact"),
    "early_stop": (0.1, 0.05, 0.02, 0.01, 0.005, 0.0),
    "skip": (0.2, 0.1, 0.05, 0.02, 0.0),
    "weight_cut": (0.2, 0.1, 0.048, 0.02, 0.0),
    "light_samples": (1, 2, 4, 6, 8, 0),
    "density": ("baked", "network"),
    "filtering": (True, False),
    "footprint": (1.4, 1.0, 0.7, 0.5, 0.35, 0.25),
    "anisotropy": (1, 2, 4, 8, 16),
    "visibility": ("interval", "sample"),
    "environment_samples": (1, 2, 4, 8, 16),
    "base_samples": (2, 4, 8, 16, 32),
    "max_depth": (2, 3, 4, 6, 8, 12, 16, 64),
    "rr_depth": (2, 3, 5, 8, 16, 64),
    "dark_ground": (0.5, 0.1, 0.0),
    "bounce_spread": (0.5, 0.25, 0.1, 0.0),
    "twin": (0.1, 0.05, 0.0),
    "curvature_filter": ("point", "curve"),
    "curve_length": (0.25, 0.5, 1.0),
}
#: Fields that change what is prepared, and not only how it is rendered; and those that do nothing without a filter, which a
#: baked density has not.
OF_SETUP, OF_FILTER = ("twin", "curvature_filter", "curve_length"), ("height_filter", "footprint", "anisotropy")

Settings = Mapping[str, Any]


def knobs_of(used: Iterable[str], fixed: Iterable[str] = ()) -> tuple[str, ...]:
    """The knobs that a picture depends on, in the order of VALUES. fixed: those that the scene sets itself."""
    return tuple(name for name in VALUES if name in set(used) - set(fixed))


def settings_of(quality: Quality, names: Iterable[str]) -> dict[str, Any]:
    """Values of the knobs."""
    return {name: getattr(quality, name) for name in names}


def noise_of(quality: Quality, names: Iterable[str]) -> dict[str, Any]:
    """Values of the knobs whose cheaper values only add noise."""
    return settings_of(quality, (name for name in names if not SETTINGS[name].bias))


def changes(settings: Settings) -> dict[str, Any]:
    """What differs from `normal`: what `--set` is given."""
    idle = _unfiltered(settings)
    return {k: x for k, x in settings.items() if x != getattr(PRESETS["normal"], k) and k not in idle}


def describe_changes(settings: Settings) -> str:
    """The changes in words; `normal` if there are none."""
    return ", ".join(f"{name} {value}" for name, value in changes(settings).items()) or "normal"


def neighbours(settings: Settings, distance: int = 1) -> Iterator[dict[str, Any]]:
    """Settings of which one knob has the next value but `distance` − 1, cheaper ones last. What does nothing without a filter
    does not vary there, and is `reference`'s; nor does it where density is baked."""
    idle = ("filtering", *OF_FILTER) if settings.get("density") == "baked" else _unfiltered(settings)
    for step in (distance, -distance):
        for name, value in settings.items():
            at = VALUES[name].index(value) + step
            if 0 <= at < len(VALUES[name]) and name not in idle:
                other = {**settings, name: VALUES[name][at]}
                yield other | {k: getattr(PRESETS["reference"], k) for k in _unfiltered(other) if k in other}


def _unfiltered(settings: Settings) -> tuple[str, ...]:
    """The knobs that do nothing without a filter, where there is none."""
    return () if settings.get("filtering", True) else OF_FILTER
