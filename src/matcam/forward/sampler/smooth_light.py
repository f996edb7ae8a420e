"""Record of pixels where the radiance is smooth: quadrature with the kernel as weight function."""

from __future__ import annotations

from matcam.core.jax import jax, jnp
from matcam.forward.integral.blur import Blur
from matcam.forward.integral.pupil import mean_over_pupil
from matcam.forward.integral.scene import Scene
from matcam.sample.shape import Element


def record_inside(scene: Scene, blur: Blur, x: jax.Array, y: jax.Array) -> jax.Array:
    """Compute the record of pixels whose kernel contains no highlight, no limb and no terminator.

    Args:
        scene: the scene, under one lamp or one lamp per pixel.
        blur: blur; the record contains all its terms.
        x: positions of the pixels to the right of the optical axis, (pixels,), px.
        y: positions of the pixels above the optical axis, (pixels,), px.

    Returns:
        Record, 1/sr, (pixels, channels).
    """
    total: jax.Array | float = 0.0
    centre, _ = scene.sample.at(*scene.from_sensor(x, y))
    spread = blur.spread(scene.sample, centre.normal[2], scene.lamp_angle, scene.lamp_nearness)
    scene = scene.beside_nodes(1)
    for term in blur.terms:
        if scene.uniform_rows:
            dx, share = blur.rule(term, spread.along)
            dy = jnp.zeros_like(dx)
        else:
            dx, dy, share = blur.plane_rule(term, spread)
        light = _arriving(scene, blur, x[:, None] - dx, y[:, None] - dy)
        if blur.is_residual(term):  # the corners of the residual have negligible weight and may lie beyond the limb
            _, lit = scene.shown(x[:, None] - dx, y[:, None] - dy)
            light = jnp.where(lit[..., None], light, 0.0)
        total += blur.share(term) * jnp.sum(light * share[..., None], axis=1)
    return jnp.asarray(total)


def _arriving(scene: Scene, blur: Blur, x: jax.Array, y: jax.Array) -> jax.Array:
    """Compute the radiance blurred by defocus only, 1/sr, channels last. x, y: positions on the sensor, px."""

    def seen(at_x: jax.Array, at_y: jax.Array) -> Element:
        return scene.sample.at(*scene.from_sensor(at_x, at_y))[0]

    def sent(at_x: jax.Array, at_y: jax.Array) -> jax.Array:
        return scene.sent(seen(at_x, at_y))

    def disc(at_x: jax.Array, at_y: jax.Array) -> jax.Array:
        return blur.defocus(scene.sample.radius, seen(at_x, at_y).normal[2])

    return mean_over_pupil(sent, disc, x, y) if blur.chords else sent(x, y)
