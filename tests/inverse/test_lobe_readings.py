"""What users read of a lobe: half width, tail and haze, against closed forms and direct integrals; no spline's coefficient."""

import json

import numpy as np
import pytest
from scipy.integrate import quad

from matcam import fit
from matcam.inverse.fit.fit_parameters import LobeKind
from matcam.inverse.fit.lobe_readings import lobe_readings
from matcam.material.ndf.free_lobe import KNOTS, SHADOWS
from tests.inverse import recorded
from tests.oracle import sphere_cells as oracle
from tests.oracle.merl_lobe import conductor

READ = ("hwhm_rad", "tail_exponent", "haze_share")
SPLINE = LobeKind("ggx", "smith", spline_size=KNOTS)
NARROW, BROAD = 0.02, 0.3


def coordinates(alpha, coefficients=0.0):
    return np.r_[np.log(alpha), np.broadcast_to(coefficients, KNOTS)]


def direct(lobe, width=None):
    """Half width, tail exponent and haze share of any P22, by bisection and adaptive quadrature."""
    width = recorded.half_width(lobe) if width is None else width
    near, far = 3 * width, min(10 * width, np.pi / 4)
    d_near, d_far = (lobe.p22(np.tan(a) ** 2) / np.cos(a) ** 4 for a in (near, far))
    first = np.tan(10 * width)
    beyond, _ = quad(
        lambda t: 2 * np.pi * np.exp(2 * t) * lobe.p22(np.exp(2 * t)), np.log(first), np.log(2e3), limit=200
    )
    return np.array([width, np.log(d_near / d_far) / np.log(far / near), beyond])


def test_a_lobe_with_a_spline_of_zeros_reads_as_its_family():
    read = lobe_readings(SPLINE, coordinates(NARROW))
    assert read.names == READ
    np.testing.assert_allclose(read.values, direct(oracle.GGX(NARROW)), rtol=2e-3)
    # glossary: of a narrow GGX
    np.testing.assert_allclose(read.values[1:], [3.64, 1 / (1 + 100 * (np.sqrt(2) - 1))], rtol=0.02)
    own = lobe_readings(LobeKind("ggx", "smith"), np.log([NARROW]))
    assert own.names == ("alpha",)
    assert own.values[0] == pytest.approx(NARROW)


def test_derivatives_are_those_of_differences():
    random = np.random.default_rng(1)
    q, step = coordinates(NARROW, random.normal(0, 0.3, KNOTS)), 1e-5
    read = lobe_readings(SPLINE, q)
    for one in range(q.size):
        up, down = (lobe_readings(SPLINE, q + sign * step * np.eye(q.size)[one]).values for sign in (1, -1))
        np.testing.assert_allclose(read.slopes[:, one], (up - down) / (2 * step), rtol=1e-4, atol=1e-7)


def test_a_lobe_as_broad_as_the_hemisphere_has_no_tail_and_a_free_masking_is_an_angle():
    assert lobe_readings(SPLINE, coordinates(BROAD)).names == READ[:1]
    kind = LobeKind("ggx", "smith-separable", shadows=SHADOWS)
    shadows = np.linspace(0, 0.7, SHADOWS)
    read = lobe_readings(kind, np.r_[np.log(NARROW), shadows])
    assert read.names == (*READ, "masking_75")
    # B-splines on a straight line of coefficients are that line, 0.1 a knot, but for the mirrored end at 0: a sixth of 0.2
    assert read.values[-1] == pytest.approx(np.exp(0.1 / 3 - 0.7 * (1 - np.cos(np.radians(75)))), rel=1e-9)


class TwoLobes:
    """70 % GGX 0.01 and 30 % GGX 0.08."""

    parts = ((0.7, oracle.GGX(0.01)), (0.3, oracle.GGX(0.08)))

    def p22(self, s2):
        return sum(share * part.p22(s2) for share, part in self.parts)

    def smith(self, cos):
        return sum(share * part.smith(cos) for share, part in self.parts)


def test_no_coefficient_reaches_a_user():
    """A spline-modified fit to what the oracle records of two lobes: its numbers are the lobe's own, within their errors."""
    shot, lobe = recorded.made(18, oracle.Setup()), TwoLobes()
    directions = shot.rule.directions(lobe) * conductor(shot.cells.theta_d, *recorded.CHROMIUM)[:, None, None]
    table = shot.table(shot.rule.noisy(directions, np.random.default_rng(5)))
    found = fit(table, recorded.rig(), fresnel="free", diffuse=True, spline=1.0, slice_step=18)
    truth = dict(zip(READ, direct(lobe), strict=True))
    print({name: f"{found.params[name]:.5g} +- {found.std[name]:.2g}, true {truth[name]:.5g}" for name in READ})
    for name in READ:
        assert abs(found.params[name] - truth[name]) < 4 * found.std[name] + 0.03 * truth[name]
    assert found.std["hwhm_rad"] == pytest.approx(found.hwhm_std)
    document = found.to_dict()
    assert document["spline_modified"]
    assert found.covariance.shape == (len(found.params),) * 2
    said = json.dumps(document).replace('"spline_modified": true', "")
    assert not any(word in said for word in ("spline", "shadow", "alpha"))
