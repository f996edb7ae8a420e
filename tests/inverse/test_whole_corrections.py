"""Corrections of whole tables whose truth is the oracle's: every entry is judged, and `fresnel` must agree with `correct`."""

from functools import cache
from unittest.mock import patch

import numpy as np
import pytest
import xarray as xr

from matcam import fresnel, rigs
from matcam.inverse import Correction
from matcam.inverse.correction import correction
from tests.inverse import recorded
from tests.inverse.whole_tables import stored
from tests.oracle.merl_lobe import PHI_D, THETA_D, THETA_H
from tests.oracle.whole_tables import CASES, case_of

EVERY = 6
NAMES = [case.name for case in CASES]
WRONG_LENS = "lens wider", "lens narrower"
_CLASSES = {"peak": (0.5, np.inf), "slope": (0.01, 0.5), "tail": (0.0, 0.01)}
"""Share of the facets at the lobe's middle, from and to."""
_DARKEST = 1e-9
"""1/sr; true values below are not judged by their relative error."""


@cache
def corrected(name):
    """Counts and errors of a case's correction."""
    case = case_of(name)
    whole = stored(case)
    coords = {"theta_h": THETA_H, "theta_d": THETA_D, "phi_d": PHI_D, "channel": list("RGB")}
    table = xr.DataArray(whole.recorded, dims=tuple(coords), coords=coords, attrs={"sampling": "centre"})
    width, known = case.stated or (None, None)
    rig = rigs.merl() if width is None else recorded.rig(width, std=width * known)
    kept = []

    def explained(*args, explain=correction.explain, **more):
        kept.append(explain(*args, **more))
        return kept[-1]

    with patch.object(correction, "explain", explained):
        done = Correction.of(table, rig)
    # `fresnel` of the same slices finds the same explanation: it is not made twice
    with patch("matcam.inverse.fresnel_term.explain", lambda *args, **more: kept[0]):
        curve = fresnel(table, rig, slice_step=EVERY)
    value, std, supported = (done.table[part].values for part in ("brdf", "brdf_std", "supported"))
    true = whole.true
    judged = np.isfinite(std) & (true > _DARKEST)
    error = np.abs(value - true)
    with np.errstate(invalid="ignore", divide="ignore"):
        pull = error / std
        share = true / np.nanmax(true[:1], axis=2, keepdims=True)
    classes = {}
    for kind, (low, high) in _CLASSES.items():
        for said, chosen in (("supported", supported), ("not supported", ~supported)):
            here = pull[judged & chosen & (share > low) & (share <= high)]
            classes[f"{kind}, {said}"] = here.size, int((here < 1).sum()), int((here < 2).sum())
    peaks = np.s_[0, 5:81, 90]
    kept_share = whole.clean[peaks] / true[peaks]
    return {
        "done": done, "curve": curve, "classes": classes, "judged": int(judged.sum()),
        "false": float(np.mean(pull[judged & supported] > 3)) if supported.any() else 0.0,
        "harmed": float(np.mean((error > np.abs(whole.recorded - true) + 2 * std + 0.01 * true)[judged])),
        "peaks": (value[peaks] / true[peaks], std[peaks] / true[peaks], supported[peaks], kept_share),
        "fresnel": case.terms[0].factor(curve.theta_d.values),
    }  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_no_table_is_harmed(name):
    """False support below 1 %, below 3 % at worst, harm below 0.1 %; peaks supported where 20 % is kept and the lens known."""
    found = corrected(name)
    ratio, std, supported, kept = found["peaks"]
    print(
        f"{name}: {found['done'].determination}, {found['done'].fit.lobe_name}, false support {found['false']:.4f}, harmed "
        f"{found['harmed']:.6f}, peaks {np.abs(ratio - 1).mean():.4f} off, stated {np.median(std):.4f}, supported "
        f"{supported.mean():.3f}"
    )
    assert found["false"] < 0.01
    assert found["harmed"] < 1e-3
    if found["done"].withheld:
        assert name in WRONG_LENS
        assert not found["done"].table["supported"].any()
        return
    if name == "clear coat" and not supported.any():
        pytest.xfail("coat and flake have an F each, and every member of the list has one F for all facets")
    assert supported[kept >= 0.2].mean() >= 0.95
    seen = supported & (kept >= 0.2)
    assert np.sqrt(np.mean(((ratio - 1) / std)[seen] ** 2)) < 1.5


@pytest.mark.slow
def test_stated_errors_hold():
    """Coverage of all tables together, class by class."""
    for kind in corrected(NAMES[0])["classes"]:
        counts = np.array([corrected(name)["classes"][kind] for name in NAMES if not corrected(name)["done"].withheld])
        # every table counts alike, whatever the number of its entries
        shares = (counts[:, 1:] / np.maximum(counts[:, :1], 1))[counts[:, 0] > 1000]
        within = shares.mean(axis=0)
        print(f"{kind}: {within[0]:.1%} within 1 standard deviation, {within[1]:.1%} within 2, {len(shares)} tables")
        if len(shares) >= 5:  # the entries of one table share their errors
            assert within[0] > 0.6, kind
            assert within[1] > 0.93, kind


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_fresnel_agrees_with_the_truth_and_with_the_corrected_peaks(name):
    """F(75) within 3 stated standard deviations of the truth, and of the F that the corrected peaks show."""
    found = corrected(name)
    if found["done"].withheld:
        return
    curve, table = found["curve"], found["done"].table
    theta_d = curve.theta_d.values
    range_ = (theta_d >= np.radians(10)) & (theta_d <= np.radians(45))
    rows = [int(np.argmin(np.abs(THETA_D - one))) for one in theta_d]
    peaks = table["brdf"].values[0, rows, 90]
    error = table["brdf_std"].values[0, rows, 90] / peaks
    shown = peaks * (np.cos(theta_d) ** 2 / curve["masking"].values)[:, None]
    truth = found["fresnel"] / found["fresnel"][range_].mean(axis=0)
    shown /= shown[range_].mean(axis=0)
    f, std = curve["corrected"].values, curve["corrected_std"].values
    at = int(np.argmin(np.abs(theta_d - np.radians(75.5))))
    print(f"{name}: F(75) {f[at] / truth[at] - 1} +- {std[at] / truth[at]}; peaks {shown[at] / truth[at] - 1}")
    assert np.all(np.abs(f - truth)[at] < 3 * std[at] + 1e-3)
    assert np.all(np.abs(f - shown)[at] < 3 * np.hypot(std[at], f[at] * error[at]))
