"""Records of any rig against sums over a fine grid of the sensor, which choose no nodes: every combination of near and distant
camera and lamp, azimuth, lens, focus and lobe by the same code."""

import numpy as np
import pytest

from docs_claims import limit
from matcam import EPD, GGX, BoxPixel, Camera, GaussianOptics, HaloOptics, Microfacet, NearLamp, Rig, Schlick, Sphere
from matcam.core.jax import jax, jnp
from matcam.forward.integral.blur import imaging_of
from matcam.forward.integral.scene import Scene, Turn, highlight_x
from matcam.forward.sampler.plan import RecordPositions, record_plan
from matcam.forward.sampler.record import record
from matcam.lamp.lamps import DistantLamp

SMOOTH, AT_END = 0.04, 0.006  # px
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
def summed(scene, blur, x, y, line):
    """The sum over a square grid, and whether all of it is visible and lit."""

    def row(dy):
        element, lit = scene.shown(x + line, y + dy)
        spread = blur.spread(scene.sample, element.normal[2], scene.lamp_angle, scene.lamp_nearness)
        kernel = sum(blur.share(term) * blur.at(term, spread, -line, -dy) for term in blur.terms)
        return jnp.sum(jnp.where(lit, scene.sent(element)[..., 0] * kernel, 0.0)), jnp.all(lit)

    sums, whole = jax.lax.map(row, line)
    return jnp.sum(sums), jnp.all(whole)


def brute(scene, blur, x, y, reach):
    """Where the border of the light crosses cells of the grid, their sum is certain to some 2e-5."""
    for step in (SMOOTH, AT_END):
        count = int(reach / step)
        total, whole = summed(scene, blur, x, y, jnp.asarray((np.arange(2 * count) + 0.5 - count) * step))
        if bool(whole):
            break
    return float(total) * step**2


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
