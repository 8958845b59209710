"""Array aliases and the project's notation (imports nothing of ours).

symbol     meaning                                                        shape, unit, frame
o, d, t    ray origin, unit direction, distance                           (3,), world
ξ          shell coordinate (u, v, h): texture u, v in patches, height    (3,), canonical; h in [0, 1]
J          Jacobian ∂P/∂ξ of a prism's map                                (3, 3), world / canonical
ω, ω′      unit directions toward the viewer and toward the light         (3,), canonical
F          feature texture F(u, v) plus height feature F(h)               (C,)
α          appearance parameters, normalised by their declared range      (A,), each in [0, 1]
σ          extinction                                                     1 / canonical length, ≥ 0
E⊥         irradiance of a distant light on the plane facing it           RGB
ρ          transport L / E⊥                                               RGB, 1/sr, linear Rec. 709
τ, T       optical depth and transmittance exp(−τ)
r          filter radius: one standard deviation of the footprint         patches

Shapes are jaxtyping annotations, checked with beartype under pytest only.
NumPy-only files take `Float`, `Int`, … from jaxtyping directly: the aliases below load JAX.
"""

from jaxtyping import Array, Bool, Float, Int, Key

#: Scalars and vectors of a function that works on one ray or one point.
Scalar = Float[Array, ""]
Vec2 = Float[Array, "2"]
Vec3 = Float[Array, "3"]
Mat3 = Float[Array, "3 3"]
Index = Int[Array, ""]
Flag = Bool[Array, ""]

__all__ = ["Array", "Bool", "Flag", "Float", "Index", "Int", "Key", "Mat3", "Scalar", "Vec2", "Vec3"]
