"""Tables whose cells are looked up in real pixels, by the oracle: whole rings about the highlight, and chosen cells beyond."""

from functools import lru_cache

import numpy as np

from matcam.forward.pixel_grid import PixelGrid
from matcam.inverse.operator.chosen_cells import chosen_cells
from matcam.inverse.operator.sample_view import SampleView
from tests.inverse import recorded
from tests.oracle import real_pixels
from tests.oracle.merl_lobe import conductor

WHOLE = 16  # rings
EVERY = 6


class RealShot:
    """Some slices of a table by a rule and phase, whose chosen cells depend on which pixels there are."""

    def __init__(self, rule, phase, slice_step=EVERY, azimuth=0.0):
        self.grid = PixelGrid(rule, phase, azimuth)
        chosen = chosen_cells(SampleView(256.0), "centre", slice_step, self.grid)
        centred = chosen_cells(SampleView(256.0), "centre", slice_step)
        self.slices = chosen.slices
        self.i, self.k = [], []
        for s in range(self.slices.size):
            i, k = (a.ravel() for a in np.meshgrid(np.arange(WHOLE), np.arange(180), indexing="ij"))
            for cells in (chosen, centred):
                far = cells.valid[s] & (cells.i_theta_h[s] >= WHOLE)
                i, k = np.r_[i, cells.i_theta_h[s][far]], np.r_[k, cells.i_phi_d[s][far]]
            self.i.append(i)
            self.k.append(k)
        self.theta_d = recorded.GRID.theta_d[self.slices]
        angles = [(recorded.GRID.theta_h[i], recorded.GRID.phi_d[k]) for i, k in zip(self.i, self.k, strict=True)]
        phases = self.grid.of_slices(self.slices)
        self.truth = real_pixels.RealTable(rule, phases, self.theta_d, angles, azimuth=azimuth)

    def table(self, lobe, seed=None, **noise):
        """One channel; seed: of the pixels' noise, None: none."""
        rng = None if seed is None else np.random.default_rng(seed)
        pixels = self.truth.pixels(lobe) * conductor(self.theta_d, *recorded.CHROMIUM)[:, None]
        table = recorded.table_of(chosen_cells(SampleView(256.0), "centre", 30), np.full((3, 112), np.nan))
        for j, i, k, values in zip(self.slices, self.i, self.k, self.truth.values(pixels, rng, **noise), strict=True):
            table.values[i, j, k, 0] = values
        return table.assign_attrs(lamp_azimuth=self.grid.azimuth) if self.grid.azimuth else table

    def true_peak(self, lobe):
        """The lobe itself in the first ring at phi_d 90 degrees, (slices,)."""
        th, td = recorded.GRID.theta_h[0], self.theta_d
        tan2, cos = np.tan(th) ** 2, np.cos(th) * np.cos(td)
        light = lobe.p22(tan2) * (1 + tan2) ** 2 / (1 + 2 * lobe.smith(cos)) / (4 * cos**2)
        return light * conductor(td, *recorded.CHROMIUM)


@lru_cache(maxsize=2)
def real_shot(rule, phase, slice_step=EVERY, azimuth=0.0):
    """Kept for the next test that asks for the same."""
    return RealShot(rule, phase, slice_step, azimuth)
