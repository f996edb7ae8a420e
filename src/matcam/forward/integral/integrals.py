"""The light of a scene, and three integrals of its record: around a highlight, inside smooth light, and where the light ends.

A scene is a material on a curved sample, under a lamp (docs/model.md 3). What reaches a pixel is radiance rho cos_i, not rho.
With dx dy = area cos_o du dv, the record is

    R(x) = integral over the visible, lit surface of  k(x - x(u, v)) rho cos_i cos_o area du dv.

Every cosine that could vanish has cancelled: nothing is singular at the limb.

- `record_around`: over normals about the half vector. The nodes crowd towards the half vector on the lobe's own scale, and
  are nowhere further apart than the kernel allows. A highlight of a thousandth of a pixel is neither missed nor noisy.
  Nodes and kernel are products in u and v, so two matrix products give all pixels of a rectangle.
- `record_inside`: a few nodes on the sensor about each pixel. The light is smooth there on the scale of the kernel.
- `record_in_window`: over (u, v) about each pixel, along limb and terminator. What is visible and lit is one interval of u
  whose ends are known, and the light is smooth up to them.
"""

from __future__ import annotations

from typing import NamedTuple

import equinox as eqx
import numpy as np
from jax.typing import ArrayLike

from matcam.core.jax import jax, jnp
from matcam.core.shading import Shading, shading
from matcam.forward.integral.blur import BlurTerms
from matcam.material.material import Material
from matcam.numerics.quadrature import graded_nodes, nodes_in_panels
from matcam.sample.shape import Curved, Element

# Orders of the Gauss-Legendre panels about a pixel, and their cuts about a squeezed lobe, in the lobe's width there
_ORDER_V, _ORDER_V_RIDGE = 9, 7
_ORDER_U, _ORDER_U_RIDGE = 10, 6
_RIDGE_PANELS = 4
_RIDGE_CUTS = np.array([-2.0, 0.0, 2.0])
_MASKING_LAYER = np.array([3.0])


class Scene(eqx.Module):
    """A material on a curved sample under a distant lamp of irradiance 1; radiance is in 1/sr.

    Attributes:
        material: the material.
        sample: the sample.
        lamp_angle: angle between lamp and optical axis, towards +x, rad; it broadcasts with the elements asked for.
    """

    material: Material
    sample: Curved
    lamp_angle: jax.Array

    def seen(self, element: Element) -> Shading:
        """Return the angles under which a piece of surface sees lamp and camera."""
        light = (jnp.sin(self.lamp_angle), jnp.zeros(()), jnp.cos(self.lamp_angle))
        return shading(element.normal, element.tangent, light, element.view)

    def sent(self, element: Element) -> jax.Array:
        """Return rho cos_i cos_o area, channels last.

        It is the light of a piece of surface per unit of its coordinates.
        """
        seen = self.seen(element)
        light = self.material.reflected(seen)
        if light.ndim == (seen.cos_i * seen.cos_o).ndim:
            light = light[..., None]
        return light * (element.area[..., None] if jnp.ndim(element.area) else element.area)

    def flat_field(self, element: Element) -> jax.Array:
        """Return the same for a surface of radiance 1 all over.

        It has no channels, and light need not reach it.
        """
        return self.seen(element).cos_o * element.area

    def channels(self) -> int:
        """Return the count of channels."""
        at_centre = Scene(self.material, self.sample, jnp.zeros(()))
        return jax.eval_shape(lambda: at_centre.sent(self.sample.surface(jnp.zeros(()), jnp.zeros(())))).shape[-1]


@jax.jit
def highlight_x(sample: Curved, lamp_angle: jax.Array) -> jax.Array:
    """Return the position of the highlight on the x axis, px."""
    return sample.surface(sample.highlight(lamp_angle), jnp.zeros(())).x


class HighlightPanels(NamedTuple):
    """Fineness of the integral around a highlight.

    Attributes:
        graded: panels that grow from the lobe's scale outwards.
        even: panels of one length between the half vector and the border.
        order: Gauss-Legendre nodes per panel.
    """

    graded: int
    even: int
    order: int


class WindowPanels(NamedTuple):
    """Panels of the integral in a window about a pixel.

    Attributes:
        reach: distance to which the kernel is followed, px.
        cuts: offsets, px, at which the kernel must be cut to be smooth in between; none where it is smooth.
        along_v: count of panels along v.
        ridge: True where a squeezed lobe runs through the window. Towards the limb the surface turns within a pixel.
            Even far from its peak a lobe is a narrow ridge there, along the half vector's u.
    """

    reach: jax.Array
    cuts: jax.Array
    along_v: int
    ridge: bool


def record_around(
    scene: Scene, blur: BlurTerms, x: jax.Array, y: jax.Array, reach: ArrayLike, panels: HighlightPanels
) -> jax.Array:
    """Record a rectangle of pixels at or beside the highlight.

    Args:
        scene: the light; its lamp_angle has shape ().
        blur: the terms to record through.
        x: columns of the rectangle, (columns,), px.
        y: rows of the rectangle, (rows,), px.
        reach: distance to which the terms are followed, px.
        panels: fineness of the integral.

    Returns:
        Radiance per unit irradiance, (rows, columns, channels + 1). The last channel is the record of a flat field of radiance
        1 wherever light falls.
    """
    sample, lamp = scene.sample, scene.lamp_angle
    peak, finest = sample.highlight(lamp), scene.material.finest
    shares = np.arange(panels.even + 1) / panels.even
    _, lines = sample.window(jnp.zeros(()), (jnp.max(jnp.abs(y)) + reach) * shares, peak)
    v, v_weight = graded_nodes(lines, finest, panels.graded, panels.order)
    low, high = sample.lit(v, lamp)
    middle = jnp.clip(peak, low, high)
    centre = sample.surface(middle, v).x
    sides = []
    for end in (jnp.min(x) - reach, jnp.max(x) + reach):
        at = sample.across(centre[:, None] + (end - centre)[:, None] * shares, v[:, None])
        borders = jnp.clip(at.at[:, 0].set(middle), low[:, None], high[:, None])
        sides.append(graded_nodes(borders, finest, panels.graded, panels.order))
    u = jnp.concatenate([nodes for nodes, _ in sides], axis=1)
    # on the lower side the nodes run downwards, and their weights are negative
    weight = jnp.concatenate([-sides[0][1], sides[1][1]], axis=1) * v_weight[:, None]
    element = sample.surface(u, v[:, None])
    light = jnp.concatenate([scene.sent(element), scene.flat_field(element)[..., None]], axis=-1) * weight[..., None]
    spread_x, spread_y = blur.blur.spread(sample, element.normal[2], lamp)
    total = jnp.zeros((y.size, x.size, light.shape[-1]))
    for term in blur.terms:
        columns = blur.blur.kernel(x[:, None, None] - element.x, term, spread_x)
        # the surface is the same on either side of the plane of camera and lamp
        above, below = (y[:, None, None] - sign * element.y for sign in (1, -1))
        rows = blur.blur.kernel(above, term, spread_y) + blur.blur.kernel(below, term, spread_y)
        if rows.shape[-1] == 1:
            by_line = jnp.einsum("xvu,vuc->vxc", columns, light)
            recorded = jnp.einsum("yv,vxc->yxc", rows[..., 0], by_line)
        else:
            recorded = jnp.einsum("yvu,xvu,vuc->yxc", rows, columns, light)
        total += blur.blur.weights[term] * recorded
    return total


def record_inside(scene: Scene, blur: BlurTerms, x: jax.Array, y: jax.Array) -> jax.Array:
    """Record pixels whose kernel meets neither the highlight nor an end of the light.

    Args:
        scene: the light, under one lamp or one per pixel.
        blur: the terms to record through.
        x: columns of the pixels, (pixels,), px.
        y: rows of the pixels, (pixels,), px.

    Returns:
        Radiance per unit irradiance, (pixels, channels).
    """
    total: jax.Array | float = 0.0
    centre, _ = scene.sample.at(x, y)
    spread_x, spread_y = blur.blur.spread(scene.sample, centre.normal[2], scene.lamp_angle)
    scene = Scene(scene.material, scene.sample, _beside_nodes(scene.lamp_angle, 1))
    for term in blur.terms:
        (dx, x_weight), (dy, y_weight) = (blur.blur.rule(term, spread) for spread in (spread_x, spread_y))
        shape = (*jnp.broadcast_shapes(dx.shape[:-1], dy.shape[:-1]), -1)
        dx, dy = (a.reshape(shape) for a in jnp.broadcast_arrays(dx[..., None, :], dy[..., :, None]))
        share = (y_weight[..., :, None] * x_weight[..., None, :]).reshape(shape)
        element, _ = scene.sample.at(x[:, None] + dx, y[:, None] + dy)
        total += blur.blur.weights[term] * jnp.sum(scene.sent(element) * share[..., None], axis=1)
    return jnp.asarray(total)


def record_in_window(scene: Scene, blur: BlurTerms, x: jax.Array, y: jax.Array, panels: WindowPanels) -> jax.Array:
    """Record pixels whose kernel may cross the limb, the terminator or a squeezed lobe.

    Args:
        scene: the light, under one lamp or one per pixel.
        blur: the terms to record through.
        x: columns of the pixels, (pixels,), px.
        y: rows of the pixels, (pixels,), px.
        panels: the window about each pixel.

    Returns:
        Radiance per unit irradiance, (pixels, channels + 1). The last channel is the record of a flat field of radiance 1.
    """
    sample = scene.sample
    first, last = (end[:, None] for end in sample.rows(x, y, panels.reach))
    borders = first + (last - first) * np.linspace(0, 1, panels.along_v + 1)
    if panels.cuts.size:
        at = y[:, None] + panels.cuts
        stepped, _ = sample.window(at, at, sample.across(x, jnp.zeros_like(x))[:, None])
        borders = jnp.sort(jnp.concatenate([borders, jnp.clip(stepped, first, last)], axis=-1), axis=-1)
    v, v_weight = nodes_in_panels(borders, _ORDER_V_RIDGE if panels.ridge else _ORDER_V)
    low, high = sample.lit(v, _beside_nodes(scene.lamp_angle, 1))
    low, high = (jnp.clip(sample.across(x[:, None] + side * panels.reach, v), low, high) for side in (-1, 1))
    inner = [low[..., None], high[..., None], *_cuts_along_u(scene, x, v, (low, high), panels)]
    along = jnp.sort(jnp.clip(jnp.concatenate(inner, axis=-1), low[..., None], high[..., None]), axis=-1)
    u, u_weight = nodes_in_panels(along, _ORDER_U_RIDGE if panels.ridge else _ORDER_U)
    return _through_kernel(scene, blur, (x, y), _SurfaceNodes(u, v[..., None], u_weight * v_weight[..., None]))


class _SurfaceNodes(NamedTuple):
    """Nodes on the surface about each pixel, arrays over (pixels, lines of v, nodes in u)."""

    u: jax.Array
    v: jax.Array
    weight: jax.Array


def _cuts_along_u(scene, x, v, ends, panels: WindowPanels) -> list[jax.Array]:  # type: ignore[no-untyped-def]
    """Return the places in u at which panels must end.

    Between them, on a trailing axis, the integrand is smooth.
    """
    sample, finest = scene.sample, scene.material.finest
    cuts = panels.reach * np.linspace(-1, 1, _RIDGE_PANELS + 1)[1:-1] if panels.ridge else jnp.zeros(1)
    if panels.cuts.size:
        cuts = jnp.concatenate([cuts, panels.cuts])
    by_kernel = sample.across(x[:, None, None] + cuts, v[..., None])
    if not panels.ridge:
        return [by_kernel]
    ridge = sample.highlight(_beside_nodes(scene.lamp_angle, 1))
    # no wider, close to the ridge, than the lobe is
    by_lobe = (ridge + 0 * v)[..., None] + jnp.hypot(finest, v)[..., None] * _RIDGE_CUTS
    # masking takes effect within the lobe's own width of the ends
    low, high = (end[..., None] for end in ends)
    return [by_kernel, by_lobe, low + finest * _MASKING_LAYER, high - finest * _MASKING_LAYER]


def _through_kernel(
    scene: Scene, blur: BlurTerms, pixels: tuple[jax.Array, jax.Array], nodes: _SurfaceNodes
) -> jax.Array:
    """Sum the light at the nodes, weighted by each pixel's kernel.

    A flat field's light follows as the last channel.
    """
    x, y = (a[:, None, None] for a in pixels)
    element = scene.sample.surface(nodes.u, nodes.v)
    lit = Scene(scene.material, scene.sample, _beside_nodes(scene.lamp_angle, 2))
    light, flat = lit.sent(element), lit.flat_field(element)
    spread_x, spread_y = blur.blur.spread(scene.sample, element.normal[2], lit.lamp_angle)
    total: jax.Array | float = 0.0
    for term in blur.terms:
        along = blur.blur.kernel(x - element.x, term, spread_x)
        across = blur.blur.kernel(y - element.y, term, spread_y)
        through = along * across * nodes.weight
        seen = jnp.sum(light * through[..., None], axis=(1, 2)), jnp.sum(flat * through, axis=(1, 2))[:, None]
        total += blur.blur.weights[term] * jnp.concatenate(seen, axis=-1)
    return jnp.asarray(total)


def _beside_nodes(lamp_angle: jax.Array, axes: int) -> jax.Array:
    """Reshape lamps to broadcast against `axes` further axes of nodes.

    A single lamp stays as it is.
    """
    return lamp_angle.reshape(*lamp_angle.shape, *([1] * axes)) if jnp.ndim(lamp_angle) else lamp_angle
