"""One training step: pictures of random textures, and both players' updates (MesoGAN, section 5.1).

Notation
B            pictures, and renders, a step
y            what the discriminator sees: 2x/(1 + x) − 1, and 2a − 1 of mean opacity a if asked to   (B, S, S, 3 or 4)
f            what it judges of y (discriminators.py)                               a tree of (B, h, w, C)
c, c′        labels of the renders, and of the pictures                           (B, L)
c″           of the renders, with the parameters of the next one                  (B, L)
across       means over devices, and all devices' rows (train/update); trivial where arrays are global

Both players learn from one forward pass of the generator: its pictures are judged once for its own gradient, and, held fixed,
once for the discriminator's. R1 is an update of its own every `r1_every` steps, in f's type whatever the precision.
With `mismatch`, the discriminator also learns to reject renders with wrong parameters (Reed et al., "Generative adversarial
text to image synthesis", 2016, section 4.2).
"""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from mesoshell.shell.generator.generator import Averages
from mesoshell.train.gan.discriminators import kind_of
from mesoshell.train.gan.generate import GeneratorStats, ImageBatch, conditions, generate, label
from mesoshell.train.gan.regularise import blur
from mesoshell.train.gan.state import GanConfig, Learner, TrainState, optimisers
from mesoshell.train.losses import discriminator_loss, fake_loss, generator_loss, r1
from mesoshell.train.patch_renderer import discriminator_range
from mesoshell.train.update import HERE, Across, apply_gradient, not_finite
from mesoshell.typing import Array, Bool, Float, Scalar

#: Pixels along a square in which opacity is seen.
COVER = 4
#: Half-life of the average magnitude, images; share of the mean of w that each step keeps.
MAGNITUDE_HALF_LIFE, W_KEEP = 20_000.0, 0.998
#: Half-life of the weight average: this many images, or this share of those seen, whichever is less.
AVERAGE_IMAGES, AVERAGE_SHARE = 10_000.0, 0.05


class GanReport(NamedTuple):
    """Losses, mean logits, and which leaves of the gradients (learner's, then discriminator's) are not finite. r1: r1_every
    times R1 in steps where it is due, else 0, so that its mean over steps is R1."""

    generator: Scalar
    discriminator: Scalar
    r1: Scalar
    real: Scalar
    fake: Scalar
    bad: Bool[Array, "_leaves"]


def step(
    config: GanConfig, state: TrainState, batch: ImageBatch, across: Across = HERE
) -> tuple[TrainState, GanReport]:
    """Both updates, R1 if it is due, and the averages. Pure."""
    wanted = conditions(config, batch)
    c, c_fake, sharp = label(batch), label(wanted), seen(config, batch.image)
    for_learner, for_discriminator = optimisers(config)
    kind = kind_of(config.discriminator)
    s = config.blur * jnp.maximum(1 - state.images.astype(sharp.dtype) / (1000 * config.blur_kimg), 0)

    def perceived(y: Array) -> Any:
        return kind.perceive(blur(y, s, config.blur) if config.blur else y)

    real = perceived(sharp)

    def judged(discriminator: Any, f: Any, c: Array) -> Array:
        return kind.judge(discriminator, f, c, across.everyone, config.precision)

    def make(learner: Learner) -> tuple[tuple[Any, Scalar], GeneratorStats]:
        pictures, stats = generate(config, learner, state.averages, wanted, across.each)
        return (perceived(seen(config, pictures)), stats.roughness), stats

    (fake, _), back, stats = jax.vjp(make, state.learner, has_aux=True)

    def fooled(f: Any) -> tuple[Scalar, Scalar]:
        logits = judged(state.discriminator, f, c_fake)
        return generator_loss(logits), jnp.mean(logits)

    def discriminated(discriminator: Any) -> tuple[Scalar, Scalar]:
        logits = judged(discriminator, real, c)
        loss = discriminator_loss(logits, judged(discriminator, fake, c_fake))
        if config.mismatch:
            loss += config.mismatch * fake_loss(judged(discriminator, real, label(_mismatched(batch, across))))
        return loss, jnp.mean(logits)

    (g_loss, fake_logit), by_seen = jax.value_and_grad(fooled, has_aux=True)(fake)
    (d_loss, real_logit), d_gradient = jax.value_and_grad(discriminated, has_aux=True)(state.discriminator)
    (g_gradient,) = back((by_seen, jnp.asarray(config.density, stats.roughness.dtype)))
    g_gradient, d_gradient, stats = across.mean((g_gradient, d_gradient, stats))
    learner, learner_adam = apply_gradient(for_learner, state.learner, state.learner_adam, g_gradient)
    judge, judge_adam = apply_gradient(for_discriminator, state.discriminator, state.discriminator_adam, d_gradient)

    due = state.step % config.r1_every == 0
    judge, judge_adam, penalty, bad_penalty = _regularised(config, judge, judge_adam, due, (real, c), across)
    rows = across.rows(batch.alpha)
    images = state.images + rows
    losses = across.mean((g_loss, d_loss, real_logit, fake_logit))
    bad = jnp.concatenate([not_finite(g_gradient), not_finite(d_gradient) | bad_penalty])
    new = TrainState(
        learner,
        _smoothed(state.smooth, learner, rows, images),
        _averaged(state.averages, stats, rows),
        judge,
        learner_adam,
        judge_adam,
        state.step + 1,
        images,
    )
    return new, GanReport(losses[0], losses[1], penalty, losses[2], losses[3], bad)


def seen(config: GanConfig, image: Float[Array, "B S S 4"]) -> Float[Array, "B S S I"]:
    """y of premultiplied pictures. Opacity is seen in means of COVER × COVER pixels: edges are in the radiance, and a render's
    opacity is not denoised: by single pixels its few levels would give it away."""
    y = discriminator_range(image[..., :3])
    if not config.discriminator.opacity:
        return y
    batch, side = image.shape[:2]
    a = image[..., 3].reshape(batch, side // COVER, COVER, side // COVER, COVER).mean(axis=(2, 4))
    a = jnp.repeat(jnp.repeat(a, COVER, axis=1), COVER, axis=2)
    return jnp.concatenate([y, 2 * a[..., None] - 1], axis=-1)


def _mismatched(batch: ImageBatch, across: Across) -> ImageBatch:
    """Each row with the parameters of the next one, among all devices' rows."""

    def next_of(x: Array) -> Array:
        rows, own = (x, jnp.arange(x.shape[0])) if across.everyone is None else across.everyone(x)
        return rows[(own + 1) % rows.shape[0]]

    return batch._replace(alpha=next_of(batch.alpha), beta=next_of(batch.beta))


def _regularised(
    config: GanConfig, judge: Any, adam: Any, due: Array, labelled: tuple[Any, Array], across: Across
) -> tuple[Any, Any, Scalar, Bool[Array, "_leaves"]]:
    """Discriminator and optimiser after an update by R1 of (f, c) if it is due, R1, and which leaves of its gradient are not
    finite."""
    f, c = labelled
    dtype = jax.tree.leaves(f)[0].dtype
    kind = kind_of(config.discriminator)
    gammas = tuple(config.gamma * k for k in kind.penalties(config.pixel_gamma))

    def penalty(judge: Any) -> Scalar:
        logits = partial(kind.judge, judge, c=c, everyone=across.everyone, dtype=dtype)
        return config.r1_every * r1(logits, f, gammas)

    def penalised(judge: Any, adam: Any) -> tuple[Any, Any, Scalar, Array]:
        value, gradient = jax.value_and_grad(penalty)(judge)
        value, gradient = across.mean((value, gradient))
        judge, adam = apply_gradient(optimisers(config)[1], judge, adam, gradient)
        return judge, adam, value, not_finite(gradient)

    def unchanged(judge: Any, adam: Any) -> tuple[Any, Any, Scalar, Array]:
        return judge, adam, jnp.zeros((), dtype), jnp.zeros(len(jax.tree.leaves(judge)), bool)

    return jax.lax.cond(due, penalised, unchanged, judge, adam)


def _smoothed(smooth: Learner, learner: Learner, rows: int, images: Array) -> Learner:
    half_life = jnp.minimum(AVERAGE_IMAGES, AVERAGE_SHARE * images.astype(jnp.float32))
    keep = 0.5 ** (rows / jnp.maximum(half_life, 1e-8))
    return jax.tree.map(lambda old, new: new + (old - new) * keep.astype(new.dtype), smooth, learner)


def _averaged(averages: Averages, stats: GeneratorStats, rows: int) -> Averages:
    keep = 0.5 ** (rows / MAGNITUDE_HALF_LIFE)
    magnitude = [
        new.astype(old.dtype) + (old - new.astype(old.dtype)) * keep
        for old, new in zip(averages.magnitude, stats.magnitude, strict=True)
    ]
    return Averages(magnitude, stats.w + (averages.w - stats.w) * W_KEEP)
