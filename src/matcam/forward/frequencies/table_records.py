"""Records of a sphere's pictures at the places of a table's cells, through a lens that ends at a frequency.

One picture of the sphere is one theta_d slice of a table. Its light is laid on a grid (`light_grid.py`), the grid's transform
multiplied by that of lens and pixel, and what comes back is read off at the cells. A Gaussian is no detour, and the lens is
its transfer function, aberrations and all. It takes a distant camera and a distant lamp without a disc: all cells of a slice
then lie in one picture.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import equinox as eqx
import numpy as np
from scipy.fft import next_fast_len

from matcam.camera.optics.gaussian import gaussian_sum
from matcam.camera.optics.seidel import SeidelOptics
from matcam.core.jax import AnyArray, is_concrete, jax, jnp, placed, without_derivatives
from matcam.core.programs import kept_program
from matcam.forward.frequencies.band_limited import APART, optics_band
from matcam.forward.frequencies.light_grid import LightGrid, margin_of, per_px_for, serves
from matcam.forward.frequencies.reading import Reading
from matcam.forward.integral.plan import RecordPlaces
from matcam.forward.integral.scene import Scene, Turn
from matcam.material.material import Material
from matcam.rigs import Rig
from matcam.sample.curved import Sphere

_SHARES = 0.25, 0.5, 1.0
"""Of the sphere's width, within which a picture's light may lie: few kinds, each of which is a program."""


class _Shown(NamedTuple):
    """A picture's frequencies, and what a lens lets pass of each.

    Attributes:
        transfer: of lens, pixel and the reading, (rows, columns of half the plane), no unit.
        sides: rows and columns of the periodic picture.
        per_px: its points a pixel.
        reading: how values are read off it.
    """

    transfer: jax.Array
    sides: tuple[int, int]
    per_px: int
    reading: Reading


def served_by_frequencies(rig: Rig, material: Material) -> bool:
    """Tell whether a table is recorded so: through a lens that is no sum of Gaussians, where all is distant.

    A lens may end at a frequency as its derivatives are asked for, not where its numbers are not known yet.
    """
    optics = rig.camera.optics
    known = without_derivatives((rig, material))
    if isinstance(optics, SeidelOptics) or not all(map(is_concrete, jax.tree.leaves(known))):
        return False
    distant = rig.lamp.nearness is None and float(known[0].lamp_radius) == 0
    if not isinstance(rig.sample, Sphere) or not distant or float(known[0].aperture) > 0:
        return False
    if not serves(rig.sample, material.elongation, optics_band(optics)):
        return False
    return not optics.isotropic or float(gaussian_sum(known[0].camera.optics).total_error) > 0


def record_by_frequencies(
    material: Material, rig: Rig, lamps: np.ndarray, azimuth: float, places: RecordPlaces
) -> jax.Array:
    """Record a material at places in the pictures of a sphere.

    Args:
        material: the material.
        rig: camera and sphere; see `served_by_frequencies`.
        lamps: of each picture, the angle between its lamp and the optical axis, rad.
        azimuth: of all lamps, rad.
        places: in ascending order of their pictures.

    Returns:
        Radiance under unit irradiance, 1/sr, (places, channels). Differentiable in material, sample and lens.
    """
    alike, sample = azimuth == 0, rig.sample
    assert isinstance(sample, Sphere)
    highest = optics_band(rig.camera.optics)
    radius = float(jax.lax.stop_gradient(sample.radius))
    per_px = per_px_for(highest, radius)
    turn = None if alike else Turn(jnp.cos(azimuth), jnp.sin(azimuth))
    counts = np.bincount(places.picture, minlength=lamps.size)
    ends = np.cumsum(counts)
    records: list[jax.Array] = [jnp.zeros((0, 1))] * lamps.size
    for share, of_share in _by_lit_share(lamps, alike):
        grid = _grid(radius, share, per_px, highest, alike)
        shown = _shown(grid, rig, highest, per_px)
        most = int(counts[of_share].max())
        recorded: Callable[..., jax.Array] = partial(_recorded, grid, turn)
        if not all(map(is_concrete, jax.tree.leaves((material, sample, shown.transfer)))):
            recorded = eqx.filter_checkpoint(recorded)  # what each picture needs for derivatives is made again
        for k in of_share[counts[of_share] > 0]:
            # one program for all pictures: of as many places
            index = np.minimum(np.arange(ends[k] - counts[k], ends[k] - counts[k] + most), ends[k] - 1)
            at = placed(places.x[index]), placed(places.y[index])
            records[k] = recorded(material, sample, shown, placed(lamps[k]), at)[: counts[k]]
    return jnp.concatenate([record for record, count in zip(records, counts, strict=True) if count])


def _recorded(
    grid: LightGrid,
    turn: Turn | None,
    material: Material,
    sample: Sphere,
    shown: _Shown,
    lamp: jax.Array,
    at: tuple[jax.Array, jax.Array],
) -> jax.Array:
    """Return what places on the sensor, px, show in one picture: 1/sr, (places, channels)."""
    light = grid.laid(Scene(material, sample, lamp, None, turn))
    return _read(light, shown, (grid.x[0], grid.y[0]), grid.alike, at)


def _by_lit_share(lamps: np.ndarray, alike: bool) -> list[tuple[float, np.ndarray]]:
    """Return the pictures whose light lies in the right-hand quarter, half or all of the sphere's width."""
    lit = (1 + np.cos(lamps)) / 2 if alike else np.ones(lamps.size)
    found, before = [], -1.0
    for share in _SHARES:
        found.append((share, np.flatnonzero((lit > before) & (lit <= share))))
        before = share
    return [(share, pictures) for share, pictures in found if pictures.size]


def _grid(radius: float, share: float, per_px: int, highest: float, alike: bool) -> LightGrid:
    """Return a grid that holds a sphere's light: a share of its width; above and below the axis only where it is not alike."""
    count = int(np.ceil((radius + margin_of(per_px, highest)) * per_px))
    first = -count if share == 1 else int(np.floor((1 - 2 * share) * radius * per_px)) - (count - int(radius * per_px))
    line = np.arange(-count, count + 1) / per_px
    return LightGrid.of(line[first + count :], line[count:] if alike else line, highest, alike=alike)


def _shown(grid: LightGrid, rig: Rig, highest: float, per_px: int) -> _Shown:
    optics, pixel = rig.camera.optics, rig.camera.pixel
    heights = 2 * grid.y.size - 1 if grid.alike else grid.y.size
    high, wide = (next_fast_len(size + APART * per_px, real=True) for size in (heights, grid.x.size))
    fx, fy = np.fft.rfftfreq(wide, 1 / per_px), np.fft.fftfreq(high, 1 / per_px)
    known = fy[: high // 2 + 1] if optics.isotropic else fy
    rows, columns = np.nonzero(np.hypot(fx, known[:, None]) <= highest)
    passed = optics.otf(fx[columns], known[rows])
    gaussian, reading = (jnp.pi * rig.jitter) ** 2, Reading.below(highest / per_px)
    lines = [
        jnp.where(jnp.abs(f) <= highest, pixel.mtf(f) * jnp.exp(-2 * gaussian * f**2), 0.0)
        / reading.transfer(np.minimum(np.abs(f), highest) / per_px)
        for f in (fx, fy)
    ]
    whole = jnp.zeros((known.size, fx.size), passed.dtype).at[rows, columns].set(passed)
    if optics.isotropic:  # the same below as above
        whole = whole[np.minimum(np.arange(high), high - np.arange(high))]
    return _Shown(whole * lines[0] * lines[1][:, None], (high, wide), per_px, reading)


@kept_program
def _read(
    light: jax.Array,
    shown: _Shown,
    first: tuple[AnyArray, AnyArray],
    alike: bool,
    at: tuple[jax.Array, jax.Array],
) -> jax.Array:
    """Return what is seen at places on the sensor, px: 1/sr, (places, channels)."""
    height, width, _ = light.shape
    # the picture goes on after its last row with its first: what lies below the axis stands there
    whole = jnp.zeros((*shown.sides, light.shape[-1]))
    if alike:
        whole = whole.at[:height, :width].set(light).at[1 - height :, :width].set(light[:0:-1])
    else:
        whole = whole.at[:height, :width].set(light)
    spectrum = jnp.fft.rfft2(whole, axes=(0, 1)) * shown.transfer[..., None]
    seen = jnp.fft.irfft2(spectrum, shown.sides, axes=(0, 1))
    column, row = ((place - start) * shown.per_px for place, start in zip(at, first, strict=True))
    return shown.reading.values(seen, row, column)
