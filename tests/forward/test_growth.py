"""Pictures of many sizes share few programs: each one costs seconds to compile and 10 to 20 MB to keep."""

import numpy as np
import pytest

from matcam import GGX, BoxPixel, Camera, GaussianOptics, Microfacet, Rig, Schlick, Sphere, picture
from matcam.calibration.edge.rows import program_size
from matcam.core.jax import jax
from matcam.numerics.blocks import few_lengths, pad_indices


def test_few_lengths():
    sizes = np.arange(1, 100_000)
    lengths = np.array([few_lengths(int(size)) for size in sizes])
    assert (lengths >= sizes).all()
    assert (np.diff(lengths) >= 0).all()
    assert len(set(lengths[:1024])) == 4
    assert len(set(lengths[:8192])) == 10
    assert (lengths / sizes)[1024:].max() <= 1.5
    assert (lengths / sizes)[8192:].max() <= 1.126
    assert len({program_size(size) for size in range(16, 2048)}) <= 60
    for size in (0, 1, 16, 17, 5000):
        index = np.arange(size)
        padded = pad_indices(index)
        np.testing.assert_array_equal(padded[:size], index)
        assert size == 0 or set(padded[size:]) <= {size - 1}


@pytest.mark.slow
def test_ten_picture_shapes_do_not_compile_ten_times():
    compiled = []

    def listen(name, seconds, **_):
        if name == "/jax/core/compile/backend_compile_duration":
            compiled.append(seconds)

    jax.monitoring.register_event_duration_secs_listener(listen)
    rig, material = Rig(Camera(GaussianOptics(0.5), BoxPixel(0.5)), Sphere(12.0)), Microfacet(GGX(0.1), Schlick(0.9))
    counts = []
    for k in range(10):
        before = len(compiled)
        shape = (16 + 2 * k, 19 + 3 * k)
        assert picture(material, rig, 0.6, shape=shape).shape[:2] == shape
        counts.append(len(compiled) - before)
    jax.monitoring.unregister_event_duration_listener(listen)
    assert sum(counts[1:]) <= 9 * 9, counts  # single operations among them
