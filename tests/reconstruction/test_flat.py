"""Maps of a flat sample from pictures that an independent renderer drew, judged frequency by frequency."""

import dataclasses

import numpy as np
import pytest

from matcam import Camera, GaussianOptics
from matcam.acquisition.merged_picture import MergedPicture
from matcam.core.errors import ArgumentError, FitError
from matcam.reconstruction.flat.flat_reconstruction import reconstructed_flat
from matcam.reconstruction.flat.flat_stack import FlatPicture
from matcam.reconstruction.from_capture import reconstruct
from tests.oracle.flat_picture import FlatStand, direction, draw, random_texture

STAND = FlatStand()
TILTS = np.radians([0, 8, 16, 24, 32, 40, 10, 20])
LAMPS = [np.radians(angle) for angle in (20, 20, 20, 20, 20, 20, 60, 60)]
RINGS = ((0.03, 0.1), (0.1, 0.2), (0.2, 0.3), (0.3, 0.4), (0.4, 0.5))


def stack(seed, electrons=2e4, stand=STAND):
    """Two maps, and their pictures with photon and read noise and 0.5 % of drift."""
    rng = np.random.default_rng(seed)
    maps = random_texture(0.4, 0.08, -2.0, 256, rng), random_texture(0.06, 0.02, -1.5, 256, rng)
    seen = [stand.picture(*maps, tilt, direction(lamp, 0.0)) for tilt, lamp in zip(TILTS, LAMPS, strict=True)]
    scale = electrons / max(one.max() for one in seen)
    nothing = np.zeros(stand.shape, int)
    pictures = []
    for k, (clean, tilt, lamp) in enumerate(zip(seen, TILTS, LAMPS, strict=True)):
        light = rng.poisson(scale * clean * np.exp(0.005 * rng.standard_normal())) + 3 * rng.standard_normal(
            clean.shape
        )
        merged = MergedPicture(f"L{k}", light, np.sqrt(np.maximum(light, 1) + 9), nothing > 0, nothing, ("grey",))
        pictures.append(FlatPicture(merged, tilt, direction(lamp, 0.0), 0.005))
    return maps, pictures


def found_and_true(seed, electrons=2e4):
    maps, pictures = stack(seed, electrons)
    found = reconstructed_flat(pictures, Camera(GaussianOptics(STAND.sigma)), mm_per_px=(0.02, 0.0))
    x, y = found.maps.x.values, found.maps.y.values
    return found, {name: one.at(x, y) for name, one in zip(("diffuse", "specular"), maps, strict=True)}


def ring_pulls(found, true, name):
    """Power of the map's error over the stated variance, ring by ring; the map's scale is taken from its mean."""
    values = found.maps[name].values
    scale = values.mean() / true[name].mean()
    window = np.hanning(values.shape[0])[:, None] * np.hanning(values.shape[1])
    spectrum = np.fft.fft2((values - scale * true[name]) * window)
    power = np.abs(spectrum) ** 2 / (window**2).sum()
    radius = np.hypot(*np.meshgrid(*(np.fft.fftfreq(n) for n in values.shape), indexing="ij"))
    at = np.hypot(*np.meshgrid(found.maps.frequency_y, found.maps.frequency_x, indexing="ij"))
    stated = found.maps[f"{name}_error"].values
    return np.array(
        [power[(radius >= a) & (radius < b)].mean() / stated[(at >= a) & (at < b)].mean() for a, b in RINGS]
    )


@pytest.mark.parametrize("electrons", [2e4, 1e3])
def test_maps_err_as_stated_at_every_frequency(electrons):
    """Error power over stated variance within 0.75 to 1.3 in every ring up to the grid's limit; roughness within 4 std."""
    ratios = []
    for seed in range(3):
        found, true = found_and_true(seed, electrons)
        alpha, std = found.parameters["alpha"]
        assert abs(alpha - STAND.alpha) < 4 * std
        assert std < 0.05 * STAND.alpha
        assert found.misfit == pytest.approx(1, abs=0.1)
        ratios.append([ring_pulls(found, true, name) for name in ("diffuse", "specular")])
        relative = found.parameters["mean_specular"]
        truth = true["specular"].mean() / true["diffuse"].mean()
        assert abs(relative[0] / found.parameters["mean_diffuse"][0] - truth) < 5 * relative[1]
    mean = np.mean(ratios, axis=0)
    assert mean.min() > 0.75
    assert mean.max() < 1.3


def test_fine_texture_is_lost_and_coarse_is_resolved():
    """In little light the specular map's fine half is lost; the stated cut-off is where half of the prior is left."""
    bright, _ = found_and_true(0)
    dim, true = found_and_true(0, 300)
    for name in ("diffuse", "specular"):
        assert np.all(np.array(dim.cutoffs[name]) < np.array(bright.cutoffs[name]))
        resolved = dim.maps[f"{name}_resolved"].values
        radius = np.hypot(*np.meshgrid(dim.maps.frequency_y, dim.maps.frequency_x, indexing="ij"))
        assert resolved[(radius > 0) & (radius < 0.03)].min() > 0.9
        assert resolved[radius > 0.6].max() < 0.1
    assert "lp/mm" in dim.verdict
    coarse = dataclasses.replace(dim, cutoffs={**dim.cutoffs, "diffuse": [0.0039, 0.0078]})
    assert "diffuse up to 0.0039 x 0.0078 cycles/px" in coarse.verdict
    # what is not resolved is not made up: the map is smoother than the truth
    values = dim.maps["specular"].values
    assert (values / values.mean()).std() < (true["specular"] / true["specular"].mean()).std()


def test_a_lamp_behind_the_sample_is_named():
    _, pictures = stack(0)
    behind = pictures[0]._replace(towards=direction(np.radians(120), 0.0))
    with pytest.raises(FitError, match="L0: the lamp or the camera is behind the sample"):
        reconstructed_flat([behind, *pictures[1:]], Camera(GaussianOptics(STAND.sigma)))


def test_small_pictures_are_refused():
    _, pictures = stack(0, stand=STAND._replace(shape=(60, 200)))
    with pytest.raises(FitError, match="images of 60 x 200 px are too small"):
        reconstructed_flat(pictures, Camera(GaussianOptics(STAND.sigma)))


def test_the_reference_divides_the_pictures(tmp_path):
    """The lamp's light differs by 20 % between the pictures; a monitor in pictures of its own says by how much."""
    rng = np.random.default_rng(5)
    maps = random_texture(0.4, 0.08, -2.0, 256, rng), random_texture(0.06, 0.02, -1.5, 256, rng)
    lamps = [(lamp, 0.0) for lamp in LAMPS]
    drawn = draw(*maps, STAND, TILTS, lamps, gain_std=0.2, lens_std=1e-3, seed=6)
    drawn.settings["reference"] = {"kind": "monitor", "region_px": [40, 40, 60, 60], "apart": True, "between_std": 1e-3}
    for number, gain in enumerate(drawn.truth["gains"]):
        file = f"reference/L{number:02d}.tif"
        electrons = np.full(STAND.shape, 9000 * gain / max(drawn.truth["gains"]))
        drawn.frames[file] = np.round(256 + 0.5 * rng.poisson(electrons)).astype(np.uint16)
        drawn.rows.append({"file": file, "lamp": f"L{number:02d}", "exposure": "E0", "time_s": "0.001"})
    folder = drawn.write(tmp_path)
    with pytest.raises(ArgumentError, match="diffuse = False cannot be given for a flat sample"):
        reconstruct(folder, "ggx", diffuse=False)
    found = reconstruct(folder, "ggx")
    alpha, std = found.parameters["alpha"]
    assert abs(alpha - STAND.alpha) < 4 * std < 0.1 * STAND.alpha
    assert found.misfit == pytest.approx(1, abs=0.1)
    assert found.gains[:, 1].max() < 0.005  # 20 % were stated
    for name, (value, std) in found.parameters.items():
        budget = found.uncertainty_budget(name)
        assert (budget.value, budget.combined) == (value, std)
        assert {source.kind for source in budget.sources} == {"A", "B"}
