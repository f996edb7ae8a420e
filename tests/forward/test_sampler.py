"""Records of any rig against sums over equal squares of the sensor, which follow nothing but the end of the light: every
combination of near and distant camera and lamp, azimuth, lens, focus and lobe by the same code."""

import numpy as np
import pytest
from scipy.ndimage import maximum_filter, minimum_filter

from docs_claims import limit
from matcam import EPD, GGX, BoxPixel, Camera, GaussianOptics, HaloOptics, Microfacet, NearLamp, Rig, Schlick, Sphere
from matcam.core.jax import jax, jnp
from matcam.forward.integral.blur import imaging_of
from matcam.forward.integral.scene import Scene, Turn, highlight_x
from matcam.forward.sampler.plan import RecordPositions, record_plan
from matcam.forward.sampler.record import record
from matcam.lamp.lamps import DistantLamp

SQUARE = 0.24  # px
SMOOTH, AT_END = 6, 40  # nodes along a square: of Gauss and Legendre, and of the midpoint rule where light ends
TOGETHER = 32  # squares
FAST, SLOW = 1, 60


def drawn(seed):
    """A rig, a lobe as wide as some pixels, the lamp's angle and azimuth, and six pixels: about the highlight, at the limb,
    at the terminator, and anywhere."""
    random = np.random.default_rng(seed)
    radius = random.uniform(40, 90)
    sigma = random.uniform(0.25, 0.7)
    lens = GaussianOptics(sigma) if random.random() < 0.7 else HaloOptics(GaussianOptics(sigma), 0.03, 2.0)
    lamp = NearLamp(random.uniform(4, 20)) if random.random() < 0.5 else DistantLamp()
    camera = Sphere(radius, random.uniform(5, 30)) if random.random() < 0.5 else Sphere(radius)
    focus = {"aperture": random.uniform(0.002, 0.02)} if random.random() < 0.25 else {}
    rig = Rig(Camera(lens, BoxPixel(random.uniform(0.3, 0.5))), camera, lamp, **focus)
    rough = random.uniform(0.04, 0.3)
    lobe = GGX(rough) if random.random() < 0.5 else EPD(rough, random.uniform(0.6, 1.5))
    material = Microfacet(lobe, Schlick(random.uniform(0.05, 0.9)), random.choice([0.0, 0.2]))
    angle, azimuth = random.uniform(0.1, 2.4), random.choice([0.0, random.uniform(-3, 3)])
    peak = float(highlight_x(rig.sample, jnp.asarray(angle), rig.lamp.nearness))
    turn = random.uniform(-1.2, 1.2, 2)
    lit = azimuth + turn[0]
    x = peak * np.cos(azimuth), radius * np.cos(lit), *random.uniform(-0.6, 0.6, 2) * radius
    y = peak * np.sin(azimuth), radius * np.sin(lit), *random.uniform(-0.6, 0.6, 2) * radius
    x, y = (np.array([*a, a[0], a[1]]) + random.uniform(-3, 3, 6) for a in (x, y))
    return rig, material, angle, azimuth, x, y


@jax.jit
def summed(scene, blur, x, y, corners, nodes, weights):
    """Sums over squares of the sensor by a product rule; whether all of a square is visible and lit, and whether any shines."""
    dx, dy = nodes[:, None], nodes[None, :]

    def square(corner):
        right, up = corner[0] + dx, corner[1] + dy
        element, lit = scene.shown(x + right, y + up)
        spread = blur.spread(scene.sample, element.normal[2], scene.lamp_angle, scene.lamp_nearness)
        kernel = sum(blur.share(term) * blur.at(term, spread, -right, -up) for term in blur.terms)
        light = jnp.where(lit, scene.sent(element)[..., 0] * kernel, 0.0)
        return weights @ light @ weights, jnp.all(lit), jnp.any(light > 0)

    return jax.lax.map(square, corners)


def brute(scene, blur, x, y, reach):
    """Where the border of the light crosses squares of the sensor, the sum is certain to some 2e-5."""
    line = np.arange(-np.ceil(reach / SQUARE), np.ceil(reach / SQUARE)) * SQUARE
    corners = np.stack(np.meshgrid(line, line, indexing="ij"), axis=-1)
    unit, weight = np.polynomial.legendre.leggauss(SMOOTH)
    smooth = SQUARE / 2 * (1 + unit), SQUARE / 2 * weight
    found = summed(scene, blur, x, y, corners.reshape(-1, 2), *smooth)
    sums, whole, some = (np.asarray(each).reshape(corners.shape[:2]) for each in found)
    # a border may cross a square between its nodes: then it crosses one beside it
    at_end = ~minimum_filter(whole, 3) & maximum_filter(some, 3)
    total = sums[~at_end].sum()
    fine = (np.arange(AT_END) + 0.5) * SQUARE / AT_END, np.full(AT_END, SQUARE / AT_END)
    at = corners[at_end]
    for k in range(0, len(at), TOGETHER):
        some = at[k : k + TOGETHER]
        padded = np.pad(some, ((0, TOGETHER - len(some)), (0, 0)))
        total += np.asarray(summed(scene, blur, x, y, padded, *fine)[0])[: len(some)].sum()
    return total


@pytest.mark.parametrize(
    "seed", [*range(FAST), *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(FAST, SLOW))]
)
def test_any_rig(seed):
    rig, material, angle, azimuth, x, y = drawn(seed)
    imaging = imaging_of(rig)
    positions = RecordPositions(x, y, np.full(x.size, angle), np.full(x.size, azimuth) if azimuth else None)
    found = np.asarray(record(material, imaging, record_plan(imaging, positions, float(material.finest))))[:, 0]
    turn = Turn(jnp.cos(azimuth), jnp.sin(azimuth)) if azimuth else None
    scene = Scene(material, imaging.sample, jnp.asarray(angle), imaging.lamp_nearness, turn)
    reach = 6.5 * float(imaging.blur.stds.max()) + (1.0 if imaging.blur.chords else 0.0) + 1
    truth = np.array([brute(scene, imaging.blur, *at, reach) for at in zip(x, y, strict=True)])
    allowed = np.maximum(limit("recorded-cells") * truth, 1e-6 * truth.max())
    assert (np.abs(found - truth) < allowed).all(), (found, truth)


def test_tiles_of_a_gpu(monkeypatch):
    """A GPU computes all rows in one tile per kind, and adds them itself: the record is the same as in small tiles."""
    rig, material, angle, _, x, y = drawn(0)
    imaging = imaging_of(rig)
    positions = RecordPositions(x, y, np.full(x.size, angle))
    plan = record_plan(imaging, positions, float(material.finest))
    in_small_tiles = np.asarray(record(material, imaging, plan))
    monkeypatch.setattr("matcam.forward.sampler.record.computes_on_gpu", lambda: True)
    monkeypatch.setattr("matcam.forward.sampler.record._ROWS_ON_GPU", 1 << 12)
    in_large_tiles = record(material, imaging, plan)
    # arcs of one tile have the largest number of nodes of any of them
    np.testing.assert_allclose(in_large_tiles, in_small_tiles, rtol=limit("recorded-cells"), atol=1e-9)


@pytest.mark.slow
def test_lobes_without_a_closed_lambda(monkeypatch):
    """Lambda from a table, instead of a quadrature at every node, which takes fifty times as long."""
    rig, _, angle, _, x, y = drawn(0)
    material, imaging = Microfacet(EPD(0.05, 2.0), 0.9), imaging_of(rig)
    positions = RecordPositions(x[:4], y[:4], np.full(4, angle))
    plan = record_plan(imaging, positions, 0.05)
    from_table = np.asarray(record(material, imaging, plan))
    monkeypatch.setattr("matcam.forward.sampler.record.with_tabulated_masking", lambda material: material)
    np.testing.assert_allclose(from_table, record(material, imaging, plan), rtol=2e-5)
