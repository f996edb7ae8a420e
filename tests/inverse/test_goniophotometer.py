"""Materials that no camera has seen: a goniophotometer's files, read as if a camera had photographed a small sphere.

A virtual sphere of 24 px makes the lens that a rig is told, 0.5 px, half as wide as these lobes: it would be seen.
"""

import pytest

from matcam import Rig, Sphere, fit, read_merl, rigs

TOLD = 0.5


def variance(path, **options):
    """(sigma_mtf^2, its standard deviation, px^2, the fit), lens free."""
    table = read_merl(path).isel(channel=[1])
    rig = Rig(rigs.merl().camera, Sphere(24.0))
    found = fit(table, rig, fresnel="free", diffuse=True, camera_parameters="free", slice_step=18, **options)
    return *found.squared_width("optics.sigma_px"), found


@pytest.mark.slow
@pytest.mark.parametrize("spline", [0.0, 1.0])
@pytest.mark.parametrize("material", ["satin_rosaline", "cc_ibiza_sunset", "vch_golden_yellow", "paper_white"])
def test_no_lens_is_found(goniophotometer, material, spline):
    """sigma_mtf = 0 within 2 standard deviations; and where the lobe is narrow enough to tell, not the 0.5 px of the rig."""
    square, std, found = variance(goniophotometer(material), spline=spline)
    print(f"{material}, spline {spline:g}: sigma_mtf^2 {square:.4f} +- {std:.4f} px^2")
    assert square <= 2 * std
    assert any(remark.text.startswith("optics.sigma_px is compatible with 0") for remark in found.remarks)
    if material != "paper_white":  # almost Lambertian: no lens could be seen
        assert square + 2 * std < TOLD**2
