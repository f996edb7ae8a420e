"""Integrals for the record of a scene: around a highlight, inside smooth light, and at the ends of the light.

A pixel receives radiance rho cos_i, not rho (docs/model.md 3). With dx dy = area cos_o du dv, the record is

    R(x) = integral over the visible, lit surface of  k(x - x(u, v)) rho cos_i cos_o area du dv.

All cosines in denominators cancel, so the integrand is regular at the limb.

- `record_around`: over normals about the half vector. The nodes become denser towards the half vector on the scale of
  the lobe, and their distances resolve the kernel, so a highlight of a thousandth of a pixel is integrated accurately.
  Nodes and kernel are products in u and v, so two matrix products give all pixels of a rectangle. Through a lens out of
  focus this applies to shares of the light, each with one disc (`disc_stamps.py`).
- `record_inside`: few nodes on the sensor about each pixel, where the light is smooth on the scale of the kernel.
- `record_in_window`: over (u, v) about each pixel, along limb and terminator. The visible and lit surface is one
  interval of u with known ends, and the light is smooth up to them.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jax.typing import ArrayLike

from matcam.core.jax import jax, jnp
from matcam.forward.integral.blur import Blur, BlurTerms, Line
from matcam.forward.integral.disc_stamps import DiscShares
from matcam.forward.integral.pupil import mean_over_pupil
from matcam.forward.integral.scene import Scene, beside_nodes
from matcam.numerics.approximation import ascending, graded_nodes, nodes_in_panels
from matcam.sample.shape import Element

# panels across a squeezed lobe, and their borders in widths of the lobe, where masking sets in
_RIDGE_PANELS = 4
_RIDGE_CUTS = np.array([-2.0, 0.0, 2.0])
_MASKING_LAYER = np.array([3.0])
_ALONG = 1e-9
"""Sine of an angle below which two lines are treated as parallel."""


class HighlightPanels(NamedTuple):
    """Panels of the integral around a highlight.

    Attributes:
        graded: number of panels that grow outwards from the scale of the lobe.
        even: number of equal panels between the half vector and the border.
        order: number of Gauss-Legendre nodes per panel.
        margin: number of points by which a record is smaller than the requested rectangle, if light is divided.
        shares: number of shares of light by disc out of focus; 0: in focus.
    """

    graded: int
    even: int
    order: int
    margin: int = 0
    shares: int = 0


class WindowPanels(NamedTuple):
    """Panels of the integral in a window about a pixel.

    Attributes:
        reach: support radius of the kernel, px.
        cuts: offsets, px, between which the kernel is smooth; none if it is smooth everywhere.
        along_v: number of panels along v.
        ridge: True if a squeezed lobe crosses the window. Towards the limb the normal varies within a pixel, and a lobe
            is a narrow ridge even far from its peak, along the u of the half vector.
        orders: Gauss-Legendre nodes per panel along u and v.
    """

    reach: jax.Array
    cuts: jax.Array
    along_v: int
    ridge: bool
    orders: tuple[int, int]


def record_around(
    scene: Scene, blur: BlurTerms, x: jax.Array, y: jax.Array, reach: ArrayLike, panels: HighlightPanels
) -> jax.Array:
    """Record a rectangle of pixels at or beside the highlight.

    Args:
        scene: the light; its lamp_angle has shape ().
        blur: the terms to record through.
        x: columns of the rectangle, (columns,), px.
        y: rows of the rectangle, (rows,), px.
        reach: support radius of the terms, px.
        panels: fineness of the integral.

    Returns:
        Radiance per unit irradiance, (rows, columns, channels + 1). The last channel is the record of a flat field of
        radiance 1 on the lit surface.
    """
    extent_y = jnp.max(jnp.abs(y)) + reach
    u, v, weight = _around(scene, (jnp.min(x) - reach, jnp.max(x) + reach), extent_y, panels)
    element = scene.sample.surface(u, v[:, None])
    light = jnp.concatenate([scene.sent(element), scene.flat_field(element)[..., None]], axis=-1) * weight[..., None]
    spread = blur.blur.spread(scene.sample, element.normal[2], scene.lamp_angle, scene.lamp_nearness)
    shares = DiscShares.over(blur.blur, scene.sample, element, panels.shares)
    light = shares.divided(light, element)

    def recorded(along: Line, across: Line) -> jax.Array:
        columns = along(x[:, None, None] - element.x)
        # the plane of camera and lamp is a plane of symmetry
        above, below = (y[:, None, None] - sign * element.y for sign in (1, -1))
        rows = across(above) + across(below)
        if rows.shape[-1] == 1:
            by_line = jnp.einsum("xvu,vuc->vxc", columns, light)
            return jnp.einsum("yv,vxc->yxc", rows[..., 0], by_line)
        return jnp.einsum("yvu,xvu,vuc->yxc", rows, columns, light)

    total = jnp.zeros((y.size, x.size, light.shape[-1]))
    for term in blur.terms:
        total += blur.blur.share(term) * shares.through.through_disc(term, spread, recorded)
    return shares.together(total, x[1] - x[0], panels.margin)


def record_around_turned(
    scene: Scene, blur: BlurTerms, x: jax.Array, y: jax.Array, reach: ArrayLike, panels: HighlightPanels
) -> jax.Array:
    """Record a rectangle of pixels that is turned relative to the plane of camera and lamp.

    Kernel and nodes are then not products in x and y, and the two sides of the plane differ.

    Args:
        scene: the light; its lamp_angle and turn have shape ().
        blur: the terms to record through.
        x: columns of the rectangle on the sensor, (columns,), px.
        y: rows of the rectangle, (rows,), px.
        reach: support radius of the terms, px.
        panels: fineness of the integral.

    Returns: as of `record_around`.
    """
    corners = scene.from_sensor(*(a.ravel() for a in jnp.meshgrid(jnp.stack([x[0], x[-1]]), jnp.stack([y[0], y[-1]]))))
    ends = jnp.min(corners[0]) - reach, jnp.max(corners[0]) + reach
    u, v, weight = _around(scene, ends, jnp.max(jnp.abs(corners[1])) + reach, panels)
    shares = DiscShares.over(blur.blur, scene.sample, scene.sample.surface(u, v[:, None]), panels.shares)

    def line(total: jax.Array, nodes: tuple[jax.Array, jax.Array, jax.Array]) -> tuple[jax.Array, None]:
        """Add the light of a line of nodes, a few hundred at one v."""
        element = scene.sample.surface(nodes[0], nodes[1])
        light = jnp.concatenate([scene.sent(element), scene.flat_field(element)[..., None]], axis=-1)
        light *= nodes[2][:, None]
        light = shares.divided(light, element)
        spread = blur.blur.spread(scene.sample, element.normal[2], scene.lamp_angle, scene.lamp_nearness)
        at_x, at_y = scene.on_sensor(element.x, element.y)

        def recorded(along: Line, across: Line) -> jax.Array:
            columns = (along(x[:, None] - at_x)[:, :, None] * light).transpose(1, 0, 2)
            return across(y[:, None] - at_y) @ columns.reshape(light.shape[0], -1)

        for term in blur.terms:
            seen = shares.through.through_disc(term, spread, recorded)
            total += (blur.blur.share(term) * seen).reshape(total.shape)
        return total, None

    both = jnp.concatenate([u, u]), jnp.concatenate([v, -v]), jnp.concatenate([weight, weight])
    channels = (scene.channels() + 1) * max(panels.shares, 1)
    total = jax.lax.scan(line, jnp.zeros((y.size, x.size, channels)), both)[0]
    return shares.together(total, x[1] - x[0], panels.margin)


def _around(
    scene: Scene, ends_x: tuple[jax.Array, jax.Array], extent_y: jax.Array, panels: HighlightPanels
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Compute nodes u (lines, nodes), v (lines,) on one side of the plane of camera and lamp, and weights of the shape
    of u.

    The nodes cover the range between two columns of the scene, and from its x axis to a row, px.
    """
    sample, lamp, near = scene.sample, scene.lamp_angle, scene.lamp_nearness
    peak, finest = sample.highlight(lamp, near), scene.material.finest
    shares = np.arange(panels.even + 1) / panels.even
    _, lines = sample.window(jnp.zeros(()), extent_y * shares, peak)
    if near is not None:
        lines = jnp.minimum(lines, sample.lit_rows(lamp, near))
    v, v_weight = graded_nodes(lines, finest, panels.graded, panels.order)
    low, high = sample.lit(v, lamp, near)
    middle = jnp.clip(peak, low, high)
    centre = sample.surface(middle, v).x
    sides = []
    for end in ends_x:
        at = sample.across(centre[:, None] + (end - centre)[:, None] * shares, v[:, None])
        borders = jnp.clip(at.at[:, 0].set(middle), low[:, None], high[:, None])
        sides.append(graded_nodes(borders, finest, panels.graded, panels.order))
    u = jnp.concatenate([nodes for nodes, _ in sides], axis=1)
    # on the lower side the order of the nodes is reversed, and their weights are negative
    return u, v, jnp.concatenate([-sides[0][1], sides[1][1]], axis=1) * v_weight[:, None]


def record_inside(scene: Scene, blur: BlurTerms, x: jax.Array, y: jax.Array) -> jax.Array:
    """Record pixels whose kernel contains neither the highlight nor an end of the light.

    Args:
        scene: the light, under one lamp or one per pixel.
        blur: the terms to record through.
        x: columns of the pixels, (pixels,), px.
        y: rows of the pixels, (pixels,), px.

    Returns:
        Radiance per unit irradiance, (pixels, channels).
    """
    total: jax.Array | float = 0.0
    centre, _ = scene.sample.at(*scene.from_sensor(x, y))
    spread = blur.blur.spread(scene.sample, centre.normal[2], scene.lamp_angle, scene.lamp_nearness)
    scene = scene.beside_nodes(1)
    for term in blur.terms:
        dx, dy, share = blur.blur.plane_rule(term, spread)
        light = _arriving(scene, blur.blur, x[:, None] - dx, y[:, None] - dy)
        if blur.blur.is_rest(term):  # the corners of the residual have negligible weight and may lie beyond the limb
            _, lit = scene.shown(x[:, None] - dx, y[:, None] - dy)
            light = jnp.where(lit[..., None], light, 0.0)
        total += blur.blur.share(term) * jnp.sum(light * share[..., None], axis=1)
    return jnp.asarray(total)


def _arriving(scene: Scene, blur: Blur, x: jax.Array, y: jax.Array) -> jax.Array:
    """Compute the light at positions of the sensor, px, through a lens whose only blur is defocus."""

    def seen(at_x: jax.Array, at_y: jax.Array) -> Element:
        return scene.sample.at(*scene.from_sensor(at_x, at_y))[0]

    def sent(at_x: jax.Array, at_y: jax.Array) -> jax.Array:
        return scene.sent(seen(at_x, at_y))

    def disc(at_x: jax.Array, at_y: jax.Array) -> jax.Array:
        return blur.defocus(scene.sample.radius, seen(at_x, at_y).normal[2])

    return mean_over_pupil(sent, disc, x, y) if blur.chords else sent(x, y)


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
    sample, lamps = scene.sample, scene.beside_nodes(1)
    at_x, at_y = scene.from_sensor(x, y)
    first, last = (end[:, None] for end in sample.rows(at_x, at_y, panels.reach))
    if scene.lamp_nearness is not None:
        most = sample.lit_rows(lamps.lamp_angle, scene.lamp_nearness)
        first, last = jnp.clip(first, -most, most), jnp.clip(last, -most, most)
    borders = first + (last - first) * np.linspace(0, 1, panels.along_v + 1)
    if panels.cuts.size:
        if scene.turn is None:
            at = y[:, None] + panels.cuts
        else:  # rows of the corners of the pixel: between them a border of the pixel crosses each row at one position
            corners = jnp.meshgrid(panels.cuts, panels.cuts)
            at = at_y[:, None] + lamps.from_sensor(*(a.ravel() for a in corners))[1]
        stepped, _ = sample.window(at, at, sample.across(at_x, jnp.zeros_like(x))[:, None])
        borders = jnp.sort(jnp.concatenate([borders, jnp.clip(stepped, first, last)], axis=-1), axis=-1)
    v, v_weight = nodes_in_panels(borders, panels.orders[1])
    low, high = sample.lit(v, lamps.lamp_angle, scene.lamp_nearness)
    low, high = (jnp.clip(sample.across(at_x[:, None] + side * panels.reach, v), low, high) for side in (-1, 1))
    by_kernel, *others = _cuts_along_u(scene, (at_x, at_y), v, (low, high), panels)
    first_cuts = [low, *jnp.unstack(by_kernel, axis=-1), high]
    more = [jnp.clip(cut, low, high) for cuts in others for cut in jnp.unstack(cuts, axis=-1)]
    along = ascending([*(jnp.clip(cut, low, high) for cut in first_cuts), *more], len(first_cuts))
    u, u_weight = nodes_in_panels(along, panels.orders[0])
    return _through_kernel(scene, blur, (x, y), _SurfaceNodes(u, v[..., None], u_weight * v_weight[..., None]))


class _SurfaceNodes(NamedTuple):
    """Nodes on the surface about each pixel, arrays over (pixels, lines of v, nodes in u)."""

    u: jax.Array
    v: jax.Array
    weight: jax.Array


def _cuts_along_u(scene, places, v, ends, panels: WindowPanels) -> list[jax.Array]:  # type: ignore[no-untyped-def]
    """Compute the positions in u between which the integrand is smooth, on a trailing axis.

    Panels must end at these positions. The positions in the first array are in ascending order.
    """
    sample, finest, (x, y) = scene.sample, scene.material.finest, places
    cuts = panels.reach * np.linspace(-1, 1, _RIDGE_PANELS + 1)[1:-1] if panels.ridge else jnp.zeros(1)
    by_kernel = [sample.across(x[:, None, None] + cuts, v[..., None])]
    if panels.cuts.size and scene.turn is None:
        by_kernel.append(sample.across(x[:, None, None] + panels.cuts, v[..., None]))
    elif panels.cuts.size:  # crossings of the turned borders of the pixel with a row
        lamps = scene.beside_nodes(2)
        cosine, sine = (_away_from_zero(a) for a in lamps.turn)
        row = sample.surface(sample.across(x[:, None], v), v).y[..., None] - y[:, None, None]
        for offset in ((panels.cuts + row * sine) / cosine, (panels.cuts - row * cosine) / sine):
            within = jnp.clip(offset, -panels.reach, panels.reach)
            by_kernel.append(sample.across(x[:, None, None] + within, v[..., None]))
    if not panels.ridge:
        return by_kernel
    ridge = sample.highlight(beside_nodes(scene.lamp_angle, 1), scene.lamp_nearness)
    # close to the ridge no wider than the lobe
    by_lobe = (ridge + 0 * v)[..., None] + jnp.hypot(finest, v)[..., None] * _RIDGE_CUTS
    # masking sets in within the width of the lobe from the ends
    low, high = (end[..., None] for end in ends)
    return [*by_kernel, by_lobe, low + finest * _MASKING_LAYER, high - finest * _MASKING_LAYER]


def _away_from_zero(a: jax.Array) -> jax.Array:
    """Replace a divisor that is almost 0, where a border is parallel to a row."""
    return jnp.where(jnp.abs(a) > _ALONG, a, _ALONG)


def _through_kernel(
    scene: Scene, blur: BlurTerms, pixels: tuple[jax.Array, jax.Array], nodes: _SurfaceNodes
) -> jax.Array:
    """Sum the light at the nodes, weighted by each pixel's kernel.

    The last channel is the light of a flat field.
    """
    x, y = (a[:, None, None] for a in pixels)
    element = scene.sample.surface(nodes.u, nodes.v)
    lit = scene.beside_nodes(2)
    light, flat = lit.sent(element), lit.flat_field(element)
    spread = blur.blur.spread(scene.sample, element.normal[2], lit.lamp_angle, lit.lamp_nearness)
    total: jax.Array | float = 0.0
    at_x, at_y = lit.on_sensor(element.x, element.y)
    for term in blur.terms:
        kernel = blur.blur.at(term, spread, x - at_x, y - at_y)
        through = kernel * nodes.weight
        seen = jnp.sum(light * through[..., None], axis=(1, 2)), jnp.sum(flat * through, axis=(1, 2))[:, None]
        total += blur.blur.share(term) * jnp.concatenate(seen, axis=-1)
    return jnp.asarray(total)
