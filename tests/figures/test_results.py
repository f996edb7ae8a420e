"""Results for people: `summary()`, HTML in a notebook, a short `repr`, `plot()`, and labels of every Dataset."""

import html.parser
import re
from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

import matcam
from matcam.camera import Uncertainty
from matcam.core.errors import ArgumentError
from matcam.core.remark import Remark
from matcam.core.results.labelled import named
from matcam.core.results.summary import Quantity, Summary, correlations, with_std
from matcam.figures.curves import RAW_LABEL, fresnel_figure
from matcam.figures.pages import reflectance_figure
from matcam.inverse import Correction
from matcam.reconstruction import FlatReconstruction, Reconstruction
from tests.oracle import slanted_edge

RIG = matcam.rigs.merl()
EXACT = matcam.Rig(
    matcam.Camera(RIG.camera.optics, RIG.camera.pixel, uncertainty=Uncertainty.of({"optics.sigma_px": 0.0})), RIG.sample
)  # its rules are those of other tests
TABLE = matcam.io.example_table()
F = np.linspace(0.05, 0.5, 10)
STAR = matcam.targets.MTFSamples(
    "star", (9.0, 9.0), F, np.zeros(10), np.exp(-2 * (np.pi * 0.6 * F) ** 2) * np.sinc(F), 1e-6 * np.eye(10)
)


@pytest.fixture(scope="module")
def sensor(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sensor")
    camera = matcam.Sensor(5e-6, full_well=2000, read_noise=5.0, gain=0.5, bits=12)
    for seed in range(32):
        time, kind = 1 + seed // 4, "dark" if seed % 2 else "flat"
        light = np.full((64, 64), 100.0 * time if kind == "flat" else 0.0)
        matcam.io.write_float_tiff(folder / f"{kind}_{time}ms_{seed}.tif", camera.expose(light, 1.0, seed))
    return matcam.characterise_sensor(folder, bits=12)


@pytest.fixture(scope="module")
def results(sensor):
    table = TABLE.copy()
    for name in ("theta_h", "theta_d", "phi_d"):
        table[name].attrs = {"units": "rad"}
    before = table.copy(deep=True)
    done = Correction.of(table, EXACT, "ggx")
    calibration = matcam.calibrate([], samples=[STAR])
    return {
        "camera": RIG.camera,
        "edge": matcam.edge_mtf(slanted_edge.photographs(slanted_edge.gaussian(0.5), 100, 1, 3)[0]),
        "fit": matcam.fit(table, RIG, "ggx", slice_step=18),
        "correction": done,
        "calibration": calibration,
        "camera fit": calibration.channels["grey"],
        "sensor": sensor,
        "Fresnel term": matcam.fresnel(table, EXACT, "ggx", slice_step=6).matcam,
        "corrected table": done.table.matcam,
        "bounds": matcam.limits(RIG, roughness=[0.005, 0.05], slice_step=30).matcam,
        "prediction": matcam.predict(RIG, [matcam.GGX(0.005), matcam.GGX(0.02)]).matcam,
        "table that was given, and as it was": (table, before),
    }


NAMES = (
    "camera", "edge", "fit", "correction", "calibration", "camera fit", "sensor", "Fresnel term", "corrected table", "bounds",
    "prediction",
)  # fmt: skip
HAS = {
    "camera": ["optics.sigma_px: *0.50 ± 0.50 .100 %.", "MTF50 along the rows: 0.323088 cycles/px"],
    "edge": [r"MTF50: *0\.\d+ ± 0\.\d+ cycles/px", "optics.sigma_px"],
    "fit": [
        r"ggx lobe, fitted through the camera",
        r"alpha: +0\.0\d+ ± ",
        r"\[\[Correlations\]\]\n +C\(",
        "ln likelihood: ",
    ],
    "correction": ["Corrected table of simulated polished chromium", "theta_d = 75°: "],
    "calibration": [r"Channel grey", r"optics.sigma_px: 0\.60\d* ± "],
    "camera fit": [r"chi2: ", r"optics.sigma_px: 0\.60\d* ± "],
    "sensor": [r"gain, DN per e-: +0\.\d+ ± 0\.\d+ \(", "PRNU"],
    "Fresnel term": ["F is known to 5 % up to R", r"theta_d = 75.5°: \d\.\d+ ± "],
    "corrected table": ["theta_d = 44.5°: "],
    "bounds": [r"ggx, roughness 0.005: 0\.\d+", "lens free"],
    "prediction": [r"roughness 0.02: +57\.1°"],
}


class Balanced(html.parser.HTMLParser):
    """Fails where a tag is not closed in its order."""

    def __init__(self):
        super().__init__()
        self.open, self.texts = [], []

    def handle_starttag(self, tag, attrs):
        del attrs
        self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.texts.append(data)


@pytest.mark.parametrize("name", NAMES)
def test_a_summary_lists_values_with_their_uncertainty(results, name):
    text = results[name].summary()
    for pattern in HAS[name]:
        assert re.search(pattern, text), f"{pattern}\n{text}"
    assert text.startswith("[[")
    assert not re.search(r"\barray\(|nan\b|f64\[", text)


@pytest.mark.parametrize("name", NAMES)
def test_a_notebook_shows_what_the_summary_says(results, name):
    page = Balanced()
    page.feed(results[name]._repr_html_())
    assert page.open == []
    text = results[name].summary()
    for shown in page.texts:
        assert "".join(shown.split())[:40] in "".join(text.split())


@pytest.mark.parametrize("name", NAMES)
def test_a_repr_is_one_line_without_arrays(results, name):
    text = repr(results[name])
    assert len(text) < 200
    assert not re.search(r"\n|array\(|\[\[", text)


@pytest.mark.parametrize("name", NAMES)
def test_a_plot_has_labels_with_units_and_is_drawn_on_given_axes(results, name):
    axes = Figure().subplots()
    assert results[name].plot(axes) is axes
    assert axes.lines or axes.collections
    for label in (axes.get_xlabel(), axes.get_ylabel()):
        assert re.search(r"\[\S+\]$", label), label
    new = results[name].plot()
    assert new.figure is not axes.figure
    assert len(new.lines) == len(axes.lines)


def test_the_legend_of_a_fresnel_term_lies_on_no_curve(results):
    for figure in (Figure(figsize=(7.5, 4.4)), Figure(figsize=(7.5, 4.4), layout="constrained")):
        axes = results["Fresnel term"].plot(figure.subplots(), metal="Cr")
        FigureCanvasAgg(figure).draw()
        box = axes.get_legend().get_window_extent()
        assert figure.bbox.contains(box.x0, box.y0)
        for line in axes.lines:
            assert not any(box.contains(*point) for point in axes.transData.transform(line.get_xydata()))


@pytest.fixture(autouse=True)
def _no_open_figures():
    yield
    from matplotlib import pyplot

    pyplot.close("all")


def test_options_of_plots(results):
    axes = results["correction"].plot(Figure().subplots(), theta_d=np.radians(75), channel=0)
    assert "75.5°, channel R" in axes.get_title(loc="left") or "74.5°, channel R" in axes.get_title(loc="left")
    some = results["fit"].plot(Figure().subplots(), channel=1)
    assert [line.get_label() for line in some.lines] == ["G"]
    with_tables = results["Fresnel term"].plot(Figure().subplots(), metal="Cr")
    assert sum(line.get_label().startswith("Cr (") for line in with_tables.lines) == 3
    for call, words in (
        (lambda: results["fit"].plot(chanel=1), "unknown option of .* 'chanel'; did you mean 'channel'"),
        (lambda: results["fit"].plot(channel=3), r"channel must be a whole number in \[0, 2\]"),
        (lambda: results["camera"].plot(3), "ax must be an Axes"),
        (lambda: results["correction"].plot(theta_d=75), r"if 75 is in degrees, give np.radians\(75\)"),
        (lambda: xr.Dataset({"a": 1.0}).matcam.summary(), "a result of fresnel, correct, limits or predict"),
        (lambda: results["edge"].parametric.plot(), "has no figure of one panel"),
    ):
        with pytest.raises(ArgumentError, match=words):
            call()


def test_a_loss_is_that_of_the_lobe_where_the_peak_is_missing(results):
    """The example lacks most peaks; what the rig takes of a GGX lobe of 0.004 is known."""
    angles = np.radians([45.0, 75.0])
    expected = 1 - np.asarray(matcam.peak_response(RIG, matcam.GGX(0.004), angles))
    np.testing.assert_allclose(results["correction"].peak_loss(angles), expected, atol=0.01)
    assert f"{expected[0]:.0%} at 45°" in results["correction"].verdict


def test_the_drawn_curve_is_the_result(results):
    """The camera's curve against the Gaussian and the sinc that it consists of."""
    lines = {line.get_label(): line for line in results["camera"].plot(Figure().subplots()).lines}
    f, mtf = lines["lens and pixel, along the rows"].get_data()
    np.testing.assert_allclose(mtf, np.exp(-2 * (np.pi * 0.5 * f) ** 2) * np.sinc(f), atol=1e-12)


def test_a_result_from_a_file_has_its_summary(results, tmp_path):
    data = results["bounds"]._data
    matcam.write(tmp_path / "a.nc", data)
    assert matcam.read(tmp_path / "a.nc").matcam.summary() == results["bounds"].summary()


def test_reconstructions(results):
    """Of results whose fits take minutes, only what the summary reads is there."""
    fit = SimpleNamespace(names=("a", "b"))
    made = object.__new__(Reconstruction)
    for name, value in {"sample": "sphere", "fit": fit, "remarks": (Remark("few", "Few pictures."),)}.items():
        object.__setattr__(made, name, value)
    kind = type("Made", (Reconstruction,), {
        "verdict": "It is known.", "parameters": {"alpha": (0.02, 0.001)}, "lengths": {
            "outline_radius_px": (80.0, 0.1), "lamp_distance_radii": (40.0, 0.5), "camera_distance_radii": (12402.7, 130000.0),
            "lamp_distance_mm": (np.inf, np.inf),
        },
        "least_distances": {"lamp_distance_radii": 39.02, "camera_distance_radii": 564.8, "lamp_distance_mm": 812.3},
    })  # fmt: skip
    object.__setattr__(made, "__class__", kind)
    assert made.summary().splitlines() == [
        "[[Material of a sphere, reconstructed from 2 photographs]]",
        "    It is known.",
        "[[Parameters]]",
        "    alpha: 0.0200 ± 0.0010 (5 %)",
        "[[Outline and distances]]",
        "    outline_radius_px:     80.00 ± 0.10 (0.12 %)",
        "    lamp_distance_radii:   40.00 ± 0.50 (1.2 %)",
        "    camera_distance_radii: at least 565",
        "    lamp_distance_mm:      at least 812",
        "[[Remarks]]",
        "    - Few pictures.",
    ]
    maps = named(xr.Dataset({"diffuse": (("y", "x"), np.eye(4))}, {"x": np.arange(4.0), "y": -np.arange(4.0)}))
    flat = FlatReconstruction(
        maps, {"alpha": (0.2, 0.01)}, {"diffuse": (0.3, 0.2), "specular": (0.1, 0.1)}, None, "ggx", ("a",), np.ones((1, 2)),
        1.0, (), (), (),
    )  # fmt: skip
    assert "diffuse, across the rows:  0.2 cycles/px" in flat.summary()
    axes = flat.plot(Figure().subplots())
    assert axes.images[0].get_extent() == [-0.5, 3.5, -3.5, 0.5]


@pytest.mark.parametrize(
    ("value", "std", "text"),
    [
        (0.0051234, 0.000012, "0.005123 ± 0.000012"),
        (12345.678, 12.3, "12346 ± 12"),
        (-1.5, 0.25, "-1.50 ± 0.25"),
        (6.54321e-7, 1e-9, "(6.543 ± 0.010)e-07"),
        (2.5e8, 3e6, "(2.500 ± 0.030)e+08"),
        (0.0, 0.02, "0.000 ± 0.020"),
        (0.001, 5.0, "0.0 ± 5.0"),
    ],
)
def test_digits_follow_the_standard_deviation(value, std, text):
    assert with_std(value, std) == text


def test_texts_of_a_summary():
    summary = Summary(
        "A & B",
        "Word " * 30,
        {"Values": [Quantity("a", 1.0, np.inf, "px"), Quantity("b", 2.0, 0.0), Quantity("c", "<text>")], "None": []},
        (Remark("x", "long " * 30),),
    )
    lines = summary.text.splitlines()
    assert max(map(len, lines)) <= 100
    assert "    a: 1 px (not determined)" in lines
    assert "    b: 2 (exact)" in lines
    assert "[[None]]" not in lines
    assert "&lt;text&gt;" in summary.html
    assert "A &amp; B" in summary.html
    many = Summary("T", sections={"S": [Quantity(str(i), i) for i in range(20)]})
    assert many.text.splitlines()[-1] == "    and 8 more"
    assert "and 8 more" in many.html


def test_correlations_against_numpy():
    samples = np.random.default_rng(1).normal(size=(3, 500))
    samples[1] += 0.8 * samples[0]
    found = correlations("abc", np.cov(samples))
    assert [one.name for one in found] == ["C(a, b)"]
    assert float(found[0].value) == pytest.approx(np.corrcoef(samples)[0, 1], abs=5e-4)


# --------------------------------------------------------------------------------------------------------------- labels


def unlabelled(data):
    """Names of numeric variables and coordinates without a unit or a name in words."""
    variables = data.variables if isinstance(data, xr.Dataset) else {"itself": data, **data.coords}
    mixed = {"budget_value", "budget_uncertainty"}  # each source has a unit of its own
    return [
        name
        for name, one in variables.items()
        if one.dtype.kind in "biuf" and not {"long_name", *(() if name in mixed else ("units",))} <= set(one.attrs)
    ]


def test_every_result_is_labelled(results):
    material = matcam.Microfacet(matcam.GGX(0.1), 0.9)
    image = matcam.picture(material, RIG, 1.0, shape=(3, 5))
    made = {
        "table": TABLE,
        "fresnel": results["Fresnel term"]._data,
        "tabulated": matcam.inverse.tabulated_fresnel(results["Fresnel term"]._data, "Cr"),
        "correct": results["corrected table"]._data,
        "limits": results["bounds"]._data,
        "predict": results["prediction"]._data,
        "curves": results["fit"].curves,
        "residual": results["fit"].residual,
        "edge": results["edge"].dataset(),
        "edges": results["calibration"].edges_dataset(),
        "picture": image,
        "highlight": matcam.forward.highlight_preview(matcam.Microfacet(matcam.GGX(0.1), 0.9), RIG, 0.5),
        "figure 3": matcam.paper.figure_3_4(1.0),
        "figure 5": matcam.paper.figure_5(),
    }
    assert {name: unlabelled(data) for name, data in made.items() if unlabelled(data)} == {}
    assert image["x"].attrs == {"long_name": "position on the sample, to the right [px]"[:-5], "units": "px"}


def test_labels_leave_the_callers_table_alone(results):
    table, before = results["table that was given, and as it was"]
    assert results["Fresnel term"]._data["theta_d"].attrs["long_name"] == "difference angle"
    assert results["corrected table"]._data["phi_d"].attrs["long_name"] == "azimuth of the light about the half vector"
    assert table.identical(before)


def test_the_raw_curve_of_a_page_is_that_of_fresnel(results):
    """Same data, same quantity, same label."""
    term = results["Fresnel term"]._data
    middle = term.sizes["channel"] // 2
    pages, figures = (axes.get_legend_handles_labels() for axes in (
        reflectance_figure(TABLE, results["correction"]).axes[0], fresnel_figure(term).axes[0]
    ))  # fmt: skip
    raw = {label: handle for handle, label in zip(*pages, strict=True)}[RAW_LABEL]
    assert RAW_LABEL in figures[1]
    at = term["theta_d"].values < np.radians(80)
    shown = np.interp(np.degrees(term["theta_d"].values), raw.get_xdata(), raw.get_ydata())
    np.testing.assert_allclose(shown[at], term["raw"].values[at, middle], rtol=0.02)
