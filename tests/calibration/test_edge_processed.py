"""Pictures that software has been at: each is named by a remark, and its stated error grows. Truth: `tests/oracle`."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from matcam import edge_mtf_stack
from matcam.calibration.camera.processed_pictures import picture_noise
from matcam.calibration.photograph.flat_noise import crushed_share, flat_noise
from matcam.calibration.photograph.linear_filters import correlations, effect_on_half, mask_gain
from tests.oracle import processed_pictures as software
from tests.oracle import real_edges as oracle

# one worker, because all of these are measured by one compiled program

WHITE = 1.25  # of the bright level: the end of the range
PROCESSED = {
    "crushed at the dark level": (lambda c, s: oracle.crushed(c, 0.25 * s), {"crushed"}),
    "crushed above the dark level": (lambda c, s: oracle.crushed(c, 0.4 * s), {"crushed"}),
    "denoised by a bilateral filter": (lambda c, s: software.bilateral(c), {"denoised"}),
    "a weaker one": (lambda c, s: software.bilateral(c, levels=0.05), {"denoised"}),
    "median": (lambda c, s: software.median(c), {"denoised"}),
    "demosaiced": (lambda c, s: software.demosaiced(c), {"demosaiced"}),
    "phone": (lambda c, s: 1e3 * software.phone(c, WHITE * s), {"denoised", "compressed"}),
    "JPEG 80": (
        lambda c, s: 1e3 * software.decoded(software.jpeg(software.encoded(c, WHITE * s), 80)),
        {"compressed", "denoised"},
    ),
    "sRGB that is not undone": (lambda c, s: software.encoded(c, WHITE * s), {"tone-curve"}),
    "coarse codes": (lambda c, s: software.coarse(c, s / 16), {"quantised"}),
}
"""What is done to the counts, by the counts at the bright level, and remarks of which one at least must come."""
TRACES = {"crushed", "denoised", "demosaiced", "compressed", "tone-curve", "quantised", "sharpened"}


def drawn(rng, many, snrs=(40, 100)):
    """Counts of edges at random, and the MTF50 of each lens and the bright level."""
    for _ in range(many):
        sigma, snr, degrees = rng.choice([0.3, 0.5, 0.7, 1.5]), float(rng.choice(snrs)), rng.uniform(3.5, 14)
        counts = oracle.exposed(oracle.levels(oracle.response(sigma, degrees)), snr, rng)
        yield counts, oracle.half(sigma, degrees), snr**2


def traces(stack, i):
    return {remark.code for remark in stack[int(i)].remarks} & TRACES


def named(each, seed):
    """For every kind of processing: how many were named or refused, and how many are within 2 stated sigma or refused."""
    rng = np.random.default_rng(seed)
    pictures, truth, kinds = [], [], []
    for kind, (process, _) in PROCESSED.items():
        for counts, half, level in drawn(rng, each, snrs=(100,) if kind == "coarse codes" else (40, 100)):
            pictures.append(process(counts, level))
            truth.append(half)
            kinds.append(kind)
    stack = edge_mtf_stack(np.stack(pictures))
    refused = np.array([problem is not None for problem in stack.problems])
    said = refused.copy()
    said[stack.good] = [bool(traces(stack, i) & PROCESSED[kinds[i]][1]) for i in stack.good]
    honest = refused | (np.abs(stack.mtf50 - truth) < 2 * stack.mtf50_std)
    kinds = np.array(kinds)
    return {kind: (said[kinds == kind].mean(), honest[kinds == kind].mean()) for kind in PROCESSED}


def test_what_software_did_is_said():
    report = named(3, 61)
    assert all(said >= 2 / 3 for said, _ in report.values()), report
    assert np.mean([said for said, _ in report.values()]) >= 0.95
    assert np.mean([honest for _, honest in report.values()]) >= 0.85


@pytest.mark.slow
def test_what_software_did_is_said_at_length():
    report = named(60, 62)
    for kind, (said, honest) in report.items():
        print(f"{kind:32s} {said:6.1%} {honest:6.1%}")
    assert all(said >= 0.95 for said, _ in report.values())
    assert all(honest >= 0.8 for _, honest in report.values())


def false_alarms(many, seed):
    """How many of clean linear edges are told that software has been at them."""
    rng = np.random.default_rng(seed)
    pictures = []
    for k in range(many):
        sigma, snr, dark = rng.uniform(0.3, 1.6), float(rng.choice([20, 40, 100, 200])), rng.uniform(0.05, 0.6)
        scene = dark + (1 - dark) * oracle.response(sigma, rng.uniform(3, 40))
        counts = oracle.exposed(scene, snr, rng)
        counts += rng.normal(0, rng.uniform(0.01, 0.1) * snr, counts.shape)
        # as counts; as codes of 16 bits; as codes of 8 bits whose sRGB was undone, where 8 bits are enough
        if k % 3 == 1:
            counts = np.rint(np.clip(45000 * counts / snr**2, 0, 65535))
        elif k % 3 == 2 and snr <= 100:
            counts = 1e3 * software.decoded(np.rint(software.encoded(counts, 1.3 * snr**2)))
        pictures.append(counts)
    stack = edge_mtf_stack(np.stack(pictures))
    assert not any(stack.problems)
    return sum(bool(traces(stack, i)) for i in stack.good)


def test_clean_edges_are_not_suspected():
    assert false_alarms(40, 63) == 0


@pytest.mark.slow
def test_clean_edges_are_not_suspected_at_length():
    assert false_alarms(600, 64) <= 3


def disc(diameter, degrees):
    """Edge response of a defocused lens, a disc, with a little blur: a semicircle of displaced edges."""
    k = np.arange(1, 16) * np.pi / 16
    along_row = np.cos(k) * diameter / 2 / np.cos(np.radians(degrees))
    weights = np.sin(k) ** 2 / (np.sin(k) ** 2).sum()
    return sum(w * oracle.response(0.3, degrees, offset=x) for w, x in zip(weights, along_row, strict=True))


def ghosted(share, offset, degrees):
    return (1 - share) * oracle.response(0.5, degrees) + share * oracle.response(0.5, degrees, offset=offset)


LENSES = {
    **{f"gaussian {s}": lambda a, s=s: oracle.response(s, a) for s in (0.3, 0.5, 0.7, 1.5)},
    **{f"disc {d}": lambda a, d=d: disc(d, a) for d in (1.5, 3.0, 5.0)},
    **{f"ghost {q} {x}": lambda a, q=q, x=x: ghosted(q, x, a) for q, x in ((0.05, 3), (0.1, -4), (0.2, 5))},
}


def said_to_be_sharpened(many, amount, snr, seed):
    """For every lens, the share of pictures behind an unsharp mask of `amount` that are said to be sharpened, or refused."""
    rng = np.random.default_rng(seed)
    report = {}
    for name, lens in LENSES.items():
        pictures = []
        for k in range(many):
            if k % 5 == 0:
                scene = oracle.levels(lens(rng.uniform(3.5, 12)))
            pictures.append(software.unsharp(oracle.exposed(scene, snr, rng), amount))
        stack = edge_mtf_stack(np.stack(pictures))
        report[name] = 1 - np.mean(["sharpened" not in traces(stack, i) for i in stack.good]) * stack.good.size / many
    return report


def test_slight_sharpening_is_said():
    seen = said_to_be_sharpened(5, 0.1, 100, 68)
    assert min(seen[name] for name in ("gaussian 0.3", "gaussian 0.5", "disc 1.5")) >= 0.6
    clean = said_to_be_sharpened(5, 0.0, 100, 69)
    assert sum(clean.values()) == 0


@pytest.mark.slow
def test_slight_sharpening_at_length():
    for snr in (100, 40):
        seen, clean = (said_to_be_sharpened(100, amount, snr, 70) for amount in (0.1, 0.0))
        for name, share in seen.items():
            print(f"{name:14s} SNR {snr}: {share:6.1%} of masks of 10 %, {clean[name]:6.1%} of clean ones")
        assert np.mean(list(clean.values())) < 0.01
        if snr == 100:
            assert min(seen[name] for name in ("gaussian 0.3", "gaussian 0.5", "disc 1.5")) >= 0.9
            assert min(seen[name] for name in ("gaussian 0.7", "disc 3.0")) >= 0.4


def test_an_overshoot_within_its_noise_is_no_sharpening():
    counts = oracle.exposed(oracle.levels(oracle.response(0.5, 6.0)), 8, np.random.default_rng(26))
    edge = edge_mtf_stack(counts[None])[0]
    assert 0.02 < edge.overshoot < 5 * edge.overshoot_std
    assert edge.remarks == ()


def test_noise_behind_a_mask_errs_apart():
    rng = np.random.default_rng(71)
    dark = np.zeros((100, 120), bool)
    dark[:, :60] = True
    light = np.where(dark, 1000.0, 4000.0) * (1 + 0.3 * np.indices(dark.shape)[0] / 100)
    flat = np.roll(dark, -5, 1) & dark, np.roll(~dark, 5, 1) & ~dark
    gains = {0.0: [], 0.1: []}
    for _ in range(40):
        counts = rng.poisson(light).astype(float)
        for amount, of in gains.items():
            of.append(mask_gain(correlations(software.unsharp(counts, amount), flat)))
    # in this many pixels the mask is worth 3 standard deviations: 2 ln likelihood is -9 +- 6 without it, and 9 +- 6 behind it
    assert np.mean(gains[0.0]) == pytest.approx(-9, abs=3.5)
    assert np.mean(gains[0.1]) == pytest.approx(9, abs=4.5)
    assert np.std(gains[0.0]) == pytest.approx(6, abs=2.1)
    assert correlations(np.full((50, 50), 3.0), (np.ones((50, 50), bool), np.zeros((50, 50), bool))) is None


def test_what_a_mask_does_to_mtf50():
    f = np.arange(81) / 64
    lens = np.exp(-2 * (np.pi * 0.5 * f) ** 2) * np.sinc(f)
    behind = lens * (1.1 - 0.1 * np.exp(-2 * (np.pi * f) ** 2))
    halves = [np.interp(-0.5, -mtf[:50], f[:50]) for mtf in (behind, lens)]
    assert effect_on_half(f, behind) == pytest.approx(halves[0] / halves[1] - 1, rel=1e-6)
    assert effect_on_half(f, np.ones(81)) == 0


def test_errors_grow_as_one_scale_of_frequency():
    rng = np.random.default_rng(65)
    counts, half, _ = next(drawn(rng, 1))
    plain, smoothed = edge_mtf_stack(np.stack([counts, software.demosaiced(counts)]), accept_sharpened=True)
    assert plain.remarks == ()
    assert smoothed.mtf_std[0] == pytest.approx(0, abs=1e-6)
    # the MTF50 of a picture with missing values filled in is wrong by this much, and says so
    off = abs(smoothed.mtf50 / half - 1)
    assert 5 * plain.mtf50_std / half < off < 2 * smoothed.mtf50_std / half < 4 * off
    assert smoothed.parametric.mtf50_std / half > off / 2
    assert smoothed.parametric.camera.uncertainty.std()["optics.sigma_px"] > off / 2 * smoothed.parametric.values[0]


def test_noise_of_flat_parts():
    rng = np.random.default_rng(66)
    dark = np.zeros((120, 100), bool)
    dark[:, :50] = True
    light = np.where(dark, 1000.0, 4000.0) * (1 + 0.3 * np.indices(dark.shape)[0] / 120)
    counts = rng.poisson(light).astype(float)
    noise = flat_noise(counts, dark, ~dark)
    assert noise.neighbour_ratio == pytest.approx(1, abs=4 * noise.neighbour_ratio_std)
    assert noise.tilt == pytest.approx(0.25, abs=0.03)
    assert noise.variance == pytest.approx((1150, 4600), rel=0.1)
    assert not any((noise.smoothed, noise.denoised, noise.compressed, noise.tone_curve_suspected))
    assert (
        flat_noise(np.full((40, 40), 3.0), np.ones((40, 40), bool), np.zeros((40, 40), bool)).neighbour_ratio_std
        == np.inf
    )


def test_the_ratio_of_noise_variances_states_its_error():
    rng = np.random.default_rng(72)
    dark = np.zeros((120, 100), bool)
    dark[:, :50] = True
    light = np.where(dark, 1000.0, 4000.0)
    found = [flat_noise(rng.poisson(light).astype(float), dark, ~dark) for _ in range(60)]
    # a standard error of 9 %
    assert np.mean([noise.tilt_std for noise in found]) == pytest.approx(
        np.std([noise.tilt for noise in found]), rel=0.3
    )


def compressed(rng, snr, quality):
    """A picture after JPEG, its sRGB undone, and MTF50 before."""
    counts, half, level = next(drawn(rng, 1, snrs=(snr,)))
    return 1e3 * software.decoded(software.jpeg(software.encoded(counts, WHITE * level), quality)), half


def test_blocks_are_not_taken_for_denoising():
    rng = np.random.default_rng(68)
    x, y = oracle.grid(*oracle.SIZE)
    for _ in range(6):
        picture, _ = compressed(rng, 100, 80)
        side = x * np.cos(np.radians(9)) + y * np.sin(np.radians(9))
        noise = flat_noise(picture, side < -14, side > 14)
        assert noise.compressed
        assert not noise.denoised


@pytest.mark.slow
def test_errors_of_compressed_pictures():
    """They are as wide as JPEG's own errors, and a little more: what it takes away is no noise."""
    rng = np.random.default_rng(69)
    inside = []
    for quality in (80, 90, 95):
        for snr in (40, 100):
            pictures, truth = zip(*(compressed(rng, snr, quality) for _ in range(60)), strict=True)
            stack = edge_mtf_stack(np.stack(pictures))
            error, std = stack.mtf50 / np.array(truth) - 1, stack.mtf50_std / np.array(truth)
            inside.append(np.mean(np.abs(error[stack.good]) < std[stack.good]))
            print(
                quality, snr, f"rms {np.sqrt(np.nanmean(error**2)):.2%} stated {np.nanmedian(std):.2%} {inside[-1]:.0%}"
            )
            assert np.nanmean(np.abs(error) < 2 * std) > 0.85
            assert np.nanmedian(std) < 2.5 * np.sqrt(np.nanmean(error**2))
    assert 0.62 < np.mean(inside) < 0.85


def test_a_pile_at_the_lowest_value():
    rng = np.random.default_rng(67)
    dark, bright = rng.poisson(20, 3000).astype(float), rng.poisson(900, 3000).astype(float)

    def share(*sides):
        return crushed_share(*(np.unique(side, return_counts=True)[1] for side in sides))

    assert share(dark, bright) == 0
    assert share(np.maximum(dark, 20), bright) == pytest.approx(0.56, abs=0.05)
    # without noise both sides are as flat
    assert share(np.full(50, 2.0), np.full(50, 9.0)) == 0
    assert share(dark[:1], bright) == 0


@pytest.mark.parametrize(("lens", "electrons"), [(0.4, 20000), (0.8, 20000), (1.5, 20000), (0.4, 1000)])
def test_a_star_that_the_lens_does_not_resolve_is_no_correlated_noise(lens, electrons):
    """Spokes that become grey at the centre, beside squares: the noise of all pixels is independent."""
    fine, size = 5, 400
    y, x = (np.mgrid[: size * fine, : size * fine] + 0.5) / fine
    page = np.where((x // 60 + y // 60) % 4 == 0, 0.25, 0.95)
    dx, dy = x - size / 2, y - size / 2
    page = np.where(np.hypot(dx, dy) < 110, np.where(np.sin(72 * np.arctan2(dy, dx)) > 0, 0.25, 0.95), page)
    light = gaussian_filter(page, lens * fine).reshape(size, fine, size, fine).mean((1, 3))
    noisy = np.random.default_rng(1).poisson(electrons * light).astype(float)
    noise = picture_noise(noisy)
    assert noise.neighbour_ratio == pytest.approx(1, abs=4 * noise.neighbour_ratio_std)
    assert noise.neighbour_ratio_std < 0.03
    assert picture_noise(gaussian_filter(noisy, 0.5)).smoothed
