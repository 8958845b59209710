"""The grass recipe's leaf in Mitsuba: a thin sheet that reflects, lets light through and shines a little (data_gen/grass).

Notation
R, T        diffuse reflectance and transmittance, textures `reflect` and `transmit` (mesh attributes are wrong in instances)
g           share of the shine, GGX without colour
wi, wo      toward the viewer and toward the light, local; an upper sign is that of the side which is seen

f cos = (1 − g) (R or T) |cos| / π + g f_GGX cos on the side of wi.
"""

import mesoshell.pathtracer  # noqa: F401  (names a libLLVM that works, before Mitsuba is imported)
from data_gen.grass import GLOSS, ROUGHNESS

import drjit as dr  # isort: skip
import mitsuba as mi  # isort: skip


class Leaf(mi.BSDF):
    def __init__(self, props):
        super().__init__(props)
        self.reflect, self.transmit = props["reflect"], props["transmit"]
        self.shine = mi.load_dict({"type": "roughconductor", "distribution": "ggx", "alpha": ROUGHNESS**2})
        sides = mi.BSDFFlags.FrontSide | mi.BSDFFlags.BackSide
        diffuse = mi.BSDFFlags.DiffuseReflection | mi.BSDFFlags.DiffuseTransmission
        self.m_components = [diffuse | sides, mi.BSDFFlags.GlossyReflection | sides]
        self.m_flags = self.m_components[0] | self.m_components[1]

    def sample(self, ctx, si, sample1, sample2, active=True):
        up = self._upward(si)
        shines = active & (sample1 < GLOSS)
        glossy, _ = self.shine.sample(ctx, up, sample1 / GLOSS, sample2, shines)
        through = self._through(si, active)
        diffuse = mi.warp.square_to_cosine_hemisphere(sample2)
        diffuse.z = dr.select((sample1 - GLOSS) / (1 - GLOSS) < through, -diffuse.z, diffuse.z)
        wo = dr.select(shines, glossy.wo, diffuse)
        wo.z = dr.mulsign(wo.z, si.wi.z)
        bs = dr.zeros(mi.BSDFSample3f)
        value, bs.pdf = self.eval_pdf(ctx, si, wo, active)
        bs.wo, bs.eta = wo, mi.Float(1)
        bs.sampled_type = mi.UInt32(+mi.BSDFFlags.DiffuseReflection)
        good = active & (bs.pdf > 0)
        return bs, dr.select(good, value / dr.select(good, bs.pdf, 1), 0)

    def eval(self, ctx, si, wo, active=True):
        return self.eval_pdf(ctx, si, wo, active)[0]

    def pdf(self, ctx, si, wo, active=True):
        return self.eval_pdf(ctx, si, wo, active)[1]

    def eval_pdf(self, ctx, si, wo, active=True):
        reflect, transmit = self.reflect.eval(si, active), self.transmit.eval(si, active)
        same = wo.z * si.wi.z > 0
        shine, p = self.shine.eval_pdf(ctx, self._upward(si), mi.Vector3f(wo.x, wo.y, dr.abs(wo.z)), active & same)
        cosine = dr.abs(wo.z) * dr.inv_pi
        through = self._through(si, active)
        value = (1 - GLOSS) * cosine * dr.select(same, reflect, transmit) + GLOSS * dr.select(same, shine, 0)
        pdf = (1 - GLOSS) * cosine * dr.select(same, 1 - through, through) + GLOSS * dr.select(same, p, 0)
        return dr.select(active, mi.Color3f(value), 0), dr.select(active, pdf, 0)

    def _through(self, si, active):
        """Share of diffuse directions that are drawn on the far side."""
        r, t = (dr.mean(texture.eval(si, active)) for texture in (self.reflect, self.transmit))
        return t / dr.maximum(r + t, 1e-6)

    def _upward(self, si):
        up = mi.SurfaceInteraction3f(si)
        up.wi = mi.Vector3f(si.wi.x, si.wi.y, dr.abs(si.wi.z))
        return up

    def to_string(self):
        return "Leaf[]"


def register() -> None:
    mi.register_bsdf("grass_leaf", Leaf)
