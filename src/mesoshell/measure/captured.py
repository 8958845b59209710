"""How well a captured object predicts held-out views, and how evenly its surface is mapped to its texture.

Notation
PSNR, SSIM   of sRGB values, over whole photographs with a black background (the paper's table 1)
cycle        |F_uv⁻¹(F_uv(y)) − y| at the surface, root mean square, per cent of the box's side
y            where a pixel's ray meets the surface: at its mean distance, if its alpha is above 0.5

The texture is scored by the pixels of all photographs, at most SIDE of them a side: no view shows the rest.
"""

import jax
import numpy as np

from mesoshell.io.image import linear_to_srgb
from mesoshell.measure.distribution import Estimate, mean_with_interval
from mesoshell.measure.image import psnr, ssim
from mesoshell.measure.uv_distortion import chart
from mesoshell.nets.batches import run
from mesoshell.neutex.cameras import photo_rays, pixels
from mesoshell.neutex.capture import Capture, at_most
from mesoshell.neutex.field import to_surface, to_texture
from mesoshell.neutex.render import picture, view
from mesoshell.neutex.store import NeuTexModel
from mesoshell.render.quality import Quality
from mesoshell.train.neutex.ray_batches import held_out

SIDE = 64
#: Pixels a side that SSIM needs.
MIN_SIDE = 11
VIEWS = ("PSNR", "SSIM")
CHART = ("cycle error, % of the box", "texture distortion", "texture folded", "texture used")


def score_views(model: NeuTexModel, capture: Capture, samples: int) -> dict[str, Estimate]:
    """Means over held-out views with their intervals; scores of the texture have none."""
    how = view(model.config, model.field, Quality(samples=samples, pixel_samples=1))

    def shown(photo):
        return picture(model.config, model.field, model.to_box(photo), how)

    each = []
    for i in held_out(capture)[1]:
        a, b = (linear_to_srgb(np.clip(x, 0, 1)) for x in (shown(capture.photos[i]).rgba[..., :3], capture.rgb[i]))
        each.append((psnr(a, b), ssim(a, b)))
    scores: dict[str, Estimate] = dict(zip(VIEWS, mean_with_interval(np.array(each, np.float64)), strict=True))
    if model.config.colour == "volume":
        return scores
    numbers = _charted(model, at_most(capture, SIDE), shown)
    return scores | {name: Estimate(x, x, x) for name, x in zip(CHART, numbers, strict=True)}


def _charted(model: NeuTexModel, capture: Capture, shown) -> tuple[float, ...]:
    ys, us, hits, cycles = [], [], [], []
    for photo in capture.photos:
        rendered, (o, d) = shown(photo), photo_rays(model.to_box(photo), pixels(photo))
        alpha = rendered.rgba[..., 3]
        hit = alpha > 0.5
        far = (rendered.depth / np.maximum(alpha, 0.5)).reshape(-1, 1)
        y = (o + far * d).astype(np.float32)
        u, back = run(lambda y, n: _there(model.field, y), y)
        ys.append(y.reshape(*hit.shape, 3).astype(np.float64))
        us.append(u.reshape(*hit.shape, 3).astype(np.float64))
        hits.append(hit)
        cycles.append(np.sum((back - y) ** 2, axis=1)[hit.ravel()])
    error = np.concatenate(cycles)
    try:
        return 50 * float(np.sqrt(error.sum() / max(error.size, 1))), *chart(ys, us, hits)
    except ValueError:  # nothing is opaque yet
        return float("nan"), float("nan"), float("nan"), 0.0


@jax.jit
def _there(field, y):
    u = jax.vmap(lambda y: to_texture(field, y))(y)
    return u, jax.vmap(lambda u: to_surface(field, u))(u)
