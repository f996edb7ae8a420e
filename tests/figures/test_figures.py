"""Every figure: axes are labelled with units, nothing is clipped, and the same data give the same file."""

import re
from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from matcam import GGX, Camera, GaussianOptics, edge_mtf, fresnel, paper, rigs
from matcam.core.errors import OutputError
from matcam.core.grid import brdf_table
from matcam.figures.calibration import draw_calibration, edge_figure, targets_figure
from matcam.figures.curves import fresnel_figure, highlight_figure, loss_figure, prediction_figure
from matcam.figures.style import save
from matcam.forward.prediction import predicted
from matcam.inverse import tabulated_fresnel
from matcam.targets import MTFSamples
from tests.oracle import merl_lobe, slanted_edge


@pytest.fixture(scope="module")
def figures():
    table = brdf_table(merl_lobe.record(0.002, np.ones((90, 3))), "centre")
    result = fresnel(table, rigs.merl(), ndf="beckmann", slice_step=6)
    result.attrs["source"] = "a-rather-long-name-of-a-material.binary"
    edge = slanted_edge.photographs(slanted_edge.gaussian(0.5), 100, 1, 3)[0]
    return {
        "edge": edge_figure(edge_mtf(edge), edge, None, r"a-rather-long-name-$\frac$-photograph.tif"),
        "figure 3": highlight_figure(paper.figure_3_4(10.0)),
        "figure 4": highlight_figure(paper.figure_3_4(1.0)),
        "figure 5": loss_figure(paper.figure_5()),
        "figure 6": fresnel_figure(result, tabulated_fresnel(result, "Cr")),
        "figure 6 with the closest materials": fresnel_figure(result, tabulated_fresnel(result)),
        "figure 6 without tables": fresnel_figure(result),
        "targets": targets_figure(_samples(), Camera(GaussianOptics(0.5)), "a-rather-long-name-of-a-photograph.tif"),
        "targets without a camera": targets_figure(_samples()),
        "prediction": prediction_figure(predicted(rigs.merl(), [GGX(a) for a in (0.001, 0.01, 0.1)]), "Loss"),
    }


NAMES = ["edge", "figure 3", "figure 4", "figure 5", "figure 6", "figure 6 without tables", "prediction"]
NAMES += ["figure 6 with the closest materials", "targets", "targets without a camera"]


def _samples():
    f = np.array([0.1, 0.3, 0.5])
    return [
        MTFSamples(kind, (9, 9), f, 0 * f, np.exp(-9 * f**2), 1e-4 * np.eye(3))
        for kind in ("star", "grating", "dots", "edge")
    ]


def test_materials_that_were_chosen_by_the_data_are_called_the_closest(figures):
    close, given = (
        {text.get_text() for text in figures[name].legends[0].get_texts()}
        for name in ("figure 6 with the closest materials", "figure 6")
    )
    assert sum(text.startswith("closest: ") for text in close) == 4
    assert any(text.startswith("Cr (") for text in given)


@pytest.mark.parametrize("name", NAMES)
def test_axes_have_labels_with_units(figures, name):
    for axes in figures[name].axes:
        assert re.search(r"\[\S+\]$", axes.get_xlabel())
    assert re.search(r"\[\S+\]$", figures[name].axes[0].get_ylabel())


@pytest.mark.parametrize("name", NAMES)
def test_no_text_is_clipped_or_overlapping_its_neighbour(figures, name):
    figure = figures[name]
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    renderer = canvas.get_renderer()
    width, height = figure.canvas.get_width_height()
    texts = [t for axes in figure.axes for t in (axes.title, axes._left_title, axes.xaxis.label, axes.yaxis.label)]
    for axes in figure.axes:
        low, high = axes.get_xlim()
        texts += [t for t in axes.get_xticklabels() if low <= t.get_position()[0] <= high]
    legends = [legend for legend in [*(axes.get_legend() for axes in figure.axes), *figure.legends] if legend]
    boxes = [t.get_window_extent(renderer) for t in texts if t.get_text() and t.get_visible()]
    boxes += [legend.get_window_extent(renderer) for legend in legends]
    for box in boxes:
        assert box.x0 >= -1
        assert box.y0 >= -1
        assert box.x1 <= width + 1
        assert box.y1 <= height + 1
    titles = [axes._left_title.get_window_extent(renderer) for axes in figure.axes if axes._left_title.get_text()]
    for left, right in zip(titles, titles[1:], strict=False):
        assert not left.overlaps(right)


def test_no_data_or_text_lies_under_the_legends_of_an_edge(figures):
    figure = figures["edge"]
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    renderer = canvas.get_renderer()
    residuals = next(axes for axes in figure.axes if axes.get_title(loc="left") == "Residuals")
    box = residuals.get_legend().get_window_extent(renderer)
    for line in residuals.lines[:2]:
        assert not any(box.contains(*point) for point in residuals.transData.transform(line.get_xydata()))
    mtf = next(axes for axes in figure.axes if axes.get_title(loc="left") == "MTF")
    box = mtf.get_legend().get_window_extent(renderer)
    assert all(text.get_window_extent(renderer).y1 < box.y0 for text in mtf.texts)  # however long its labels are


def test_equal_curves_of_colours_are_all_visible():
    frequency = np.linspace(0, 1, 5)
    curve = SimpleNamespace(frequency=frequency, mtf=1 - frequency, mtf_std=0.01, camera_mtf=1 - frequency)
    axes = Figure().subplots()
    draw_calibration(axes, SimpleNamespace(channels=dict.fromkeys("RGB", SimpleNamespace(curve=curve))))
    curves, labels = axes.get_legend_handles_labels()
    assert labels == [*(f"{name}: edges, model-free" for name in "RGB"), "fitted camera"]
    widths = [line.get_linewidth() for line in curves]
    assert widths == sorted(set(widths), reverse=True)


@pytest.mark.parametrize("suffix", [".png", ".pdf", ".svg"])
def test_same_data_same_file(tmp_path, suffix):
    for name in ("a", "b"):
        save(loss_figure(paper.figure_5()), tmp_path / f"{name}{suffix}")
    assert (tmp_path / f"a{suffix}").read_bytes() == (tmp_path / f"b{suffix}").read_bytes()


def test_other_formats_are_refused(tmp_path):
    with pytest.raises(OutputError, match=r"must end in .png, .pdf, .svg"):
        save(loss_figure(paper.figure_5()), tmp_path / "a.bmp")
