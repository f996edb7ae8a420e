"""A record in blocks equals the record in one, and keeps few plans."""

import numpy as np
import pytest

from matcam import GGX, BoxPixel, Camera, GaussianOptics, Microfacet, Rig, Sphere
from matcam.core.jax import jax
from matcam.forward.integral.blur import imaging_of
from matcam.forward.sampler import planned_blocks
from matcam.forward.sampler.plan import RecordPositions, record_plan
from matcam.forward.sampler.planned_blocks import PlannedBlocks
from matcam.forward.sampler.record import record

MATERIAL = Microfacet(GGX(0.1), 0.9)


@pytest.fixture(scope="module")
def imaging():
    return imaging_of(Rig(Camera(GaussianOptics(0.5), BoxPixel()), Sphere(20.0)))


POSITIONS = RecordPositions(np.linspace(-25.0, 25.0, 11), np.zeros(11), np.full(11, 0.7))


@pytest.mark.parametrize(("most", "kept"), [(1e9, 3), (0.0, 1)])
def test_blocks_are_the_whole(imaging, monkeypatch, most, kept):
    monkeypatch.setattr(planned_blocks, "_POSITIONS", 4)
    monkeypatch.setattr(planned_blocks, "_KEPT_BYTES", most)
    blocks = PlannedBlocks(imaging, POSITIONS, float(MATERIAL.finest))
    whole = np.asarray(record(MATERIAL, imaging, record_plan(imaging, POSITIONS, float(MATERIAL.finest))))
    for _ in range(2):  # with plans that were kept, too
        np.testing.assert_allclose(np.asarray(blocks.record(MATERIAL, imaging)), whole, rtol=1e-6)
    assert len(blocks._kept) == kept


def test_derivatives_pass_the_blocks(imaging, monkeypatch):
    monkeypatch.setattr(planned_blocks, "_POSITIONS", 4)
    blocks = PlannedBlocks(imaging, POSITIONS, 0.05)
    slope = jax.jacfwd(lambda alpha: blocks.record(Microfacet(GGX(alpha), 0.9), imaging)[:, 0])(0.1)
    above, below = (np.asarray(blocks.record(Microfacet(GGX(a), 0.9), imaging))[:, 0] for a in (0.1 + 1e-5, 0.1 - 1e-5))
    np.testing.assert_allclose(slope, (above - below) / 2e-5, rtol=1e-6, atol=1e-6 * np.abs(slope).max())


def test_no_positions(imaging):
    none = RecordPositions(*(np.zeros(0),) * 3)
    assert PlannedBlocks(imaging, none, 0.1).record(MATERIAL, imaging).shape == (0, 1)
