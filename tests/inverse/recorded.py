"""Tables of materials whose truth is the oracle's, in the cells that a fit chooses, and the bound on what can be known."""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
import xarray as xr

from matcam import BoxPixel, Camera, GaussianOptics, Microfacet, Rig, Sphere
from matcam.camera import PixelNoise, Uncertainty
from matcam.core.grid import merl_grid
from matcam.forward.integral.blur import imaging_of
from matcam.forward.sampler.plan import RecordPositions, record_plan
from matcam.forward.sampler.record import record
from matcam.inverse.operator.chosen_cells import chosen_cells
from matcam.inverse.operator.sample_view import SampleView
from tests.oracle import sphere_cells as oracle
from tests.oracle.merl_lobe import conductor

GRID = merl_grid("centre")
NOISE = PixelNoise(0.01, 1e-4, 0.01)
CHROMIUM = (2.9, 4.23)
SEVENTY_FIVE = np.radians(75.0)


def rig(sigma=0.5, std=None, **more):
    """MERL's, its lens known to `std` px; None: exactly, and stated so."""
    known = Uncertainty.of({"optics.sigma_px": 0.0 if std is None else std})
    return Rig(Camera(GaussianOptics(sigma), BoxPixel(0.5), uncertainty=known), Sphere(256.0), **more)


class Pictures(NamedTuple):
    """Chosen cells of some slices, and the oracle's rule for them."""

    cells: object
    rule: oracle.Cells

    def table(self, values):
        """(slices, cells) as a table of one channel, everything else missing."""
        return table_of(self.cells, values)


def table_of(cells, values):
    whole = np.full((90, 90, 180, 1), np.nan)
    slices = np.broadcast_to(cells.slices[:, None], values.shape)[cells.valid]
    whole[cells.i_theta_h[cells.valid], slices, cells.i_phi_d[cells.valid], 0] = values[cells.valid]
    coords = {"theta_h": GRID.theta_h, "theta_d": GRID.theta_d, "phi_d": GRID.phi_d, "channel": ["G"]}
    return xr.DataArray(
        whole, dims=("theta_h", "theta_d", "phi_d", "channel"), coords=coords, attrs={"sampling": "centre"}
    )


def made(slice_step, setup):
    cells = chosen_cells(SampleView(setup.radius), "centre", slice_step)
    rule = oracle.Cells(GRID.theta_h[cells.i_theta_h], cells.theta_d, GRID.phi_d[cells.i_phi_d], setup)
    return Pictures(cells, rule)


@lru_cache(maxsize=1)
def pictures(slice_step, setup=None):
    """Kept for the next test that asks for the same."""
    return made(slice_step, setup or oracle.Setup())


def measured(ndf, rig, cells):
    """Values of chosen cells, F = 1, Smith, by the operator that `measure` applies; (slices, cells)."""
    slices, numbers = np.nonzero(cells.valid)
    lamps, directions, turn = 2 * np.asarray(cells.theta_d), cells.x.shape[-1], rig.lamp_azimuth
    picture = np.repeat(slices, directions)
    x, y = (np.asarray(at)[slices, numbers].ravel() for at in (cells.x, cells.y))
    azimuth = None
    if turn is not None:
        x, y = x * np.cos(turn) - y * np.sin(turn), y * np.cos(turn) + x * np.sin(turn)
        azimuth = np.full(x.size, turn)
    imaging = imaging_of(rig)
    material = Microfacet(ndf, 1.0)
    plan = record_plan(imaging, RecordPositions(x, y, lamps[picture], azimuth), float(material.finest))
    recorded = np.asarray(record(material, imaging, plan))
    values = np.full(cells.valid.shape, np.nan)
    cos_i = np.asarray(cells.cos_i)[slices, numbers]
    values[slices, numbers] = np.mean(recorded[:, 0].reshape(-1, directions) / cos_i, axis=-1)
    return values


def draw(count, seed):
    """Materials: GGX and EPD with power 0.5 to 2 in turn, roughness log-uniform in [0.001, 0.2]."""
    random = np.random.default_rng(seed)
    rough = np.exp(random.uniform(*np.log([0.001, 0.2]), count))
    power = np.exp(random.uniform(*np.log([0.5, 2.0]), count))
    return [oracle.EPD(r, p) if n % 2 else oracle.GGX(r) for n, (r, p) in enumerate(zip(rough, power, strict=True))]


def family(lobe):
    return "epd" if isinstance(lobe, oracle.EPD) else "ggx"


def half_width(lobe):
    """Half width at half maximum of D, rad, by bisection of D = P22 / cos^4."""
    low, high = 1e-9, 1.5
    top = lobe.p22(1e-24)
    for _ in range(80):
        middle = np.sqrt(low * high)
        falls = lobe.p22(np.tan(middle) ** 2) / np.cos(middle) ** 4 < top / 2
        low, high = (low, middle) if falls else (middle, high)
    return low


def bound(shot, lobe, n=CHROMIUM[0], k=CHROMIUM[1], noise=NOISE, sigmas=None):
    """Covariance that no unbiased estimate can undercut (Cramer-Rao) of the logarithms of the lobe's numbers, of n and k,
    from the oracle's own derivatives; pictures' gains are nuisances. sigmas: (lower, upper) shots and the prior's
    relative std, if ln sigma_mtf is free too."""
    usable = np.isfinite(shot.rule.directions(lobe)).all(-1) & shot.cells.valid
    theta = shot.cells.theta_d[:, None]

    def model(numbers, n, k, rule=shot.rule):
        return rule.directions(type(lobe)(*numbers)).mean(-1) * conductor(theta, n, k)

    at = model(lobe, n, k)
    columns, step = [], 1e-4
    for i in range(len(lobe)):
        moved = [[v * np.exp(side * step * (i == j)) for j, v in enumerate(lobe)] for side in (1, -1)]
        columns.append((model(moved[0], n, k) - model(moved[1], n, k)) / (2 * step))
    for i in range(2):
        up, down = ([v * np.exp(side * step * (i == j)) for j, v in enumerate((n, k))] for side in (1, -1))
        columns.append((model(lobe, *up) - model(lobe, *down)) / (2 * step))
    if sigmas:
        low, high, _ = sigmas
        rules = (model(lobe, n, k, low.rule), model(lobe, n, k, high.rule))
        columns.append((rules[1] - rules[0]) / np.log(high.rule.setup.sigma / low.rule.setup.sigma))
    share = np.where(shot.cells.one_pixel, 1.0, 0.5)
    peak = np.max(np.where(usable, at, 0), axis=1, keepdims=True)
    variance = share * ((noise.relative * at) ** 2 + (noise.floor * peak) ** 2)
    root = np.where(usable, 1 / np.sqrt(np.where(usable, variance, 1)), 0)
    columns = np.nan_to_num(np.array(columns)) * root
    along = np.nan_to_num(at) * root
    product = np.einsum("psn,qsn->pq", columns, columns)
    with_gain = np.einsum("psn,sn->ps", columns, along)
    product -= np.einsum(
        "ps,qs,s->pq", with_gain, with_gain, 1 / (1 / max(noise.picture_gain, 1e-9) ** 2 + (along**2).sum(-1))
    )
    if sigmas:
        product[-1, -1] += 1 / sigmas[2] ** 2
    return np.linalg.inv(product)
