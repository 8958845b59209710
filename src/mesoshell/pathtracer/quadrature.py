"""Samples on a ray through all shells: where a march evaluates the material, and how much of the ray each stands for.

A march stops at each sample that may not be empty; the network is compiled once, where `seek` returns.
"""

from mesoshell.pathtracer import density_spacing, length_spacing


def begin(context, ray, shift=0.5):
    """A ray at its start. shift: in [0, 1), the middle, or drawn, so that undersampling shows as noise and not as a pattern."""
    return _spacing(context).begin(ray, shift)


def seek(context, ray, s):
    """The state after the next sample that may not be empty, that sample, and whether there is one."""
    return _spacing(context).seek(context, ray, s)


def _spacing(context):
    return {"density": density_spacing, "length": length_spacing}[context.quality.spacing]
