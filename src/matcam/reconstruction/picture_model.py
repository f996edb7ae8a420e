"""Record of a lobe in the pixels of one image, with derivatives with respect to every parameter.

The value of a pixel is the integral of kernel(position - pixel) times radiance(position) over the image. Near the
highlight, the integration nodes are fixed on the sphere, so that they move with the centre and radius of the sphere. At
other pixels, the image is smooth on the scale of the kernel, and the Gauss rule of the kernel is used.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, lru_cache, partial
from typing import Any, NamedTuple

import equinox as eqx
import numpy as np

from matcam.acquisition.mirror_ball import unit
from matcam.core.jax import AnyArray, jax, jit_plainly, jnp, placed
from matcam.core.shading import Vector
from matcam.forward.integral.blur import Blur
from matcam.inverse.fit.fit_parameters import LobeKind
from matcam.inverse.fit.lobe_slopes import table_slopes
from matcam.material.tabulated_masking import has_closed_lambda
from matcam.reconstruction.picture_rule import Window
from matcam.reconstruction.sphere_in_picture import normal_at, radiance, sphere_tangent, surface_shading, theta_d_at

SCENE = ("lens", "radius", "camera", "lamp")
"""Shared parameters after those of the lobe: ln of the scale of the lens, radius in px, inverse distances of camera and lamp.

The terms of the diffuse part follow, if it has any.
"""
OWN = ("column", "row", "lamp_a", "lamp_b")
"""Parameters of one image: centre of the outline, px, and the rotation of the lamp from its base direction along two
tangents, rad.
"""


class LampFrame(NamedTuple):
    """Base direction to the lamp of an image and two tangents, unit vectors of shape (3,)."""

    base: np.ndarray
    first: np.ndarray
    second: np.ndarray


class Recorded(NamedTuple):
    """Record of pixels under unit irradiance at the centre of the sphere.

    Attributes:
        lobe: record of a lobe with F = 1, 1/sr.
        lambert: record of a Lambertian surface of albedo 1, 1/sr.
        theta_d: difference angle at the pixel, rad.
    """

    lobe: Any
    lambert: Any
    theta_d: Any


class ShownLight(NamedTuple):
    """Parameters of one image that change the radiance.

    The derivatives with respect to `lobe`, `pose` and `shape` are computed separately.

    Attributes:
        lobe: coordinates of the lobe, which do not affect angles.
        pose: inverse distances of camera and lamp, 1/radii, and the rotation (a, b) of the lamp, rad.
        shape: coefficients of the departure of the diffuse part from Lambert's law.
        table: table of Smith's Lambda of the lobe, which all images share. Default: None, Lambda has a closed form.
        by_lobe: derivatives of the table with respect to the coordinates of the lobe, (coordinates, nodes). Default: None,
            not requested.
    """

    lobe: Any
    pose: Any
    shape: Any
    table: Any = None
    by_lobe: Any = None


class KernelSlopes(NamedTuple):
    """Term of the kernel along one axis, 1/px, and its derivatives.

    Attributes:
        value: value of the term, 1/px.
        by_offset: derivative with respect to the offset, 1/px^2.
        by_lens: derivative with respect to ln of the scale of the lens, 1/px.
    """

    value: jax.Array
    by_offset: jax.Array
    by_lens: jax.Array


def lamp_frame(direction: np.ndarray) -> LampFrame:
    direction = unit(direction)
    helper = np.eye(3)[np.argmin(np.abs(direction))]
    first = unit(np.cross(direction, helper))
    return LampFrame(direction, first, np.cross(direction, first))


def turned_lamp(frame: LampFrame, a: Any, b: Any) -> Any:
    """Compute the unit vector to a lamp that is rotated by (a, b), rad, from its base direction."""
    vector = frame.base + a * frame.first + b * frame.second
    return vector / jnp.sqrt(jnp.sum(vector**2))


def lamp_coordinates(frame: LampFrame, direction: np.ndarray) -> np.ndarray:
    """Compute the rotation (a, b), rad, from the base direction to the unit vector `direction`, (2,)."""
    tangents = np.array([frame.first, frame.second])
    # cosine of the largest angle between a direction to a lamp and its base direction at which coordinates are
    # accurate
    return tangents @ direction / max(float(direction @ frame.base), 0.1)


def over_source(
    radiance_under: Callable[[Vector], tuple[jax.Array, jax.Array]],
    source: tuple[AnyArray, AnyArray],
    frame: LampFrame,
    turn: Any,
    start: jax.Array,
) -> tuple[jax.Array, jax.Array]:
    """Average the radiance of lobe and diffuse part over the source disc.

    Args:
        radiance_under: function that computes both radiances for one direction to the lamp.
        source: positions on the source disc, as rotations of the direction to the lamp, rad, (points, 2), and their weights.
        frame: base direction of the lamp.
        turn: rotation of the lamp from its base direction, rad.
        start: zeros in the shape of the result.
    """

    def under(position: jax.Array, weight: jax.Array) -> tuple[jax.Array, jax.Array]:
        lobe, lambert = radiance_under(tuple(turned_lamp(frame, turn[0] + position[0], turn[1] + position[1])))
        return weight * lobe, weight * lambert

    positions, weights = source
    if len(weights) == 1:
        return under(positions[0], weights[0])

    def add(total: Any, point: Any) -> tuple[Any, None]:
        return jax.tree.map(jnp.add, total, under(*point)), None

    return jax.lax.scan(add, (start, start), (jnp.asarray(positions), jnp.asarray(weights)))[0]


class PictureModel(eqx.Module):
    """Model of the images of one scene, with four compiled programs.

    Attributes:
        kind: family, masking and splines of the lobe.
        blur: kernel of the camera, with a lens that is a sum of Gaussians.
        positions: positions on the source disc, as rotations of the direction to the lamp, rad, (points, 2).
        weights: weights of these positions, (points,); their sum is 1.
    """

    kind: LobeKind = eqx.field(static=True)
    blur: Blur
    positions: np.ndarray
    weights: np.ndarray

    def window(
        self, p: np.ndarray, frame: LampFrame, window: Window, *, slopes: bool
    ) -> tuple[Recorded, Recorded | None]:
        """Compute the record of a window, (WINDOW, WINDOW) with v first, and its derivatives.

        The derivatives have an additional last axis over the parameters, (size,). They are None if `slopes` is False.
        """
        return _compiled("_of_window")(self, *self._split(p, slopes), frame, window, slopes=slopes)

    def pixels(
        self, p: np.ndarray, frame: LampFrame, column: np.ndarray, row: np.ndarray, *, slopes: bool
    ) -> tuple[Recorded, Recorded | None]:
        """Compute the record of single pixels, (pixels,), and its derivatives, (pixels, size).

        The derivatives are None if `slopes` is False.
        """
        return _compiled("_of_pixels")(self, *self._split(p, slopes), frame, (column, row), slopes=slopes)

    def _split(self, p: np.ndarray, slopes: bool) -> tuple[ShownLight, np.ndarray]:
        """Separate the parameters that change the radiance from those that change the kernel."""
        n, own = self.kind.size, p.size - len(OWN)
        shape = n + len(SCENE)
        pose = np.concatenate([p[n + 2 : shape], p[own + 2 :]])
        light = ShownLight(p[:n], pose, p[shape:own], *_lambda_table(self.kind, p[:n].tobytes(), slopes))
        return light, np.concatenate([p[n : n + 2], p[own : own + 2]])

    def _of_window(
        self, light: ShownLight, kernel: jax.Array, frame: LampFrame, window: Window, *, slopes: bool
    ) -> tuple[Recorded, Recorded | None]:
        """Compute the record of a window and, by explicit formulas, its derivatives.

        The formulas require only the three arrays of `KernelSlopes`.
        """
        sum_u, sum_v, theta_d = self._projection(kernel, window, frame)
        radius, turned, (lateral, height) = kernel[1], window.turned > 0, _seen_disc(window)
        area = radius**2 * _area(window)
        emitted = self._emitted(light, frame, window) * area
        if not slopes:
            lobe, lambert = sum(
                weight * jnp.einsum("bv,kva->kba", of_v.value, jnp.einsum("avu,kvu->kva", of_u.value, emitted))
                for weight, of_u, of_v in zip(self.blur.weights, sum_u, sum_v, strict=True)
            )
            return Recorded(lobe, lambert, theta_d(light, kernel)), None
        by_each = _by_each(lambda x: self._emitted(x, frame, window), light)
        by_light = jnp.concatenate(by_each, axis=-1) * area
        value, derivative = jnp.zeros(()), jnp.zeros(())
        for weight, of_u, of_v in zip(self.blur.weights, sum_u, sum_v, strict=True):
            rows = jnp.einsum("avu,kvu->kva", of_u.value, emitted)
            moved = jnp.einsum("avu,kvu->kva", of_u.by_offset, emitted)
            grown = jnp.einsum("avu,kvu->kva", of_u.by_offset, emitted * lateral)
            wider = jnp.einsum("avu,kvu->kva", of_u.by_lens, emitted)
            lit = jnp.einsum("avu,kvut->tkva", of_u.value, by_light)

            def over_v(of_v: jax.Array, rows: jax.Array) -> jax.Array:
                return jnp.einsum("bv,...kva->...kba", of_v, rows)

            one = over_v(of_v.value, rows)
            side_u, side_v = jnp.where(turned, -1.0, 1.0), jnp.where(turned, 1.0, -1.0)
            by_radius = 2 * one / radius - side_u * over_v(of_v.value, grown)
            by_radius -= side_v * over_v(of_v.by_offset * height, rows)
            by_lens = over_v(of_v.value, wider) + over_v(of_v.by_lens, rows)
            offset_u, offset_v = -over_v(of_v.value, moved), -over_v(of_v.by_offset, rows)
            by_u, by_v = (window.stretch[0, at] * offset_u + window.stretch[1, at] * offset_v for at in (0, 1))
            by_kernel = jnp.stack([by_lens, by_radius, jnp.where(turned, by_v, by_u), jnp.where(turned, by_u, by_v)])
            value += weight * one
            derivative += weight * jnp.concatenate([over_v(of_v.value, lit), by_kernel])
        ends = np.cumsum([part.shape[-1] for part in by_each])
        pair = jnp.moveaxis(derivative, 0, -1)
        angle = *_by_each(lambda x: theta_d(x, kernel), light), jax.jacfwd(theta_d, argnums=1)(light, kernel)
        lobe, lambert = (self._in_order(*jnp.split(part, ends, axis=-1)) for part in pair)
        by_parameters = Recorded(lobe, lambert, self._in_order(*angle))
        return Recorded(value[0], value[1], theta_d(light, kernel)), by_parameters

    def _emitted(self, light: ShownLight, frame: LampFrame, window: Window) -> jax.Array:
        """Compute the radiance of lobe and diffuse part at the nodes, times the weights of the nodes, (2, v, u)."""
        u, v = window.u[None, :], window.v[:, None]
        along, across = _along(window), jnp.sin(v) + 0 * u
        cos, sin = jnp.cos(window.tilt), jnp.sin(window.tilt)
        along, across = cos * along - sin * across, cos * across + sin * along
        turned = window.turned > 0
        p_x, p_y = jnp.where(turned, across, along), jnp.where(turned, along, across)
        return jnp.stack(self._radiance(light, frame, p_x, p_y, jnp.cos(v) * jnp.cos(u))) * window.weight

    def _projection(
        self, kernel: jax.Array, window: Window, frame: LampFrame
    ) -> tuple[list[KernelSlopes], list[KernelSlopes], Callable[[ShownLight, jax.Array], jax.Array]]:
        """Compute the kernels from nodes to pixels along u and v, one for each term of the blur, and a function for theta_d."""
        lens, radius, column, row = kernel
        turned = window.turned > 0
        # columns are parallel to x, rows are antiparallel to y
        centre_u, side_u = jnp.where(turned, row, column), jnp.where(turned, -1.0, 1.0) * radius
        centre_v, side_v = jnp.where(turned, column, row), jnp.where(turned, 1.0, -1.0) * radius
        seen_u, seen_v = window.stretch @ jnp.stack([centre_u, centre_v]) + window.shift
        lateral, height = _seen_disc(window)
        offset_u = window.pixel_u[:, None, None] - (seen_u + side_u * lateral)  # (pixels, v, u)
        offset_v = window.pixel_v[:, None] - (seen_v + side_v * height)
        terms = [self.blur.stds[term] * window.widened * jnp.exp(lens) for term in range(self.blur.stds.size)]
        where = jnp.stack(jnp.meshgrid(window.pixel_u, window.pixel_v)) - window.shift[:, None, None]
        where_u, where_v = jnp.einsum("ij,jkl->ikl", jnp.linalg.inv(window.stretch), where)
        pixel_column, pixel_row = jnp.where(turned, where_v, where_u), jnp.where(turned, where_u, where_v)

        def theta_d(light: ShownLight, kernel: jax.Array) -> jax.Array:
            _, radius, column, row = kernel
            return self._theta_d(light, frame, (pixel_column - column) / radius, (row - pixel_row) / radius)

        of_u = [self._kernel_slopes(offset_u, std) for std in terms]
        return of_u, [self._kernel_slopes(offset_v, std) for std in terms], theta_d

    def _kernel_slopes(self, offset: jax.Array, std: jax.Array) -> KernelSlopes:
        def of(offset: jax.Array) -> jax.Array:
            return self.blur.pixel.of_gaussian(offset, std)

        def of_std(log_std: jax.Array) -> jax.Array:
            return self.blur.pixel.of_gaussian(offset, jnp.exp(log_std))

        value, by_offset = jax.jvp(of, (offset,), (jnp.ones_like(offset),))
        _, by_lens = jax.jvp(of_std, (jnp.log(std),), (jnp.ones(()),))
        return KernelSlopes(value, by_offset, by_lens)

    def _of_pixels(
        self, light: ShownLight, kernel: jax.Array, *rest: Any, slopes: bool
    ) -> tuple[Recorded, Recorded | None]:
        recorded = self._at_pixels(light, kernel, *rest)
        if not slopes:
            return recorded, None
        by_light = _by_each(lambda x: self._at_pixels(x, kernel, *rest), light)
        by_kernel = jax.jacfwd(lambda x: self._at_pixels(light, x, *rest))(kernel)
        return recorded, Recorded(*(self._in_order(*each) for each in zip(*by_light, by_kernel, strict=True)))

    def _at_pixels(
        self, light: ShownLight, kernel: jax.Array, frame: LampFrame, at: tuple[jax.Array, jax.Array]
    ) -> Recorded:
        lens, radius, column, row = kernel
        centre_x, centre_y = (at[0] - column) / radius, (row - at[1]) / radius
        lobe, lambert = jnp.zeros_like(centre_x), jnp.zeros_like(centre_x)
        scaled = widened(self.blur, lens)
        for term in range(self.blur.stds.size):
            offset, weight = scaled.rule(term, jnp.zeros(()))
            p_x = centre_x[:, None, None] + offset[:, None] / radius
            p_y = centre_y[:, None, None] + offset[None, :] / radius
            depth2 = 1 - p_x**2 - p_y**2
            inside = depth2 > 0
            depth = jnp.sqrt(jnp.where(inside, depth2, 1.0))
            parts = self._radiance(light, frame, jnp.where(inside, p_x, 0.0), jnp.where(inside, p_y, 0.0), depth)
            share = self.blur.weights[term] * weight[:, None] * weight[None, :]
            lobe += jnp.sum(jnp.where(inside, parts[0] * share, 0.0), axis=(1, 2))
            lambert += jnp.sum(jnp.where(inside, parts[1] * share, 0.0), axis=(1, 2))
        return Recorded(lobe, lambert, self._theta_d(light, frame, centre_x, centre_y))

    def _radiance(
        self, light: ShownLight, frame: LampFrame, p_x: jax.Array, p_y: jax.Array, depth: jax.Array
    ) -> tuple[jax.Array, jax.Array]:
        ndf, (camera, lamp, a, b), terms = self.kind.ndf(light.lobe), light.pose, light.shape
        normal = normal_at(p_x, p_y, depth, camera)
        tangent = sphere_tangent(normal)

        def under(direction: Vector) -> tuple[jax.Array, jax.Array]:
            at = surface_shading(normal, tangent, normal, direction, camera, lamp)
            return radiance(ndf, self.kind.masking, terms, *at, light.table)

        return over_source(under, (self.positions, self.weights), frame, (a, b), jnp.zeros_like(p_x * depth))

    def _in_order(self, lobe: jax.Array, pose: jax.Array, shape: jax.Array, kernel: jax.Array) -> jax.Array:
        """Arrange derivatives in the order of the parameters of an image: lobe, scene, diffuse part, own parameters."""
        parts = [lobe, kernel[..., :2], pose[..., :2], shape, kernel[..., 2:], pose[..., 2:]]
        return jnp.concatenate(parts, axis=-1)

    def _theta_d(self, light: ShownLight, frame: LampFrame, p_x: jax.Array, p_y: jax.Array) -> jax.Array:
        """Compute theta_d on the line of sight through the centre of a pixel.

        Outside the outline, the nearest position inside the outline is used.
        """
        camera, lamp, a, b = light.pose
        beyond = jnp.sqrt(jnp.maximum(p_x**2 + p_y**2, 1e-12)) / 0.9999
        shrink = 1 / jnp.maximum(beyond, 1.0)
        p_x, p_y = p_x * shrink, p_y * shrink
        depth = jnp.sqrt(1 - p_x**2 - p_y**2)
        return theta_d_at(normal_at(p_x, p_y, depth, camera), tuple(turned_lamp(frame, a, b)), camera, lamp)


def _by_each(function: Callable[[ShownLight], Any], light: ShownLight) -> tuple[Any, Any, Any]:
    """Differentiate a function with respect to lobe, pose and shape of `ShownLight` separately.

    This avoids the differentiation of intermediate values that do not depend on the respective part.
    """

    def of_lobe(lobe: jax.Array, table: jax.Array | None) -> Any:
        return function(light._replace(lobe=lobe, table=table))

    def along_lobe(change: jax.Array, of_table: jax.Array | None) -> Any:
        return jax.jvp(of_lobe, (light.lobe, light.table), (change, of_table))[1]

    return (
        jax.vmap(along_lobe, out_axes=-1)(jnp.eye(light.lobe.size), light.by_lobe),
        jax.jacfwd(lambda pose: function(light._replace(pose=pose)))(light.pose),
        jax.jacfwd(lambda shape: function(light._replace(shape=shape)))(light.shape),
    )


@lru_cache(maxsize=8)
def _lambda_table(kind: LobeKind, lobe: bytes, slopes: bool) -> tuple[AnyArray | None, AnyArray | None]:
    """Compute the table of Smith's Lambda of a lobe, and its derivatives on request; None if Lambda has a closed form.

    Args:
        kind: kind of the lobe.
        lobe: bytes of the coordinates of the lobe, (kind.size,).
        slopes: True to compute derivatives.
    """
    return _table_of(kind, placed(np.frombuffer(lobe)), slopes)


@partial(jit_plainly, static=("kind", "slopes"))
def _table_of(kind: LobeKind, q: jax.Array, slopes: bool) -> tuple[jax.Array | None, jax.Array | None]:
    if kind.masking is None or has_closed_lambda(kind.ndf(q)):
        return None, None
    table, by_lobe = table_slopes(kind, q)
    return table, by_lobe if slopes else None


@cache
def _compiled(method: str) -> Callable[..., tuple[Recorded, Recorded | None]]:
    """Compile a method of `PictureModel` once for all scenes with arrays of the same shapes."""
    return jit_plainly(getattr(PictureModel, method), runs="many", static=("slopes",))


def widened(blur: Blur, lens: jax.Array) -> Blur:
    return eqx.tree_at(lambda b: b.stds, blur, blur.stds * jnp.exp(lens))


def _along(window: Window) -> jax.Array:
    """Compute the positions of the nodes along u on the disc of the outline, (v, u)."""
    return jnp.cos(window.v)[:, None] * jnp.sin(window.u)[None, :]


def _seen_disc(window: Window) -> tuple[jax.Array, jax.Array]:
    """Compute the image positions of the nodes along u, (v, u), and along v, (v,), in radii of the outline.

    The signs take into account that rows are antiparallel to the y axis of the disc.
    """
    (uu, uv), (vu, vv) = window.stretch
    cos, sin = jnp.cos(window.tilt), jnp.sin(window.tilt)
    across = jnp.sin(window.v)
    lateral = (uu * cos - uv * sin) * _along(window) - (uu * sin + uv * cos) * across[:, None]
    return lateral, (vv * cos + vu * sin) * across


def _area(window: Window) -> jax.Array:
    """Compute the areal magnification of the lens at the highlight."""
    (uu, uv), (vu, vv) = window.stretch
    return uu * vv - uv * vu
