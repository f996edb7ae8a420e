"""Mitsuba 3's `measured` plug-in: what it makes of an RGL file. Directions are arrays (n, 3), light and view.

Its scalar variant is float32 throughout.
"""

import mitsuba
import numpy as np
from scipy import stats


def _opened(path):
    mitsuba.set_variant("scalar_rgb")
    return mitsuba.load_dict({"type": "measured", "filename": str(path)}), mitsuba.BSDFContext()


def evaluated(path, light, view):
    """BRDF times the view's cosine, (n, 3)."""
    bsdf, context = _opened(path)
    interaction = mitsuba.SurfaceInteraction3f()
    result = np.empty((len(light), 3))
    for k, (i, o) in enumerate(zip(light, view, strict=True)):
        interaction.wi = mitsuba.Vector3f(i)
        result[k] = bsdf.eval(context, interaction, mitsuba.Vector3f(o))
    return result


def sampled(path, theta_i, count, seed):
    """(views, weights) of `count` samples for light at theta_i: (n, 3), (n, 3)."""
    bsdf, context = _opened(path)
    interaction = mitsuba.SurfaceInteraction3f()
    interaction.wi = mitsuba.Vector3f(np.sin(theta_i), 0, np.cos(theta_i))
    views, weights = np.empty((count, 3)), np.empty((count, 3))
    for k, (x, y) in enumerate(np.random.default_rng(seed).random((count, 2), dtype=np.float32)):
        sample, weight = bsdf.sample(context, interaction, 0.0, mitsuba.Point2f(x, y))
        views[k], weights[k] = sample.wo, weight
    return views, weights


def chi_square(path, theta_i, count=200_000, seed=1, cells=(24, 16), points=16):
    """p-value of the hypothesis that samples are distributed as the plug-in's own `pdf` says.

    Cells of the half vector, even in sqrt(theta) and azimuth, so that lobes of every width are resolved; the expected
    number by the midpoint rule. Samples below the horizon are lost, as they are in a renderer. Cells that expect fewer
    than 5 are taken together.
    """
    light = np.array([np.sin(theta_i), 0, np.cos(theta_i)])
    views, _ = sampled(path, theta_i, count, seed)
    half = views[views[:, 2] > 0] + light
    u = np.sqrt(np.arctan2(np.hypot(half[:, 0], half[:, 1]), half[:, 2]) * 2 / np.pi)
    v = np.arctan2(half[:, 1], half[:, 0]) / (2 * np.pi) + 0.5
    observed = np.histogram2d(u, v, cells, [[0, 1], [0, 1]])[0].ravel()

    bsdf, context = _opened(path)
    interaction = mitsuba.SurfaceInteraction3f()
    interaction.wi = mitsuba.Vector3f(light)
    middle = [(np.arange(n * points) + 0.5) / (n * points) for n in cells]
    u, v = (a.ravel() for a in np.meshgrid(*middle, indexing="ij"))
    theta, phi = u**2 * np.pi / 2, (2 * v - 1) * np.pi
    half = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)
    towards = half @ light
    views = 2 * towards[:, None] * half - light
    seen = np.flatnonzero((views[:, 2] > 0) & (towards > 0))
    density = np.zeros(u.size)
    density[seen] = [bsdf.pdf(context, interaction, mitsuba.Vector3f(views[k])) for k in seen]
    density *= 4 * towards * 2 * np.pi**2 * u * np.sin(theta) / u.size
    expected = count * density.reshape(cells[0], points, cells[1], points).sum(axis=(1, 3)).ravel()

    lost = count - expected.sum(), count - observed.sum()
    order = np.argsort(expected)
    few = order[: max(int(np.searchsorted(np.cumsum(expected[order]), 5)) + 1, int(np.sum(expected < 5)))]
    many = np.setdiff1d(order, few)
    expected = np.array([*expected[many], expected[few].sum(), lost[0]])
    observed = np.array([*observed[many], observed[few].sum(), lost[1]])
    kept = expected > 5
    statistic = np.sum((observed[kept] - expected[kept]) ** 2 / expected[kept])
    return stats.chi2.sf(statistic, kept.sum() - 1)
