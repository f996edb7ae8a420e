"""A chart drawn by the package, photographed by the oracle's camera, measured by every target: one camera, one answer."""

import json

import imagecodecs
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from matcam import calibrate
from matcam.calibration.camera.evidence import dot_positions
from matcam.calibration.camera.lens_over_field import lens_over_field
from matcam.calibration.chart.chart import Square
from matcam.calibration.chart.chart_file import read_chart, write_chart
from matcam.calibration.chart.chart_layout import design_chart
from matcam.calibration.targets.targets import measure_targets
from matcam.core.errors import FitError
from matcam.figures.chart import chart_figure
from matcam.figures.style import save
from tests.oracle.chart_camera import ChartCamera


def measured(folder, kinds, pixels, camera, snr, seed, cfa=None):
    """What all targets say, from the photograph and the description's file alone; and the camera."""
    path = folder / "chart.json"
    write_chart(path, design_chart(kinds, pixels_across=pixels), force=True)
    chart, document = read_chart(path), json.loads(path.read_text())
    shot = ChartCamera(page=chart.page, **camera)
    photograph = shot.photograph(shot.expected(document), snr, seed, cfa)
    channel = None if cfa is None else "G"
    found = measure_targets(
        photograph, chart, cfa=cfa, channel=channel, half_width=shot.fill / 2, source="p.tif", f_number=8.0
    )
    return found, shot, chart


def of_kind(found, kind):
    return [s for s in found.samples if s.kind == kind]


def agree(samples, shot, tolerance=0.0):
    """chi2 of samples against the camera, and their number."""
    chi2 = count = 0
    for s in samples:
        error = s.mtf - shot.mtf(s.frequency, s.direction)
        chi2 += error @ np.linalg.solve(s.covariance + tolerance**2 * np.eye(error.size), error)
        count += error.size
    return chi2, count


POSE = {"tilt": (0.07, -0.05), "roll": 0.03, "distortion": 0.02, "vignetting": 0.3}


@pytest.mark.parametrize(
    ("size", "cfa"), [((800, 570), None), pytest.param((1600, 1140), "RGGB", marks=pytest.mark.slow)]
)
def test_all_targets_tell_of_one_camera(tmp_path, size, cfa):
    camera = {"width": size[0], "height": size[1], "sigma": 0.5, "fill": 0.9, **POSE}
    found, shot, chart = measured(tmp_path, ("squares", "bars", "star", "dots"), size[0], camera, 60, 3, cfa)
    assert any(isinstance(element, Square) for element in chart.elements)
    assert found.problems == ()
    assert {s.f_number for s in found.samples} == {8.0}
    for kind in ("star", "grating", "dots"):
        # 0.001: what a grating's local frequency changes over its own length
        chi2, count = agree(of_kind(found, kind), shot, 0.001)
        assert abs(chi2 / count - 1) < 4.5 * np.sqrt(2 / count), (kind, chi2, count)
    assert found.grids[0].sigma.mean() == pytest.approx(0.5, rel=0.01)
    field = lens_over_field(dot_positions(found.grids), size[::-1])
    # the drawing states where the pinhole saw what is seen at r: r (1 + 0.02 r^2), the other way round
    seen = 0.6
    pinhole = field.true_position(field.centre[0] + seen * field.unit, field.centre[1])[0] - field.centre[0]
    assert abs(pinhole / field.unit - seen * (1 + POSE["distortion"] * seen**2)) < 4 * field.k1.std * seen**3
    assert field.k1.std < 0.001


@pytest.mark.slow
@pytest.mark.parametrize(("sigma", "fill"), [(0.4, 1.0), (0.7, 0.6), (1.0, 0.8)])
def test_figures_at_snr_60_by_averages(tmp_path, sigma, fill):
    """Means over pictures: star 0.004, bars 0.005, dots 1 % of sigma."""
    camera = {"width": 1200, "height": 860, "sigma": sigma, "fill": fill, **POSE}
    errors, sigmas = {"star": {}, "grating": {}}, []
    for seed in range(6):
        found, shot, _ = measured(tmp_path, ("bars", "star", "dots"), 1200, camera, 60, seed)
        for kind, collected in errors.items():
            for s in of_kind(found, kind):
                # a grating's samples by their harmonic: those that tell nothing are left out
                names = np.round(s.frequency / s.frequency[0]) if kind == "grating" else np.arange(s.frequency.size)
                off = s.mtf - shot.mtf(s.frequency, s.direction)
                for name, f, o in zip(names, s.frequency, off, strict=True):
                    collected.setdefault((s.source, name), []).append((f, o))
        sigmas.append(found.grids[0].sigma.mean() / sigma - 1)
    for kind, bound in (("star", 0.004), ("grating", 0.005)):
        of_six = np.array([t for t in errors[kind].values() if len(t) == 6])
        table = of_six.mean(axis=1)
        # where the scatter of six pictures leaves less noise than a third of the bound: a stated error holds the print's, too
        left = of_six[:, :, 1].std(axis=1, ddof=1) / np.sqrt(6)
        told = (table[:, 0] <= 0.5) & (left < bound / 3)
        mean = table[told, 1]
        print(kind, sigma, told.sum(), np.abs(mean).max(), np.sqrt(np.mean(mean**2)))
        assert told.sum() >= 4
        assert np.abs(mean).max() < bound
    print("dots", sigma, np.mean(sigmas), np.std(sigmas))
    assert np.abs(sigmas).max() < 0.01


def test_what_cannot_be_measured_is_listed(tmp_path):
    camera = {"width": 700, "height": 500, "sigma": 0.5, "fill": 0.9}
    path = tmp_path / "chart.json"
    write_chart(path, design_chart(("star", "bars"), pixels_across=700))
    chart, document = read_chart(path), json.loads(path.read_text())
    hidden = [e for e in document["elements"] if e["kind"] != "star"]
    shot = ChartCamera(page=chart.page, **camera)
    photograph = shot.photograph(shot.expected({**document, "elements": hidden}), 60, 1)
    found = measure_targets(photograph, chart, source="a.png")
    assert len(found.problems) == 1
    assert found.problems[0].text.startswith("star ")
    assert len(found.samples) == sum(e["kind"] == "grating" for e in hidden)
    with pytest.raises(FitError) as error:
        measure_targets(photograph[:200, :200], chart)
    assert "no chart of this description" in str(error.value)


@pytest.mark.slow
def test_the_page_itself_closes_the_loop(tmp_path):
    """The printed page's pixels, 18 to one of the camera, blurred and summed: what is drawn is what the description says."""
    fine, across, sigma = 18, 480, 0.5
    chart = design_chart(("star", "bars", "dots"), page=(152.4, 111.76), pixels_across=across)
    save(chart_figure(chart), tmp_path / "page.png", dpi=across * fine / 6)
    code = imagecodecs.png_decode((tmp_path / "page.png").read_bytes())[..., 0]
    by_code = np.arange(256) / 255
    by_code = np.where(by_code <= 0.04045, by_code / 12.92, ((by_code + 0.055) / 1.055) ** 2.4).astype(np.float32)
    blurred = gaussian_filter(by_code[code], sigma * fine, truncate=5)
    height, width = (n // fine for n in blurred.shape)
    picture = blurred[: height * fine, : width * fine].reshape(height, fine, width, fine).mean((1, 3), dtype=float)
    picture = np.random.default_rng(0).poisson(picture * 300**2).astype(float)
    found = measure_targets(picture, chart)
    assert found.problems == ()
    for kind, bound in (("star", 0.004), ("grating", 0.005)):
        for s in of_kind(found, kind):
            fx, fy = s.frequency * np.cos(s.direction), s.frequency * np.sin(s.direction)
            truth = np.exp(-2 * (np.pi * sigma * s.frequency) ** 2) * np.sinc(fx) * np.sinc(fy)
            off = np.abs(s.mtf - truth)[(s.frequency <= 0.5) & (s.mtf_std < bound / 3)]
            print(kind, off.max(initial=0), off.size)
            assert (off < bound).all()
    # pixels that a dot shares with the paper are averaged in codes: its radius grows by 0.15 px of the page, 0.6 %
    print("dots", found.grids[0].sigma.mean())
    assert found.grids[0].sigma.mean() == pytest.approx(sigma, rel=0.02)


def test_a_photograph_without_its_squares_says_that_no_edge_was_measured(tmp_path):
    """The gratings alone give the camera."""
    path = tmp_path / "chart.json"
    write_chart(path, design_chart(("squares", "bars"), pixels_across=800))
    chart, document = read_chart(path), json.loads(path.read_text())
    bare = document | {"elements": [one for one in document["elements"] if one["kind"] != "square"]}
    shot = ChartCamera(page=chart.page, width=800, height=570, sigma=0.5, fill=1.0)
    found = calibrate([shot.photograph(shot.expected(bare), 60, 3)], chart=chart)
    (remark,) = found.remarks
    assert remark.code == "edges-not-measured"
    assert "no slanted edge was found" in remark.text
    fit = found.channels["grey"]
    assert abs(fit.values[0] - 0.5) < 4 * fit.std[0] < 0.02
