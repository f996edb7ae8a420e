"""A camera behind a Mitsuba rendering: its record, both derivatives, and what is recovered through it."""

import numpy as np
import pytest

from docs_claims import limit
from matcam import Camera, DiffractionOptics, GaussianOptics, ZernikeOptics
from matcam.core.errors import ArgumentError
from matcam.exchange import MitsubaFilm

CAMERA = Camera(GaussianOptics(0.8))


@pytest.mark.parametrize("camera", [CAMERA, Camera(DiffractionOptics(8, 550e-9, 4e-6))])
def test_an_edge_is_the_cameras_edge(camera):
    film = MitsubaFilm(camera, subpixels=4, reach=10)
    image = np.zeros((60 * 4, 60 * 4))
    image[:, 30 * 4 + 1 :] = 1.0  # a quarter of a pixel beyond a border
    distance = np.arange(60) + 0.5 - 30.25
    seen, true = film.record(image)[30], np.asarray(camera.esf(distance))
    inside = np.abs(distance) < 4
    np.testing.assert_allclose(seen[inside], true[inside], atol=1.5e-2)  # of diffraction 2 % lies beyond 10 px


def test_a_lens_that_is_not_symmetric_is_not_mirrored():
    camera = Camera(ZernikeOptics(8, 550e-9, 4e-6, coma=(0.0, 0.2)))
    film = MitsubaFilm(camera, subpixels=2, reach=4)
    image = np.zeros((40, 40))
    image[20:22, 20:22] = 1.0  # unit light in the middle of pixel (10, 10)
    seen = film.record(image)
    for row, column in ((8, 10), (12, 10), (10, 12)):
        # the pixel sees the light at (10 - column, row - 10), y upwards
        expected = float(camera.psf(10.0 - column, row - 10.0))
        assert seen[row, column] == pytest.approx(expected, rel=0.15)


def test_the_adjoint_is_the_transpose():
    film = MitsubaFilm(CAMERA, subpixels=3)
    random = np.random.default_rng(0)
    image, picture = random.standard_normal((36, 48, 3)), random.standard_normal((12, 16, 3))
    forward, backward = float(np.sum(film.record(image) * picture)), float(np.sum(image * film.adjoint(picture)))
    assert abs(forward - backward) < limit("mitsuba-film-adjoint") * np.linalg.norm(image) * np.linalg.norm(picture)


def test_derivatives_in_drjit():
    mi = pytest.importorskip("mitsuba")
    try:
        mi.set_variant("llvm_ad_rgb")
        mi.Float([1.0])
    except Exception as error:
        pytest.skip(f"no LLVM for Mitsuba here: {error}")
    import drjit as dr

    film = MitsubaFilm(CAMERA, subpixels=2)
    random = np.random.default_rng(1)
    image, picture = random.random((16, 20, 3)), random.random((8, 10, 3))
    x = mi.TensorXf(image.astype(np.float32))
    dr.enable_grad(x)
    dr.backward(dr.sum(film(x) * mi.TensorXf(picture.astype(np.float32)), axis=None))
    np.testing.assert_allclose(np.array(x.grad), film.adjoint(picture), rtol=1e-4, atol=1e-6)
    direction = random.random((16, 20, 3))
    scale = mi.Float(2.0)
    dr.enable_grad(scale)
    y = film(mi.TensorXf(direction.astype(np.float32)) * scale)
    dr.forward(scale)
    np.testing.assert_allclose(np.array(y.grad), film.record(direction), rtol=1e-4, atol=1e-6)


def test_wrong_arguments_are_refused():
    with pytest.raises(ArgumentError, match="subpixels must be a whole number"):
        MitsubaFilm(CAMERA, subpixels=0)
    with pytest.raises(ArgumentError, match="reach must be a whole number of px"):
        MitsubaFilm(CAMERA, reach=0)
    with pytest.raises(ArgumentError, match="camera must be a Camera"):
        MitsubaFilm(GaussianOptics(0.8))
    with pytest.raises(ArgumentError, match="and have 4 x 4 subpixels for each pixel"):
        MitsubaFilm(CAMERA).record(np.ones((10, 12)))
