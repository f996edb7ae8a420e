"""Absolute F from a white patch beside the sphere, end to end, on a capture that an independent renderer drew."""

import numpy as np
import pytest

from matcam.files.capture import read_capture
from matcam.reconstruction.from_capture import reconstruct
from tests.oracle.capture import METALS, draw
from tests.oracle.sphere_picture import Surface, View, fresnel

ANGLES = np.radians([6, 14, 22, 30, 38, 50, 63, 75])


@pytest.mark.slow
def test_absolute_reflectance_of_gold(tmp_path):
    view = View(radius=150.0, column=210.4, row=209.2, shape=(420, 420))
    surface = Surface("ggx", 0.02, 1.0, *METALS["Au"], (0.0,))
    drawn = draw(surface, view, ANGLES, azimuth=0.3, reference="diffuse", seed=11)
    found = reconstruct(read_capture(drawn.write(tmp_path)), "ggx")
    assert found.absolute
    units = np.array([unit.value for unit in found.units])
    std = np.sqrt(np.diag(found.fit.strengths_covariance())).reshape(found.fit.strengths.shape) / units
    level = np.array([unit.std for unit in found.units])
    assert (level < 0.01).all()
    for degrees in (30, 75):
        k = int(np.argmin(np.abs(ANGLES - np.radians(degrees))))
        truth = np.array([fresnel(np.cos(np.radians(degrees)), n, c) for n, c in zip(*METALS["Au"], strict=True)])
        relative = found.fit.strengths[k] / units / truth - 1
        assert (np.abs(relative) < 3 * np.hypot(std[k] / truth, level)).all()
        assert (np.abs(relative) < 0.015).all()
    budget = found.budget
    assert budget["reference"]["level"] == pytest.approx(found.units[1].std)
    assert budget["total"]["level"] > budget["reference"]["level"]
    assert budget["reference"]["ratio"] == 0


@pytest.mark.slow
@pytest.mark.parametrize(("far", "seed"), [(25.0, 1), (25.0, 2), (12.0, 4), (12.0, 5)])
def test_a_patch_and_unknown_distances(tmp_path, far, seed):
    """The light on the patch depends on the distance of the lamp, which only the images of the sphere determine."""
    view = View(radius=150.0, column=210.4, row=209.2, shape=(420, 420), lamp=far)
    drawn = draw(
        Surface("ggx", 0.02, 1.0, *METALS["Au"], (0.0,)), view, ANGLES, azimuth=0.3, reference="diffuse", seed=seed
    )
    drawn.settings["distances"] = {}
    found = reconstruct(read_capture(drawn.write(tmp_path)), "ggx")
    units = np.array([unit.value for unit in found.units])
    truth = fresnel(np.cos(ANGLES)[:, None], *map(np.array, METALS["Au"]))
    level = np.log(found.fit.strengths / units / truth).mean()
    covariance = found.fit.strengths_covariance() / np.outer(found.fit.strengths, found.fit.strengths)
    std = np.hypot(np.sqrt(covariance.mean()), found.units[1].std)
    assert abs(level) < 2 * std
    assert std < 0.009
