"""Whole tables corrected: entries whose truth is the oracle's, right assumptions and wrong ones."""

from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr
from scipy.stats import binom

from matcam import Camera, Flat, GaussianOptics, Rig, Sphere, fit, fresnel, limits, rivals
from matcam.camera import PixelNoise, Uncertainty
from matcam.core.errors import ArgumentError
from matcam.inverse import Correction
from matcam.inverse.correction.lobe_ratio import _plain
from matcam.inverse.operator.chosen_cells import chosen_cells
from matcam.inverse.operator.sample_view import SampleView
from tests.inverse import recorded
from tests.oracle import sphere_cells as oracle
from tests.oracle.merl_lobe import conductor

EVERY = 6  # that of `correct`
SLICES = (3, 33, 63, 75)
QUIET = PixelNoise(0.01, 1e-4, 0.0)


def judged():
    """Entries to look at, (slices, 60): the peak's rings, the lobe, and anywhere."""
    random = np.random.default_rng(5)
    rings = np.concatenate([np.repeat([0, 1, 2, 4, 6, 9], 5), random.integers(10, 30, 20), random.integers(30, 60, 10)])
    return np.broadcast_to(rings, (len(SLICES), rings.size)), random.integers(0, 180, (len(SLICES), rings.size))


class Shot:
    """Chosen cells and judged entries under one set-up."""

    def __init__(self, setup=None):
        setup = setup or oracle.Setup()
        grid = recorded.GRID
        self.cells = chosen_cells(SampleView(256.0), "centre", EVERY)
        self.rule = oracle.Cells(
            grid.theta_h[self.cells.i_theta_h], self.cells.theta_d, grid.phi_d[self.cells.i_phi_d], setup
        )
        self.i, self.k = judged()
        self.theta_d = grid.theta_d[list(SLICES)]
        self.looked_at = oracle.Cells(grid.theta_h[self.i], self.theta_d, grid.phi_d[self.k], setup)

    def table(self, lobe, seed, added=None):
        """(table, truth of the judged entries): noisy, one channel; added: function of (rule, lobe) -> light more."""
        random = np.random.default_rng(seed)
        parts = []
        for rule, theta in ((self.rule, self.cells.theta_d), (self.looked_at, self.theta_d)):
            directions = rule.directions(lobe) * conductor(theta, *recorded.CHROMIUM)[:, None, None]
            parts.append(directions if added is None else directions + added(rule, theta))
        peaks = np.max(np.where(np.isfinite(parts[0]), parts[0], 0), axis=(1, 2))
        table = recorded.table_of(self.cells, self.rule.noisy(parts[0], random, gain=0.0))
        noise = random.standard_normal((2, *parts[1].shape))
        peak = peaks[np.searchsorted(self.cells.slices, SLICES)][:, None, None]
        values = (parts[1] * (1 + 0.01 * noise[0]) + 1e-4 * peak * noise[1]).mean(-1)
        table.values[self.i, np.array(SLICES)[:, None], self.k, 0] = values
        th = recorded.GRID.theta_h[self.i]
        tan2 = np.tan(th) ** 2
        cos = self.looked_at.cos_i[..., 0], self.looked_at.cos_o[..., 0]
        hidden = 1 + sum(lobe.smith(np.clip(c, 1e-6, 1)) for c in cos)
        truth = lobe.p22(tan2) * (1 + tan2) ** 2 / hidden / (4 * cos[0] * cos[1])
        return table, truth * conductor(self.theta_d, *recorded.CHROMIUM)[:, None]

    def read(self, done):
        at = self.i, np.array(SLICES)[:, None], self.k, 0
        return [done.table[name].values[at] for name in ("brdf", "brdf_std", "supported")]


@pytest.fixture(scope="module")
def shot():
    return Shot()


@pytest.mark.slow
def test_a_sharp_highlight_is_given_back(shot):
    """Raw, three quarters of the peak and more are missing; corrected, it is there, within its error, and said to be."""
    table, truth = shot.table(oracle.GGX(0.002), 1)
    done = Correction.of(table, recorded.rig(), "ggx", noise=QUIET)
    value, std, supported = shot.read(done)
    raw = table.values[shot.i, np.array(SLICES)[:, None], shot.k, 0]
    peak = shot.i <= 1
    assert np.all(raw[peak] / truth[peak] < 0.3)
    assert supported[peak].all()
    pull = (value - truth)[supported] / std[supported]
    # four standard deviations of a pixel's 1 %; where the picture is dark, of its noise: supported speaks of the correction
    assert (np.abs(value - truth) / np.maximum(0.06 * truth, 4 * std))[supported].max() < 1
    assert np.mean(np.abs(pull) > 3) < 0.02
    assert 0.4 < np.std(pull) < 1.2
    np.testing.assert_array_equal(np.isnan(done.table["brdf"].values), np.isnan(table.values))
    assert not ((done.table["brdf"].values < 0) & (table.values >= 0)).any()
    assert done.fit.determined


@pytest.mark.slow
def test_a_table_without_the_slices_that_rank_lobes_is_corrected(shot):
    """Every 18th slice is missing; the others show the lobe."""
    table, truth = shot.table(oracle.GGX(0.005), 4)
    table.values[:, 9::18] = np.nan
    value, _, supported = shot.read(Correction.of(table, recorded.rig(std=0.015), noise=QUIET))
    peak = (shot.i <= 1) & np.isfinite(value)
    assert peak.any()
    assert supported[peak].all()
    assert np.abs(value / truth - 1)[peak].max() < 0.06


@pytest.mark.slow
def test_rough_materials_are_left_alone():
    """alpha 0.3: where light and view are within 75 degrees, the response is 1 to 0.5 %."""
    small = Shot()
    table, _ = small.table(oracle.GGX(0.3), 2)
    done = Correction.of(table, recorded.rig(), "ggx", noise=QUIET)
    grid = recorded.GRID
    th, td, ph = grid.theta_h[:, None, None], grid.theta_d[:, None], grid.phi_d
    lowest = np.cos(th) * np.cos(td) - np.sin(th) * np.sin(td) * np.abs(np.cos(ph))
    change = np.abs(1 / done.table["response"].values - 1)[lowest > np.cos(np.radians(75))]
    print(f"alpha 0.3: largest change {change.max():.5f}")
    assert change.max() < 0.005
    assert done.verdict.startswith("The camera reduced the peak of the highlight by less than 1% up to 75°.")


def halo_of(rule, theta_d):
    """A Gaussian halo of 1e-3 of the light and 30 px around the highlight, over the light's cosine."""
    share, std, radius = 1e-3, 30.0, rule.setup.radius
    flux = radius**2 / 4 * conductor(theta_d, *recorded.CHROMIUM)[:, None, None]
    distance2 = (rule.x - radius * np.sin(theta_d)[:, None, None]) ** 2 + rule.y**2
    return share * flux * np.exp(-distance2 / 2 / std**2) / (2 * np.pi * std**2) / np.where(rule.good, rule.cos_i, 1)


UNSTATED = Rig(Camera(GaussianOptics(0.5)), Sphere(256.0))
"""Nothing is said of how well its lens is known."""


def two_lobes(alpha):
    return oracle.Lobes(((0.7, oracle.GGX(alpha)), (0.3, oracle.GGX(6 * alpha))))


WRONG = {
    "lens 5 % wider": oracle.Setup(sigma=0.525),
    "lamp": oracle.Setup(lamp=np.radians(0.25)),
    "disc": oracle.disc(),
    "coma along": oracle.coma(),
    "coma across": oracle.coma(angle=np.pi / 2),
}


@pytest.mark.slow
@pytest.mark.parametrize("alpha", [0.0015, 0.004, 0.02])
@pytest.mark.parametrize("wrong", ["nothing", "epd", "two lobes", "halo", *WRONG])
def test_wrong_assumptions(shot, wrong, alpha):
    """`correct` is not told what is wrong. A supported peak is within its error (and the noise of a pixel), fewer than 1 % of
    the supported entries are off by more than 3 of their standard deviations, and no entry is further from the truth than
    the recorded one by more than 2 of them and 1 %."""
    here = Shot(WRONG[wrong]) if wrong in WRONG else shot
    lobes = {"epd": oracle.EPD(alpha, 0.7), "two lobes": two_lobes(alpha)}
    table, truth = here.table(lobes.get(wrong, oracle.GGX(alpha)), 3, halo_of if wrong == "halo" else None)
    done = Correction.of(table, UNSTATED)
    value, std, supported = here.read(done)
    raw = table.values[here.i, np.array(SLICES)[:, None], here.k, 0]
    bright = np.isfinite(truth) & (truth > 1e-9)
    error = np.abs(value - truth) / np.where(bright, truth, 1.0)
    peak = (here.i <= 2) & bright
    good = supported & bright
    false = int(np.sum(np.abs(value - truth)[good] > 3 * std[good]))
    worst = error[good & peak].max(initial=0)
    known = peak & np.isfinite(std) & (value > 0)
    relative = np.median(std[known] / value[known])
    print(
        f"{wrong}, alpha {alpha:g}: peak supported {supported[peak].mean():.1f}, median error {np.median(error[peak]):.3f}, "
        f"worst where supported {worst:.3f}, median std {relative:.3f}, false support {false} of {good.sum()}, "
        f"noise {done.shape.noise.relative:.3f}, shape {done.shape.scale:g}"
    )
    # 5 %, or two and a half standard deviations of a lobe of a quarter of a pixel whose lens is unknown; and the noise
    allowed = np.maximum(0.05, 2.5 * std / np.where(bright, truth, 1.0)) + 3 * 0.01
    assert np.all(error[good & peak] < allowed[good & peak])
    assert binom.sf(false - 1, good.sum(), 0.01) > 0.01  # so few entries: 2 of 143 are no more than 1 %
    harmed = np.abs(value - truth) > np.abs(raw - truth) + 2 * std + 0.01 * truth
    assert harmed[bright & np.isfinite(std)].mean() < 0.01
    if wrong in ("nothing", "epd", "disc", "lens 5 % wider"):
        # of lobes of a quarter of a pixel whose shape is not the fitted one, 3 to 6 % are uncertain where 5 % are allowed
        assert supported[peak].mean() > {("epd", 0.0015): 0.7}.get((wrong, alpha), 0.9)


@pytest.mark.slow
@pytest.mark.parametrize("stated", [0.53, 0.55])
def test_a_lens_that_would_leave_no_width_for_the_lobe_is_a_contradiction(stated):
    """The stated lens explains the whole highlight; a lens of its true width and a lobe explain it better."""
    table, _ = Shot(oracle.Setup(sigma=0.5)).table(oracle.GGX(0.002), 3)
    known = Uncertainty(("optics.sigma_px",), np.array([[(0.0005 * stated) ** 2]]))
    done = Correction.of(table, Rig(Camera(GaussianOptics(stated), uncertainty=known), Sphere(256.0)))
    assert done.withheld
    assert {"lens-contradicts-data", "correction-withheld"} <= {remark.code for remark in done.remarks}


@pytest.mark.slow
def test_a_rig_that_is_contradicted_corrects_nothing():
    """True lens 5 % wider than one that is stated as exact: the table stays as it is, unless it is asked for."""
    here = Shot(oracle.Setup(sigma=0.525))
    table, truth = here.table(oracle.GGX(0.004), 3)
    done = Correction.of(table, recorded.rig())
    assert done.withheld
    assert {"lens-contradicts-data", "correction-withheld"} <= {remark.code for remark in done.remarks}
    np.testing.assert_array_equal(done.table["response"], 1)
    value, std, supported = here.read(done)
    peak = here.i <= 2
    assert not supported[peak].any()
    assert np.all(np.abs(value - truth)[peak] < 3 * std[peak])
    forced = Correction.of(table, recorded.rig(), force_correction=True)
    assert not forced.withheld
    assert np.median(here.read(forced)[0][peak] / value[peak]) > 1.5


def test_what_cannot_be_corrected_is_refused():
    table = xr.zeros_like(recorded.table_of(chosen_cells(SampleView(256.0), "centre", 30), np.zeros((3, 112)))) + 1.0
    table.attrs["sampling"] = "centre"
    rig, corrected = recorded.rig(), table.assign_attrs(corrected_for_camera=1, long_name="corrected BRDF")
    for bad, words in (
        (lambda: Correction.of(table, Rig(rig.camera, Flat())), "must be a Sphere or a Cylinder"),
        (lambda: Correction.of(table, rig, "phong"), "ndf must be one of"),
        (lambda: Correction.of(corrected, rig), "brdf is already a corrected BRDF: give the table as it was recorded"),
        (lambda: fit(corrected, rig), "already a corrected BRDF"),
        (lambda: fit([table, corrected], rig), "already a corrected BRDF"),
        (lambda: fresnel(corrected, rig), "already a corrected BRDF"),
        (lambda: rivals(corrected, rig), "already a corrected BRDF"),
        (lambda: Correction.of(table, rig, glare=2), "glare must lie in"),
    ):
        with pytest.raises(ArgumentError, match=words):
            bad()


@pytest.mark.slow
def test_limits_of_a_rig():
    """Bounds rise towards narrow lobes; jitter cannot be told from the lens; a lens stated to 3 % costs what docs/model.md 8
    says in kind: most where the lobe is narrowest."""
    found = limits(recorded.rig(std=0.015), roughness=[0.0005, 0.002, 0.05], slice_step=18)
    exact, stated, free = (found[name].values for name in ("width_std", "width_std_stated", "width_std_free"))
    assert np.all(exact < stated)
    assert np.all(stated <= free * (1 + 1e-9))
    assert stated[0] > stated[1]
    assert np.all(found["correlation"].sel(blur="jitter (px)") > 0.995)
    assert np.all(found["width_bias"].values[0] > 0)
    changed = found["width_std_changed"].sel(lens="free")
    assert np.all(changed.sel(change="twice the pixels, same lens") < free)
    with pytest.raises(ArgumentError, match="roughness must"):
        limits(recorded.rig(), roughness=[-1.0])


class _Records(SimpleNamespace):
    """An operator that returns a record whatever the lobe."""

    def record(self, ndf, masking, shifts):
        return self.values


def test_a_negative_record_changes_no_ratio():
    """The polynomial of a lens at the end of its range may go below 0 where there is hardly light."""
    bright, faint = [10.0, 1.0, 1e-3], [1e-9, 1e-30, 0.0]
    true = np.array([[*bright, *faint]])
    recorded = np.array([[5.0, 1.0, 2e-3, -1e-8, 1e-12, -1e-300]])
    cells = SimpleNamespace(valid=np.ones(true.shape, dtype=bool))
    where = SimpleNamespace(cells=cells, true=_Records(values=true), recorded=_Records(values=recorded))
    kind = SimpleNamespace(ndf=lambda q: None, masking=None)
    found = _plain(where, SimpleNamespace(kind=kind, lobe=np.zeros(1)), np.zeros(0))
    np.testing.assert_allclose(found[0, :3], np.log([2.0, 1.0, 0.5]), atol=3e-3)
    np.testing.assert_allclose(found[0, 3:], 0.0, atol=3e-3)
