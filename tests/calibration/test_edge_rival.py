"""Ours and MTF Mapper's method on the same pictures, row by row of what goes wrong with edges. Truth: `tests/oracle`."""

from typing import NamedTuple

import numpy as np
import pytest

from matcam import edge_mtf_stack
from tests.oracle import local_regression as rival
from tests.oracle import processed_pictures as software
from tests.oracle import real_edges as oracle
from tests.oracle import slanted_edge

SIGMA, DEGREES, SNR = 0.5, 5.0, 100
RIGHT = 0.01
"""Largest median error, relative, with which a method is called right in a row."""


class Row(NamedTuple):
    """What an edge looks like: `light` over it, `course` of it, blur, what follows the shutter, size of the region."""

    light: object = None
    course: object = None
    sigma: float = SIGMA
    second: tuple[float, float, float] | None = None
    after: object = None
    size: tuple[int, int] = oracle.SIZE
    snr: float = SNR

    def picture(self, rng):
        """Counts and MTF50. `second`: share, px and blur of a second edge, a ghost or a skewed lens's."""
        course = None if self.course is None else self.course(self.size[0], rng)
        at = rng.uniform(-0.5, 0.5)
        scene = oracle.response(self.sigma, DEGREES, self.size, course, at)
        if self.second is not None:
            share, px, blur = self.second
            scene = (1 - share) * scene + share * oracle.response(blur, DEGREES, self.size, course, at + px)
        scene = oracle.levels(scene) if self.light is None else oracle.lit(scene, self.light)
        counts = oracle.exposed(scene, self.snr, rng)
        if self.after is not None:
            counts = self.after(counts, self.snr**2, rng)
        return counts, oracle.doubled_half(self.sigma, DEGREES, *(self.second or (0.0, 0.0, self.sigma)))


def spoilt(factor, count):
    return lambda c, s, rng: oracle.with_pixels(c, oracle.near_edge(count, rng, c.shape, DEGREES), factor)


def eight_bits(c, s):
    return software.encoded(c, 1.25 * s)


def jpeg(quality):
    return lambda c, s, rng: 1e3 * software.decoded(software.jpeg(eight_bits(c, s), quality))


S_05, S_1 = (lambda n, rng, q=q: oracle.cubic(q, n) for q in (0.5, 1.0))
ROUGH_02, ROUGH_04 = (lambda n, rng, q=q: oracle.rough(q, rng) for q in (0.2, 0.4))
ROWS = {
    "even light, sigma 0.3": Row(sigma=0.3),
    "even light, sigma 0.5": Row(),
    "even light, sigma 0.5, SNR 40": Row(snr=40),
    "even light, sigma 1.2": Row(sigma=1.2),
    "light falls by 30 %": Row(oracle.along(0.3)),
    "the same, 200 x 200": Row(oracle.along(0.3), size=(200, 200)),
    "shadow across the rows, 30 %": Row(oracle.shadow(0.3)),
    "shadow at 45 degrees, 30 %": Row(oracle.shadow(0.3, 45, 20)),
    "dip of 1 %": Row(oracle.dip(0.01)),
    "dip of 2 %": Row(oracle.dip(0.02)),
    "dip of 10 %": Row(oracle.dip(0.1)),
    "flare of 1 %": Row(oracle.flare(0.01)),
    "flare of 2 %": Row(oracle.flare(0.02)),
    "flare of 5 %": Row(oracle.flare(0.05)),
    "S of 0.5 px": Row(course=S_05),
    "S of 1 px": Row(course=S_1),
    "rough by 0.2 px": Row(course=ROUGH_02),
    "rough by 0.4 px": Row(course=ROUGH_04),
    "ghost of 5 % at 3 px": Row(second=(0.05, 3.0, SIGMA)),
    "ghost of 20 % at 5 px": Row(second=(0.2, 5.0, SIGMA)),
    "skewed PSF": Row(second=(0.25, 0.8, 0.7)),
    "one hot pixel": Row(after=spoilt(2.0, 1)),
    "three dead pixels": Row(after=spoilt(0.0, 3)),
    "blacks crushed": Row(after=lambda c, s, rng: oracle.crushed(c, 0.4 * s)),
    "bilateral filter": Row(after=lambda c, s, rng: software.bilateral(c)),
    "8 bits of sRGB, not undone": Row(after=lambda c, s, rng: np.rint(eight_bits(c, s))),
    "JPEG 80": Row(after=jpeg(80)),
    "JPEG 60": Row(after=jpeg(60)),
    "phone": Row(after=lambda c, s, rng: 1e3 * software.phone(c, 1.25 * s)),
    "blur of 8 px in 80": Row(sigma=8.0),
    "blur of 12 px in 160 x 80": Row(sigma=12.0, size=(160, 80)),
}


class Verdict(NamedTuple):
    """Relative errors of MTF50 in one row, both methods', what we state, and how many of ours are refused."""

    ours: np.ndarray
    stated: np.ndarray
    theirs: np.ndarray
    refused: float
    remarked: float

    @property
    def right(self):
        """Whether theirs are right in this row."""
        return bool(abs(np.median(self.theirs)) < RIGHT)


def rms(errors):
    return float(np.sqrt(np.nanmean(errors**2)))


def compared(name, many, seed):
    """Both methods on `many` pictures of a row."""
    rng = np.random.default_rng([seed, list(ROWS).index(name)])
    pictures, truth = zip(*(ROWS[name].picture(rng) for _ in range(many)), strict=True)
    stack = edge_mtf_stack(np.stack(pictures))
    theirs = np.array([rival.mtf50(picture) for picture in pictures])
    refused = np.mean([problem is not None for problem in stack.problems])
    remarked = np.mean([bool(stack[int(i)].remarks) for i in stack.good]) if stack.good.size else np.nan
    truth = np.array(truth)
    return Verdict(stack.mtf50 / truth - 1, stack.mtf50_std / truth, theirs / truth - 1, refused, remarked)


def report(verdicts):
    """A table as in docs/edge.md."""
    print("| picture | ours: median, rms (stated) | MTF Mapper's: median, rms |\n|---|---|---|")
    for name, v in verdicts.items():
        if v.refused == 1:
            ours = "refused"
        else:
            ours = f"{np.nanmedian(v.ours):+.1%}, {rms(v.ours):.2%} ({np.nanmedian(v.stated):.1%})"
            ours += f", {v.refused:.0%} refused" if v.refused else ""
            ours += ", remarked on" if v.remarked > 0.5 else ""
        print(f"| {name} | {ours} | {np.nanmedian(v.theirs):+.1%}, {rms(v.theirs):.2%} |")


def no_worse(verdict, slack=1.0):
    """Whether ours are as good as theirs wherever theirs are right."""
    return not verdict.right or (verdict.refused == 0 and rms(verdict.ours) <= slack * rms(verdict.theirs))


@pytest.mark.parametrize(("sigma", "snr", "theirs"), [(0.3, 100, 0.0053), (0.5, 40, 0.0094), (1.2, 100, 0.0028)])
def test_the_rival_is_as_good_as_the_tool(sigma, snr, theirs):
    """The tool itself was measured on such pictures."""
    pictures = slanted_edge.photographs(slanted_edge.gaussian(sigma), snr, 32, [1, int(10 * sigma), snr])
    errors = np.array([rival.mtf50(picture) for picture in pictures]) / slanted_edge.gaussian_half(sigma) - 1
    assert rms(errors) == pytest.approx(theirs, rel=3 / np.sqrt(64))
    assert abs(errors.mean()) < 3 * theirs / np.sqrt(32)


@pytest.mark.parametrize("name", ["light falls by 30 %", "flare of 1 %", "S of 0.5 px", "ghost of 20 % at 5 px"])
def test_no_worse_than_the_rival(name):
    verdict = compared(name, 12, 72)
    assert verdict.right
    assert no_worse(verdict), report({name: verdict})


@pytest.mark.slow
def test_no_worse_than_the_rival_in_any_row():
    verdicts = {name: compared(name, 40, 71) for name in ROWS}
    report(verdicts)
    assert [name for name, verdict in verdicts.items() if not no_worse(verdict)] == []
