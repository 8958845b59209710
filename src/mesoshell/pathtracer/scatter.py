"""Directions of scattering inside a shell, drawn in canonical space.

Notation
A           J⁻¹: ω′ = normalise(A d) of a world direction d
p_c         (z + f) / (π (1 + f)²) over canonical directions with z above −f = −FADE: ρ fades to 0 there, and so does p_c
p           density over world directions: p_c |det A| / |A d|³
"""

import drjit as dr
import mitsuba as mi

from mesoshell.io.bundle import FADE
from mesoshell.pathtracer.samples import canonical
from mesoshell.shell.geometry.extrude import FLATTEST


def draw(frame, xi):
    """A world direction, its canonical direction, and p. xi: two uniform numbers."""
    z = dr.sqrt(xi.x) * (1 + FADE) - FADE
    phi = 2 * dr.pi * xi.y
    r = dr.sqrt(dr.maximum(1 - z * z, 0))
    local = mi.Vector3f(r * dr.cos(phi), r * dr.sin(phi), z)
    # J maps canonical directions to the world; its columns are cross products of A's rows over their determinant
    volume = dr.dot(frame.a, dr.cross(frame.b, frame.c))
    columns = dr.cross(frame.b, frame.c), dr.cross(frame.c, frame.a), dr.cross(frame.a, frame.b)
    d = local.x * columns[0] + local.y * columns[1] + local.z * columns[2]
    d = dr.normalize(dr.select(volume < 0, -d, d))
    return d, local, density(frame, d)


def density(frame, d):
    """p of a world direction."""
    volume = mi.Float(dr.abs(dr.dot(frame.a, dr.cross(frame.b, frame.c))))
    w = canonical(frame, d)
    length = mi.Float(dr.norm(w))
    z = w.z / length
    p = mi.Float(dr.maximum(z + FADE, 0)) / (dr.pi * (1 + FADE) ** 2)
    return dr.select(length > 0, p * volume / length**3, 0)


def exit_distance(frame, height, d, size):
    """Distance from h = height along d to the top of a locally flat shell, at a cosine of at least FLATTEST; 0 downward."""
    rate = dr.dot(frame.c, d)
    flattest = dr.maximum(FLATTEST * dr.norm(frame.c), 1e-30)
    return dr.select(rate > 0, dr.minimum((1 - height) / dr.maximum(rate, flattest), size), 0)
