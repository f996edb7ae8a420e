"""Pictures of a flat textured sample, tilted about the picture's vertical axis: truth for maps that are read from photographs.

The texture is a sum of plane waves: a diffuse albedo and the strength of a GGX lobe of one roughness (Walter et al. 2007,
Smith's masking, height-correlated). A wave of frequency (a, b) on the sample arrives at (a / cos tilt, b) on the sensor,
through a Gaussian lens and a box pixel. So a picture is exact at every pixel's centre, with no grid between. Camera and lamp
are far away.

Imports nothing of the package. Vectors: x right, y up, z to the camera; row 0 on top.
"""

from typing import NamedTuple

import numpy as np

from tests.oracle.capture import Drawn, Sensor, _expose, _row
from tests.oracle.sphere_picture import direction


class Texture(NamedTuple):
    """waves: complex amplitudes (rows, columns), frequencies of `periods` px; mean; of a map that is real."""

    mean: float
    waves: np.ndarray
    period: int

    def at(self, x, y, transfer=None, tilt=0.0):
        """Values at places on the sample, px from its centre, x right, y up: (len(y), len(x)). transfer: of frequencies on the
        sensor, cycles/px."""
        index = _frequencies(self.waves.shape[0])
        across, along = (
            np.exp(2j * np.pi * np.outer(y, index) / self.period),
            np.exp(2j * np.pi * np.outer(index, x) / self.period),
        )
        waves = self.waves
        if transfer is not None:
            waves = waves * transfer(index[None, :] / self.period / np.cos(tilt), index[:, None] / self.period)
        return self.mean + (across @ waves @ along).real


def _frequencies(count):
    return np.arange(count) - count // 2


def random_texture(mean, rms, slope, period, rng, band=0.5):
    """Waves of random phase and Gaussian amplitude with a power of frequency^slope from 4 waves a period up to `band`."""
    reach = int(np.floor(band * period))
    index = _frequencies(2 * reach + 1)
    size = np.hypot(index[:, None], index[None, :])
    power = np.where((size >= 4) & (size <= reach), np.maximum(size, 1.0) ** slope, 0.0)
    waves = np.sqrt(power) * (rng.standard_normal(power.shape) + 1j * rng.standard_normal(power.shape))
    return Texture(mean, waves * rms / np.sqrt((np.abs(waves) ** 2).sum() / 2), period)


class FlatStand(NamedTuple):
    """shape of the picture; lens and half pixel, px; roughness of the lobe."""

    shape: tuple = (192, 192)
    sigma: float = 0.6
    half_width: float = 0.5
    alpha: float = 0.2

    def transfer(self, a, b):
        lens = np.exp(-2 * np.pi**2 * self.sigma**2 * (a**2 + b**2))
        return lens * np.sinc(2 * self.half_width * a) * np.sinc(2 * self.half_width * b)

    def weights(self, tilt, towards):
        """Radiance of a white Lambertian surface and of the lobe at F = 1, for unit irradiance of what faces the lamp."""
        normal, view = np.array([np.sin(tilt), 0, np.cos(tilt)]), np.array([0, 0, 1.0])
        half = (towards + view) / np.linalg.norm(towards + view)
        cos_i, cos_o, cos_h = normal @ towards, normal[2], normal @ half
        a2 = self.alpha**2
        d = a2 / (np.pi * (cos_h**2 * (a2 - 1) + 1) ** 2)
        hidden = sum((np.sqrt(1 + a2 * (1 / c**2 - 1)) - 1) / 2 for c in (cos_i, cos_o))
        return cos_i / np.pi, d / (1 + hidden) / (4 * cos_o)

    def picture(self, diffuse, specular, tilt, towards):
        """Radiance (height, width)."""
        height, width = self.shape
        x = (np.arange(width) - (width - 1) / 2) / np.cos(tilt)
        y = (height - 1) / 2 - np.arange(height)
        white, lobe = self.weights(tilt, towards)
        return white * diffuse.at(x, y, self.transfer, tilt) + lobe * specular.at(x, y, self.transfer, tilt)


def draw(
    diffuse, specular, stand, tilts, lamps, *, exposures=2, step=4.0, gain_std=0.005, lens_std=0.03, sensor=None, seed=0
):
    """Draw a capture: grey pictures with Poisson and read noise. tilts: rad. lamps: (angle, azimuth) of each picture, rad."""
    sensor = sensor or Sensor(cfa=None)
    rng = np.random.default_rng(seed)
    gains = np.exp(gain_std * rng.standard_normal(len(tilts)))
    seen = [
        g * stand.picture(diffuse, specular, tilt, direction(*lamp))
        for g, tilt, lamp in zip(gains, tilts, lamps, strict=True)
    ]
    relative = step ** np.arange(exposures)
    scale = 0.8 * sensor.full_well / max(one.max() for one in seen) / relative[-1]
    drawn = Drawn()
    for i, (clean, lamp) in enumerate(zip(seen, lamps, strict=True)):
        for k, ratio in enumerate(relative):
            file = f"frames/L{i:02d}_E{k}.tif"
            drawn.frames[file] = _expose(scale * ratio * np.maximum(clean, 0), sensor, rng)
            drawn.rows.append(_row(file, f"L{i:02d}", *np.degrees(lamp), f"E{k}", ratio / 1000))
    for k, ratio in enumerate(relative):
        for i in range(2):
            drawn.frames[f"dark/D{i}_E{k}.tif"] = _expose(np.zeros(stand.shape), sensor, rng)
            drawn.rows.append(_row(f"dark/D{i}_E{k}.tif", "", None, None, f"E{k}", ratio / 1000))
    drawn.settings = {
        "format": "matcam capture",
        "version": 1,
        "camera": {"profile": "camera.json"},
        "sample": {"kind": "flat", "tilt_deg": [float(np.degrees(t)) for t in tilts], "mm_per_px": 0.02},
        "lamp": {"gain_std": gain_std},
    }
    sigma = stand.sigma * np.exp(lens_std * rng.standard_normal())
    drawn.profile = {
        "format": "matcam camera profile",
        "version": 2,
        "optics": {"model": "gaussian", "sigma_px": sigma},
        "pixel": {"model": "box", "half_width_px": stand.half_width},
        "uncertainty": {"parameters": ["optics.sigma_px"], "covariance": [[(lens_std * sigma) ** 2]]},
        "provenance": {"source": "synthetic", "created": "2026-01-01", "software": "an oracle", "notes": ""},
    }
    drawn.truth = {"gains": gains.tolist(), "alpha": stand.alpha, "electrons_per_radiance": scale}
    return drawn
