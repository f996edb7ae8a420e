"""Baselines: methods of a few lines each. None of them imports the package under test.

A baseline maps a recorded table (90, 90, 180, 3), 1/sr, and the stated facts of its case (`cases.stated`) to a recovered table.
Of photographs it receives the table that a plain lookup reads in them. Wiener filter and Richardson-Lucy restore the
photographs first.
"""

import numpy as np
from benchmarks.recovery.photographs import looked_up
from scipy.ndimage import map_coordinates
from scipy.optimize import minimize_scalar
from scipy.special import erf, erfc
from tests.oracle.merl_lobe import PHI_D, THETA_D, THETA_H

ITERATIONS = 20
"""Iterations of Richardson-Lucy and of the deconvolution of a table: more amplify noise of 1 % beyond what they restore."""
BALANCE = 1e-3
"""Regularisation of the Wiener filter: a hundredth of the contrast, as a noise of 1 % requires at the highest frequencies."""
HALF, USED = 32, 24
"""Half widths of the part of a photograph that is deconvolved, and of the part that is used, px: its borders are wrong."""
_MEAN, _HALF = (
    np.cos(THETA_H)[:, None, None] * np.cos(THETA_D)[:, None],
    np.sin(THETA_H)[:, None, None] * np.sin(THETA_D)[:, None],
)
COS_I, COS_O = _MEAN - _HALF * np.cos(PHI_D), _MEAN + _HALF * np.cos(PHI_D)
SEEN = (COS_I > 0) & (COS_O > 0)


def sigma(stated):
    """Standard deviation of the stated lens, px; of an MTF, that of the Gaussian with the same MTF at its third sample."""
    lens = stated["lens"]
    if lens is None:
        return 0.5
    if lens["kind"] == "gaussian":
        return lens["sigma_px"]
    f, mtf = lens["frequency_cycles_per_px"][2], lens["mtf"][2]
    return float(np.sqrt(-np.log(mtf) / 2) / (np.pi * f))


def nothing(recorded, stated):
    """The recorded table."""
    return recorded


def peak_over_loss(recorded, stated):
    """Each slice over the loss of its peak (docs/model.md 4), as the paper corrects peaks.

    The width of the lobe is the half width of the recorded lobe at normal incidence, less the variance of the kernel.
    """
    s, p, r = sigma(stated), stated["pixel_half_width_px"], stated["sphere"]["radius_px"]
    ring = np.nanmean(recorded[:, 2], axis=(1, 2))
    outside = int(np.argmax(ring < ring[0] / 2)) or 89
    half = np.interp(-ring[0] / 2, -ring[outside - 1 : outside + 1], THETA_H[outside - 1 : outside + 1])
    width = np.sqrt(max((half / 1.1774) ** 2 - (s**2 + p**2 / 3) / r**2, (0.1 * s / r) ** 2))

    def response(spread):
        return spread / p * np.sqrt(np.pi / 2) * erf(p / np.sqrt(2 * (spread**2 + s**2)))

    loss = response(width * r * np.cos(THETA_D)) * response(width * r)
    return recorded / loss[:, None, None]


def perfect_camera(recorded, stated):
    """Best lobe (GGX or Beckmann, Smith's masking) with F and a constant free in each slice, as a perfect camera records it."""
    peak = np.nanmax(recorded, axis=(0, 2), keepdims=True)
    weight = np.where(np.isfinite(recorded), 1 / (0.01 * np.abs(np.nan_to_num(recorded)) + 1e-4 * peak) ** 2, 0)
    data = np.nan_to_num(recorded)

    def model(log_alpha, family, chosen):
        shape = _lobe(np.exp(log_alpha), family)[:, chosen, :, None]
        w, y = weight[:, chosen], data[:, chosen]
        sums = [(w * q).sum((0, 2)) for q in (1.0, shape, shape**2, y, shape * y)]
        one, x, xx, y1, xy = sums
        slope = np.maximum((one * xy - x * y1) / np.maximum(one * xx - x**2, 1e-300), 0)
        return np.maximum(slope[:, None], 0) * shape + np.maximum((y1 - slope * x) / one, 0)[:, None]

    def misfit(log_alpha, family):
        chosen = slice(2, 80, 13)
        return float((weight[:, chosen] * (model(log_alpha, family, chosen) - data[:, chosen]) ** 2).sum())

    found = [
        (minimize_scalar(misfit, bounds=np.log([3e-4, 0.7]), args=(family,), method="bounded"), family)
        for family in ("ggx", "beckmann")
    ]
    best, family = min(found, key=lambda one: one[0].fun)
    return np.where(np.isfinite(recorded), model(best.x, family, slice(None)), np.nan)


def _lobe(alpha, family):
    """D G / (4 cos_i cos_o) of every cell; 0 below the horizon."""
    s2 = np.tan(THETA_H)[:, None, None] ** 2
    p22 = alpha**2 / (alpha**2 + s2) ** 2 if family == "ggx" else np.exp(-s2 / alpha**2) / alpha**2
    cosines = np.where(SEEN, COS_I, 1.0), np.where(SEEN, COS_O, 1.0)
    masking = 1 + sum(_smith(alpha, family, c) for c in cosines)
    return np.where(SEEN, p22 * (1 + s2) ** 2 / np.pi / masking / (4 * cosines[0] * cosines[1]), 0.0)


def _smith(alpha, family, cos):
    if family == "ggx":
        return np.sqrt(1 + alpha**2 * (1 / cos**2 - 1)) / 2 - 0.5
    a = cos / np.maximum(alpha * np.sqrt(1 - cos**2), 1e-12)
    return np.exp(-np.minimum(a**2, 700)) / (2 * a * np.sqrt(np.pi)) - erfc(a) / 2


def wiener(recorded, stated):
    """Wiener filter on the photograph around each highlight (scikit-image)."""
    return on_photographs(recorded, stated, wiener_filtered)


def wiener_filtered(image, kernel):
    """Image after a Wiener filter."""
    from skimage.restoration import wiener as restored

    return restored(image, kernel, BALANCE, clip=False)


def richardson_lucy(recorded, stated):
    """Richardson-Lucy deconvolution of the photograph around each highlight (scikit-image)."""
    return on_photographs(recorded, stated, richardson_lucy_restored)


def richardson_lucy_restored(image, kernel):
    """Image after Richardson-Lucy deconvolution."""
    from skimage.restoration import richardson_lucy as restored

    return restored(np.maximum(image, 0), kernel, ITERATIONS, clip=False)


def on_photographs(recorded, stated, restore):
    """Table whose entries are multiplied by restored over recorded radiance in the photograph of their slice.

    The photograph is the slice, looked up at pixel positions, times cos_i. restore: (image, kernel) to image.
    """
    r, out, kernel = stated["sphere"]["radius_px"], recorded.copy(), effective_kernel(stated)
    a, b = np.meshgrid(np.arange(-HALF, HALF + 1.0), np.arange(-HALF, HALF + 1.0))
    for j, theta_d in enumerate(THETA_D):
        x, y = (r * np.sin(theta_d) + a) / r, b / r
        z = np.sqrt(np.maximum(1 - x**2 - y**2, 0))
        cos_i = np.where(z > 0, x * np.sin(2 * theta_d) + z * np.cos(2 * theta_d), 0)
        along = x * np.cos(theta_d) - z * np.sin(theta_d)
        theta_h = np.arctan2(np.hypot(along, y), x * np.sin(theta_d) + z * np.cos(theta_d))
        ring, turn = 90 * np.sqrt(theta_h / (np.pi / 2)) - 0.5, np.degrees(np.pi - np.arctan2(y, along)) - 0.5
        # positions of all cells in the photograph, in both reciprocal configurations
        psi = np.pi - PHI_D + np.array([[0.0], [np.pi]])
        th = THETA_H[:, None, None]
        u = r * (np.cos(th) * np.sin(theta_d) + np.sin(th) * np.cos(psi) * np.cos(theta_d) - np.sin(theta_d))
        v = r * np.sin(th) * np.sin(psi)
        inside = (np.maximum(np.abs(u), np.abs(v)) < USED).all(1)
        for c in range(3):
            values = np.pad(np.nan_to_num(recorded[:, j, :, c]), ((0, 0), (1, 1)), mode="wrap")
            image = map_coordinates(values, [ring, turn % 180 + 1], order=1, mode="nearest") * np.maximum(cos_i, 0)
            top = max(image.max(), 1e-300)
            restored = restore(image / top, kernel) * top
            with np.errstate(invalid="ignore", divide="ignore"):
                ratio = np.where(image > 0, np.maximum(restored, 0) / image, 1.0)
            factor = map_coordinates(ratio, [v + HALF, u + HALF], order=1, mode="nearest").mean(1)
            out[:, j, :, c] *= np.where(inside, factor, 1.0)
    return out


def effective_kernel(stated):
    """Kernel (11, 11) of the stated lens and the pixel."""
    s, p, n = sigma(stated), stated["pixel_half_width_px"], np.arange(-5, 6)
    line = erf((n + p) / (np.sqrt(2) * s)) - erf((n - p) / (np.sqrt(2) * s))
    return np.outer(line, line) / line.sum() ** 2


def table_deconvolution(recorded, stated):
    """Gaussian deconvolution along theta_h by Gold's ratio method, as if the table were the blurred quantity.

    The kernel at azimuth phi_d is a Gaussian whose width is that of lens and pixel as an angle: divided by cos theta_d in the
    plane of camera and lamp, but not across it.
    """
    s, p, r = sigma(stated), stated["pixel_half_width_px"], stated["sphere"]["radius_px"]
    angle = np.concatenate([-THETA_H[::-1], THETA_H])
    size = np.gradient(angle)
    data = np.maximum(np.nan_to_num(recorded), 0)
    out = data.copy()
    for j, theta_d in enumerate(THETA_D):
        wide = np.sqrt(s**2 + p**2 / 3) / r * np.hypot(np.cos(PHI_D) / np.cos(theta_d), np.sin(PHI_D))[:90]
        matrix = size * np.exp(-(((THETA_H[:, None] - angle) / wide[:, None, None]) ** 2) / 2)
        matrix[:, range(90), range(90, 180)] += 1e-300
        matrix /= matrix.sum(-1, keepdims=True)
        matrix = matrix[..., 90:] + matrix[..., 89::-1]
        matrix = np.concatenate([matrix, matrix[::-1]])  # (phi_d, theta_h, theta_h)
        f = data[:, j].transpose(1, 0, 2)
        found = f.copy()
        for _ in range(ITERATIONS):
            found = found * f / np.maximum(matrix @ found, 1e-300)
        out[:, j] = found.transpose(1, 0, 2)
    return np.where(np.isfinite(recorded), out, np.nan)


BASELINES = {
    "do nothing": nothing,
    "peak over its loss": peak_over_loss,
    "fit, perfect camera": perfect_camera,
    "Wiener": wiener,
    "Richardson-Lucy": richardson_lucy,
    "table deconvolution": table_deconvolution,
}
RESTORED = {"Wiener": wiener_filtered, "Richardson-Lucy": richardson_lucy_restored}
"""Baselines that restore photographs. They need scikit-image."""


def on_pictures(method, pictures, stated):
    """Table that a baseline recovers from photographs (lamps, rows, columns, 3)."""
    if method in RESTORED:
        return looked_up(restored_pictures(pictures, stated, RESTORED[method]), stated)
    return BASELINES[method](looked_up(pictures, stated), stated)


def restored_pictures(pictures, stated, restore):
    """Photographs whose part around the highlight is restored. restore: (image, kernel) to image."""
    out, kernel = np.array(pictures, float), effective_kernel(stated)
    (column, row), radius = stated["sphere"]["centre_px"], stated["sphere"]["radius_px"]
    inner = slice(HALF - USED, HALF + USED + 1)
    for picture, angle in zip(out, np.radians(stated["lamp_angle_deg"]), strict=True):
        middle = round(row), round(column + radius * np.sin(angle / 2))
        # beyond the frame nothing is recorded
        around = np.pad(picture, ((HALF, HALF), (HALF, HALF), (0, 0)))[
            middle[0] : middle[0] + 2 * HALF + 1, middle[1] : middle[1] + 2 * HALF + 1
        ]
        found = np.stack([restore(one / one.max(), kernel) * one.max() for one in np.moveaxis(around, -1, 0)], -1)
        end = min(middle[1] + USED + 1, picture.shape[1])
        used = np.s_[middle[0] - USED : middle[0] + USED + 1, middle[1] - USED : end]
        picture[used] = np.maximum(found[inner, inner][:, : end - middle[1] + USED], 0)
    return out
