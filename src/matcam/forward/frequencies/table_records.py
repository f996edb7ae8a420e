"""Records of table cells on a sphere through a band-limited lens.

One image of the sphere contains one theta_d slice of a table. The radiance of the image is computed on a grid
(`light_grid.py`). The Fourier transform of the grid is multiplied by the transfer function of lens and pixel. The
filtered image is interpolated at the cells. The transfer function includes all aberrations of the lens. Camera and
point lamp must be distant, so that all cells of a slice are in one image.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import equinox as eqx
import numpy as np
from scipy.fft import next_fast_len

from matcam.camera.optics.gaussian import gaussian_sum
from matcam.core.jax import is_concrete, jax, jnp, placed, without_derivatives
from matcam.core.programs import kept_program
from matcam.forward.frequencies.band_limited import APART, EXACT, optics_band
from matcam.forward.frequencies.light_grid import Laying, LightGrid, margin_of, per_px_for, serves
from matcam.forward.frequencies.mirrored import MirroredTransfer
from matcam.forward.frequencies.picture_lens import colour_lens, shares_for
from matcam.forward.frequencies.position_shares import GridWeights, PositionShares
from matcam.forward.frequencies.reading import Reading
from matcam.forward.integral.scene import Scene, Turn
from matcam.forward.sampler.plan import RecordPositions
from matcam.material.material import Material
from matcam.rigs import Rig
from matcam.sample.curved import Sphere


class _Frame(NamedTuple):
    """Grid and frequencies of an image, and the transfer function of a lens at each frequency.

    Attributes:
        grid: grid of the radiance; if the radiance is symmetric about the x axis, the grid covers the upper half only.
        transfer: transfer function of lens and pixel divided by the transform of the window of `reading`, (shares, rows,
            columns), no unit. The columns are the frequencies along x that are not negative. It is a `MirroredTransfer` if
            radiance and lens are symmetric about the x axis.
        sides: rows and columns of the periodic image.
        per_px: number of points of the grid along the side of a pixel.
        reading: interpolation of the filtered image.
        weights: weights of the shares of the radiance, for a lens that varies over the field; None: there is one share.
    """

    grid: LightGrid
    transfer: jax.Array | MirroredTransfer
    sides: tuple[int, int]
    per_px: int
    reading: Reading
    weights: GridWeights | None = None


def served_by_frequencies(rig: Rig, material: Material) -> bool:
    """Check whether a table is computed by filtering images.

    This requires a distant camera in focus, a distant lamp, an isotropic lobe, and a sphere that is not too small. The lens
    must not be a sum of Gaussians. The lamp must be a point, because under a disc each slice would require as many images as
    the disc has points. Parameters must be concrete, apart from derivatives.
    """
    optics = rig.camera.optics
    known = without_derivatives((rig, material))
    if not all(map(is_concrete, jax.tree.leaves(known))):
        return False
    distant = rig.lamp.nearness is None and float(known[0].lamp_radius) == 0
    if not isinstance(rig.sample, Sphere) or not distant or float(known[0].aperture) > 0:
        return False
    if not serves(rig.sample, material.elongation, optics_band(optics)):
        return False
    return not optics.isotropic or float(gaussian_sum(known[0].camera.optics).total_error) > 0


def frequency_error(rig: Rig) -> float:
    """Compute the largest error of a transfer function in `record_by_frequencies`, no unit."""
    return EXACT + shares_for((rig.camera.optics,), float(without_derivatives(rig.sample).radius))[1]  # type: ignore[attr-defined]


def record_by_frequencies(
    material: Material, rig: Rig, lamps: np.ndarray, azimuth: float, positions: RecordPositions
) -> jax.Array:
    """Compute the record of a material at positions in the images of a sphere.

    Args:
        material: the material.
        rig: camera and sphere; see `served_by_frequencies`.
        lamps: angle between lamp and optical axis in each image, rad.
        azimuth: azimuth of all lamps, rad.
        positions: positions in ascending order of their images.

    Returns:
        Radiance under unit irradiance, 1/sr, (positions, channels). It is differentiable in the parameters of material,
        sample and lens.
    """
    sample = rig.sample
    assert isinstance(sample, Sphere)
    turn = Turn(placed(np.cos(azimuth)), placed(np.sin(azimuth))) if azimuth else None
    assert positions.picture is not None
    counts = np.bincount(positions.picture, minlength=lamps.size)
    ends, most = np.cumsum(counts), int(counts.max(initial=0))
    records = dict[int, jax.Array]()
    dark_left = (lamps >= np.pi / 2) & (turn is None)
    shares, _ = shares_for((rig.camera.optics,), float(jax.lax.stop_gradient(sample.radius)))
    for right_half in (True, False):
        pictures = np.flatnonzero((dark_left == right_half) & (counts > 0))
        if not pictures.size:
            continue
        frame = _frame(rig, sample, shares, right_half=right_half, symmetric=turn is None)
        known = all(map(is_concrete, jax.tree.leaves((material, sample, frame.transfer))))
        for k in pictures.tolist():
            # all images share a program, because they have equal numbers of positions
            index = np.minimum(np.arange(ends[k] - counts[k], ends[k] - counts[k] + most), ends[k] - 1)
            at = placed(positions.x[index]), placed(positions.y[index])
            scene = Scene(material, sample, placed(lamps[k]), None, turn)
            recorded: Callable[..., jax.Array] = partial(_recorded, frame.grid, frame.grid.laying(scene), at)
            if not known:
                recorded = eqx.filter_checkpoint(recorded)  # for derivatives, intermediate results are computed again
            records[k] = recorded(scene, frame)
    ordered = sorted(records)
    return jnp.stack([records[k] for k in ordered])[np.nonzero(np.arange(most) < counts[ordered, None])]


def _recorded(
    grid: LightGrid, laying: Laying, at: tuple[jax.Array, jax.Array], scene: Scene, frame: _Frame
) -> jax.Array:
    """Compute the record of a scene, shape (positions, channels), 1/sr. at: positions on the sensor, px."""
    return _read(grid.laid(scene, laying), frame, at)


def _frame(rig: Rig, sample: Sphere, shares: PositionShares | None, *, right_half: bool, symmetric: bool) -> _Frame:
    """Build the common grid of all images of a whole sphere or of its right half, and the transfer functions of the shares."""
    optics, pixel = rig.camera.optics, rig.camera.pixel
    highest, radius = optics_band(optics), float(jax.lax.stop_gradient(sample.radius))
    per_px = per_px_for(highest, radius)
    margin = int(np.ceil(margin_of(per_px, highest) * per_px))
    line = np.arange(-int(np.ceil(radius * per_px)) - margin, int(np.ceil(radius * per_px)) + margin + 1) / per_px
    x = line[line.size // 2 - margin :] if right_half else line
    y = line[line.size // 2 : -1] + 0.5 / per_px if symmetric else line
    wide = next_fast_len(x.size + APART * per_px, real=True)
    # half of the rows is an even number, too
    high = 4 * next_fast_len(-(-(line.size + APART * per_px) // 4))
    fx, fy = np.fft.rfftfreq(wide, 1 / per_px), np.fft.fftfreq(high, 1 / per_px)
    gaussian, reading = (jnp.pi * rig.jitter) ** 2, Reading.below(highest / per_px)
    lines = [
        jnp.where(np.abs(f) <= highest, pixel.mtf(f) * jnp.exp(-2 * gaussian * f**2), 0.0)
        / reading.transfer(np.minimum(np.abs(f), highest) / per_px)
        for f in (fx, fy)
    ]
    known = fy[: high // 2 + 1] if optics.isotropic else fy
    rows, columns = np.nonzero(np.hypot(fx, known[:, None]) <= highest)
    passed = jnp.stack([lens.otf(fx[columns], known[rows]) for lens in colour_lens(optics, shares).lenses])
    whole = jnp.zeros((len(passed), known.size, fx.size), passed.dtype).at[:, rows, columns].set(passed) * lines[0]
    grid, transfer = LightGrid.of(x, y, highest, symmetric=symmetric), lines[1][: known.size, None] * whole
    if symmetric and optics.isotropic:
        return _Frame(grid, MirroredTransfer.of(transfer[0, :-1]), (high, wide), per_px, reading)
    if optics.isotropic:  # symmetric above and below
        transfer = transfer[:, np.minimum(np.arange(high), high - np.arange(high))]
    weights = None if shares is None else shares.on_grid(_periodic(x, wide, False), _periodic(y, high, symmetric))
    return _Frame(grid, transfer, (high, wide), per_px, reading, weights)


def _periodic(line: np.ndarray, count: int, symmetric: bool) -> np.ndarray:
    """Positions of the points of a periodic image, px, (count,). They are 0 between the image and its periodic copy.

    symmetric: True if points below the axis follow after the last row.
    """
    whole = np.zeros(count)
    whole[: line.size] = line
    if symmetric:
        whole[-line.size :] = -line[::-1]
    return whole


@kept_program
def _read(light: jax.Array, frame: _Frame, at: tuple[jax.Array, jax.Array]) -> jax.Array:
    """Interpolate the filtered image, shape (positions, channels), 1/sr. at: positions on the sensor, px."""
    column, row = (
        (position - line[0]) * frame.per_px for position, line in zip(at, (frame.grid.x, frame.grid.y), strict=True)
    )
    transfer = frame.transfer
    if isinstance(transfer, MirroredTransfer):
        return frame.reading.values(transfer.seen(light, frame.sides[1]), row, column, mirrored=True)
    height, width, channels = light.shape
    # the image is periodic: positions below the axis follow after its last row
    whole = jnp.zeros((*frame.sides, channels)).at[:height, :width].set(light)
    if frame.grid.symmetric:
        whole = whole.at[-height:, :width].set(light[::-1])

    def filtered(share: int | jax.Array) -> jax.Array:
        part = whole if frame.weights is None else whole * frame.weights.of(share)
        return jnp.fft.rfft2(part, axes=(0, 1)) * transfer[share, ..., None]

    spectrum = filtered(0)
    if frame.weights is not None:
        spectrum = jax.lax.fori_loop(1, len(transfer), lambda k, sum_: sum_ + filtered(k), spectrum)
    return frame.reading.values(jnp.fft.irfft2(spectrum, frame.sides, axes=(0, 1)), row, column)
