"""Record of a lobe in the columns of the strips of a cylinder, with derivatives with respect to every parameter.

The axis of the cylinder is the y axis of the image. The cross section of the cylinder is a circle of radius 1, so the
normals are those of a sphere along its equator. If camera or lamp is near, the directions to them differ slightly
between strips.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import equinox as eqx
import numpy as np

from matcam.core.jax import jax, jit_plainly, jnp
from matcam.core.shading import Vector
from matcam.forward.integral.blur import Blur
from matcam.inverse.fit.fit_parameters import LobeKind
from matcam.reconstruction.cylinder.profile_rule import ProfileWindow, RowRule
from matcam.reconstruction.picture_model import (
    OWN,
    SCENE,
    LampFrame,
    Recorded,
    over_source,
    turned_lamp,
    widened,
)
from matcam.reconstruction.sphere_in_picture import normal_at, radiance, surface_shading, theta_d_at


class ProfileModel(eqx.Module):
    """Model of the profiles of one scene, with four compiled programs.

    Attributes:
        kind: family, masking and splines of the lobe.
        blur: kernel of the camera, with a lens that is a sum of Gaussians.
        positions: positions on the source disc, as rotations of the direction to the lamp, rad, (points, 2).
        weights: weights of these positions, (points,); their sum is 1.
        turns: angle from the direction around the cylinder to the x axis of the material, for each strip, rad, (strips,).
        rule: rows of each strip at which the model is evaluated.
    """

    kind: LobeKind = eqx.field(static=True)
    blur: Blur
    positions: np.ndarray
    weights: np.ndarray
    turns: np.ndarray
    rule: RowRule

    def window(
        self, p: np.ndarray, frame: LampFrame, window: ProfileWindow, *, slopes: bool
    ) -> tuple[Recorded, Recorded | None]:
        """Compute the records of the windows, (channels x strips, WINDOW), and their derivatives.

        The derivatives have an additional last axis over the parameters, (size,).
        """
        return _compiled("_of_window", slopes)(self, p, frame, window)

    def pixels(
        self, p: np.ndarray, frame: LampFrame, column: np.ndarray, row: np.ndarray, *, slopes: bool
    ) -> tuple[Recorded, Recorded | None]:
        """Compute the records of single columns, (columns,), and their derivatives.

        `row` is the mean row of the pixels of each column, px, which determines the strip. The derivatives have an additional
        last axis over the parameters, (size,).
        """
        return _compiled("_of_columns", slopes)(self, p, frame, column, row)

    def _of_window(self, p: jax.Array, frame: LampFrame, window: ProfileWindow) -> Recorded:
        lens, radius, axis = self._kernel_parameters(p)
        out, depth = jnp.sin(window.u), jnp.cos(window.u)
        turns, rows = jnp.asarray(self.turns), jnp.asarray(self.rule.rows)
        emitted = self._radiance(p, frame, out[..., None], depth[..., None], turns[:, None, None], rows[:, None])
        offset = window.column[:, :, None] - (axis + radius * out)[:, None, :]
        kernel = (
            sum(
                self.blur.weights[term] * self.blur.pixel.of_gaussian(offset, self.blur.stds[term] * jnp.exp(lens))
                for term in range(self.blur.stds.size)
            )
            * (window.weight * radius)[:, None]
        )
        # mean over the rows of a strip, and its change with the mean row of the pixels that are read
        sums = jnp.stack([jnp.broadcast_to(self.rule.weight, rows.shape), self.rule.slope])
        away = window.row - rows.mean(axis=1)[:, None]

        def recorded(part: jax.Array) -> jax.Array:
            mean, slope = jnp.einsum("swn,ksn->ksw", kernel, jnp.einsum("snr,ksr->ksn", part, sums))
            return mean + away * slope

        lobe, lambert = (recorded(part) for part in emitted)
        theta_d = self._theta_d(p, frame, (jnp.asarray(window.column) - axis) / radius, jnp.asarray(window.row))
        return Recorded(*(part.reshape(-1, part.shape[-1]) for part in (lobe, lambert, theta_d)))

    def _of_columns(self, p: jax.Array, frame: LampFrame, column: jax.Array, row: jax.Array) -> Recorded:
        lens, radius, axis = self._kernel_parameters(p)
        centre = (column - axis) / radius
        middle = jnp.asarray(self.rule.rows.mean(axis=1))
        strip = jnp.argmin(jnp.abs(row[:, None] - middle), axis=1)
        turns, rows = jnp.asarray(self.turns)[strip], jnp.asarray(self.rule.rows)[strip]
        rows += (row - middle[strip])[:, None]
        lobe, lambert = jnp.zeros_like(centre), jnp.zeros_like(centre)
        scaled = widened(self.blur, lens)
        for term in range(self.blur.stds.size):
            offset, weight = scaled.rule(term, jnp.zeros(()))
            out = centre[:, None] + offset / radius
            inside = out**2 < 1
            out = jnp.where(inside, out, 0.0)
            depth = jnp.sqrt(1 - out**2)
            parts = self._radiance(p, frame, out[..., None], depth[..., None], turns[:, None, None], rows[:, None])
            share = jnp.where(inside, self.blur.weights[term] * weight, 0.0)[..., None] * self.rule.weight
            lobe += jnp.sum(parts[0] * share, axis=(1, 2))
            lambert += jnp.sum(parts[1] * share, axis=(1, 2))
        return Recorded(lobe, lambert, self._theta_d(p, frame, centre, row))

    def _kernel_parameters(self, p: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        n = self.kind.size
        return p[n + SCENE.index("lens")], p[n + SCENE.index("radius")], p[-len(OWN)]

    def _radiance(
        self, p: jax.Array, frame: LampFrame, out: jax.Array, depth: jax.Array, turn: jax.Array, row: jax.Array
    ) -> tuple[jax.Array, jax.Array]:
        slopes = self.kind.slopes(p[: self.kind.size])
        normal, point, camera, lamp, turns = self._surface(p, out, depth, row)
        tangent = jnp.cos(turn) * normal[2], jnp.sin(turn), -jnp.cos(turn) * normal[0]
        shape = p[self.kind.size + len(SCENE) : -len(OWN)]  # of the diffuse part

        def under(direction: Vector) -> tuple[jax.Array, jax.Array]:
            at = surface_shading(normal, tangent, point, direction, camera, lamp)
            return radiance(slopes, self.kind.masking, shape, *at)

        return over_source(under, (self.positions, self.weights), frame, turns, jnp.zeros_like(out * row))

    def _surface(self, p: jax.Array, out: jax.Array, depth: jax.Array, row: jax.Array) -> tuple[Any, ...]:
        """Compute the normal and the point where a line of sight meets the cylinder.

        Returns:
            Normal, point (radii), inverse distances of camera and lamp (1/radii), and both rotations of the lamp (rad).
        """
        n = self.kind.size
        radius, camera, lamp = (p[n + SCENE.index(name)] for name in ("radius", "camera", "lamp"))
        centre_row, a, b = p[1 - len(OWN) :]
        x, _, z = normal_at(out, jnp.zeros(()), depth, camera)
        height = (centre_row - row) / (radius * jnp.sqrt(1 - camera**2)) * (1 - camera * z)
        return (x, jnp.zeros(()), z), (x, height, z), camera, lamp, (a, b)

    def _theta_d(self, p: jax.Array, frame: LampFrame, out: jax.Array, row: jax.Array) -> jax.Array:
        """Compute theta_d on the line of sight through the centre of a column.

        Outside the outline, the nearest position inside the outline is used.
        """
        out = jnp.clip(out, -0.9999, 0.9999)
        _, point, camera, lamp, (a, b) = self._surface(p, out, jnp.sqrt(1 - out**2), row)
        return theta_d_at(point, tuple(turned_lamp(frame, a, b)), camera, lamp)


@cache
def _compiled(method: str, slopes: bool) -> Callable[..., tuple[Recorded, Recorded | None]]:
    """Compile a method of `ProfileModel` once for all scenes with arrays of the same shapes."""
    of = getattr(ProfileModel, method)

    def value(model: ProfileModel, p: jax.Array, *rest: Any) -> tuple[Recorded, None]:
        return of(model, p, *rest), None

    def with_slopes(model: ProfileModel, p: jax.Array, *rest: Any) -> tuple[Recorded, Recorded]:
        def twice(p: jax.Array) -> tuple[Recorded, Recorded]:
            recorded = of(model, p, *rest)
            return recorded, recorded

        slopes, recorded = jax.jacfwd(twice, has_aux=True)(p)
        return recorded, slopes

    return jit_plainly(with_slopes if slopes else value, runs="many")
