"""The oracle's captures: their pictures are exact where light is bright, by doubling and by another quadrature."""

import numpy as np
import pytest
import tifffile

from tests.oracle import lamp_record
from tests.oracle.capture import direction, lamp_angle, write_tiff
from tests.oracle.smith import smith_lambda
from tests.oracle.sphere_picture import Surface, View, _epd_masking, backlit, fresnel, picture

VIEW = View(radius=60.0, column=70.3, row=68.8, shape=(140, 140))


@pytest.mark.parametrize(("alpha", "theta_d"), [(0.001, 82), (0.02, 20), (0.1, 75)])
def test_pictures_stand_doubling(alpha, theta_d):
    surface = Surface("ggx", alpha, diffuse=(0.1,))
    towards = direction(lamp_angle(np.radians(theta_d), VIEW), 0.7)
    coarse, fine = (picture(surface, VIEW, towards, fine=k)[..., 0] for k in (1, 2))
    highlight = fine > 1e-2 * fine.max()
    assert highlight.sum() > 5
    peak = np.unravel_index(fine.argmax(), fine.shape)
    rows, columns = np.indices(fine.shape)
    close = highlight & (np.hypot(rows - peak[0], columns - peak[1]) < 6)
    relative = np.abs(coarse / np.where(highlight, fine, 1) - 1)
    assert relative[close].max() < 1e-3
    # elsewhere the shadow's edge is the worst: a kink in a place that is hardly lit
    assert relative[highlight].max() < 5e-3
    assert np.abs(coarse - fine).max() < max(1e-4 * fine.max(), 2e-5)


def test_pictures_agree_with_another_quadrature():
    angle = lamp_angle(np.radians(45), VIEW)
    image = picture(Surface("ggx", 0.01), VIEW, direction(angle, 0.7))[..., 0]
    row, column = np.unravel_index(image.argmax(), image.shape)
    rig = lamp_record.Rig(radius=60, distance=40, lamp_distance=25)
    for down, right in ((0, 0), (1, 2)):
        x, y = column + right - VIEW.column, VIEW.row - row - down
        expected = lamp_record.record(x, y, angle, 0.7, lamp_record.Surface(0.01), rig) * fresnel(
            np.cos(np.pi / 4), 1.5, 0
        )
        assert image[row + down, column + right] == pytest.approx(expected, rel=1e-3)  # F varies over the highlight


@pytest.mark.parametrize("power", [0.6, 1.0, 1.7])
def test_masking_of_exponential_power_lobes(power):
    from scipy.special import gamma

    s, values = _epd_masking(power)
    density = lambda r: power / (np.pi * gamma(1 / power)) * np.exp(-(r ** (2 * power)))  # noqa: E731
    for at in (0.05, 0.4, 1.1):
        expected = at * smith_lambda(density, np.arctan(1 / at), 1.0)
        assert np.interp(at, s, values) == pytest.approx(expected, rel=2e-4, abs=1e-6)


def test_a_field_behind_shrinks_the_disc():
    """By r (1 - cos(beyond / 2)) where the mirrored light is as bright as the field (docs/model.md 10)."""
    view = View(radius=60.0, camera=1e6, column=70, row=70, shape=(141, 141))
    sure = Surface(n=(1e-3,), k=(1e4,))  # reflects all
    area = lambda beyond: (1 - backlit(view, beyond, sure)).sum()  # noqa: E731
    assert np.sqrt(area(0.0) / np.pi) == pytest.approx(60, abs=1e-3)
    assert np.sqrt(area(np.radians(10)) / np.pi) == pytest.approx(60 * np.cos(np.radians(5)), abs=3e-3)


@pytest.mark.parametrize("shape", [(5, 7), (5, 7, 3)])
def test_tiff_files_are_what_others_read(tmp_path, shape):
    values = np.arange(np.prod(shape), dtype=np.uint16).reshape(shape) * 13
    write_tiff(tmp_path / "a.tif", values)
    assert (tifffile.imread(tmp_path / "a.tif") == values).all()
