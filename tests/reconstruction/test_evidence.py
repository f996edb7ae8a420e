"""Evidence of explanations of photographs, against the integral of the likelihood over two parameters."""

import numpy as np
import pytest

from matcam.inverse.fit.fit_parameters import LobeKind
from matcam.reconstruction.alternatives import Alternative
from matcam.reconstruction.joint.evidence import ACCURACY, ComparedPixels
from matcam.reconstruction.joint.joint_problem import JointLayout, JointProblem
from matcam.reconstruction.observed_pixels import ObservedPixels
from matcam.reconstruction.picture_model import Recorded, lamp_frame

KIND = LobeKind("ggx", "smith")
LAYOUT = JointLayout(1, 1, 1)
COUNT = 40
LOBE, LAMBERT = np.exp(-np.linspace(0, 4, COUNT)), np.full(COUNT, 0.3)
STD = 0.02 + 0.05 * LOBE


class Known:
    """Model of pixels that does not depend on lobe or scene."""

    def window(self, p, frame, window, *, slopes):
        one = Recorded(LOBE[None], LAMBERT[None], np.zeros((1, COUNT)))
        return one, Recorded(*(np.zeros((1, COUNT, p.size)) for _ in one)) if slopes else None

    def pixels(self, p, frame, column, row, *, slopes):
        one = Recorded(*(np.zeros(0),) * 3)
        return one, Recorded(*(np.zeros((0, p.size)) for _ in one)) if slopes else None


def problem(values, rows=None, wanted=None):
    """Strength and diffuse part of one image are free."""
    free = [LAYOUT.strengths(0).start, LAYOUT.diffuse.start]
    fixed = np.ones(LAYOUT.size, bool)
    fixed[free] = False
    pixels = ObservedPixels(
        window=None, column=np.zeros(0), row=np.zeros(0), values=values, std=STD, clipped=np.zeros(COUNT, bool),
        channel=np.zeros(COUNT, int), used=np.ones(COUNT, bool), positions=np.zeros((2, COUNT)),
    )  # fmt: skip
    rows = np.zeros((0, LAYOUT.size)) if rows is None else rows
    return JointProblem(
        Known(), LAYOUT, [pixels], [lamp_frame(np.array([0.0, 0.0, 1.0]))], rows, np.zeros(0) if wanted is None else wanted,
        (), np.full(LAYOUT.size, -np.inf), np.full(LAYOUT.size, np.inf), np.zeros((1, 1)), fixed,
    )  # fmt: skip


def integral(values, exponents, strength, more=lambda f, d: 0.0):
    """Logarithm of the integral of likelihood and prior, by a sum over a fine lattice."""
    f, d = np.meshgrid(np.linspace(0.7, 1.3, 601), np.linspace(0.0, 0.6, 601), indexing="ij")
    model = f[..., None] * LOBE + d[..., None] * LAMBERT
    # the noise is that of the best parameters, as in Laplace's approximation
    best = np.linalg.lstsq(np.stack([LOBE, LAMBERT], 1) / STD[:, None], values / STD, rcond=None)[0]
    level = best[0] * LOBE + best[1] * LAMBERT
    std = np.hypot(problem(values).pixels[0].noise_at(level), ACCURACY * level)
    log = -0.5 * (exponents * ((model - values) / std) ** 2).sum(-1) - (exponents * np.log(std)).sum()
    log -= 0.5 * (f**2 + d**2) / (3 * strength) ** 2 + np.log(2 * np.pi * (3 * strength) ** 2) - more(f, d)
    cell = (f[1, 0] - f[0, 0]) * (d[0, 1] - d[0, 0])
    return np.log(cell) + np.logaddexp.reduce(log, axis=None)


def test_the_evidence_is_the_integral_of_the_likelihood():
    random = np.random.default_rng(3)
    values = LOBE + 0.2 * LAMBERT + STD * random.standard_normal(COUNT)
    exponents = np.linspace(0.3, 1.0, COUNT)
    known, p = integral(values, exponents, 1.0), np.zeros(LAYOUT.size)
    weight = exponents / STD**2
    columns = np.stack([LOBE, LAMBERT], 1)
    best = np.linalg.solve(columns.T @ (weight[:, None] * columns), columns.T @ (weight * values))
    p[LAYOUT.strengths(0)], p[LAYOUT.diffuse] = best
    # the prediction starts at the best parameters without a prior of the diffuse part, which is then stated as 0.3
    row = np.zeros((1, LAYOUT.size))
    row[0, LAYOUT.diffuse] = 1 / 0.05
    stated = problem(values, row, np.array([0.3 / 0.05]))
    compared = ComparedPixels(stated.pixels, (), (), [exponents], 1.0)
    none = compared.judged(problem(values), KIND, p)
    constant = known - none.log_evidence()
    with_prior = compared.judged(stated, KIND, p)
    for std in (0.02, 0.05, 0.2):
        row[0, LAYOUT.diffuse] = 1 / std

        def more(f, d, std=std):
            return -0.5 * ((d - 0.3) / std) ** 2 - np.log(np.sqrt(2 * np.pi) * std)

        true = integral(values, exponents, 1.0, more)
        found = with_prior.log_evidence_with(row, np.array([0.3 / std]))
        # the integral has the product of two densities of the diffuse part, the evidence one density with both informations
        both = 0.5 * np.log(2 * np.pi * (3.0**2 + std**2))
        assert found + constant - both == pytest.approx(true, abs=0.02), std


def test_alternatives_are_named_by_what_differs():
    one = Alternative("ggx", spline=True, shaped=True).widened("lens", 3.0).widened("lens", 2.0)
    assert one.name == "ggx, spline-modified, diffuse part shaped, lens widened 6 times"
    assert one.wider == (("lens", 6.0),)
