"""What the plan view says is what the command line says."""

import json
from dataclasses import replace

import pytest
from typer.testing import CliRunner

from matcam.app.plan_settings import OTHERS, PRESETS, SETTINGS, Planned
from matcam.cli.app import app

DEFAULTS = Planned(0.5, 0.5, 256.0, float("inf"), float("inf"), 0.0, 0.01, 0.0, 45.0)


@pytest.mark.slow
def test_the_rig_file_says_the_same(tmp_path):
    planned = replace(DEFAULTS, glare=0.01, distance=30.0, lamp_distance=25.0, lamp_radius=0.2, sigma=0.7)
    (tmp_path / "camera.json").write_text(planned.camera_profile())
    (tmp_path / "rig.toml").write_text(planned.rig_file())
    result = CliRunner().invoke(app, ["predict", "0.01", "--rig", str(tmp_path / "rig.toml"), "--json"])
    assert result.exit_code == 0, result.output
    said = said_by_the_command(planned, tmp_path)
    row = said["roughness"].index(0.01)
    assert json.loads(result.stdout)["response"][0] == pytest.approx(said["response"][row], rel=1e-12)


def said_by_the_command(planned, folder):
    (folder / "camera.json").write_text(planned.camera_profile())
    words = planned.command().replace("camera.json", str(folder / "camera.json")).split()
    assert words[0] == "matcam"
    result = CliRunner().invoke(app, [*words[1:], "--json"])
    assert result.exit_code == 0, result.output
    return json.loads(result.stdout)


@pytest.mark.parametrize(
    "planned",
    [
        replace(DEFAULTS, lamp_radius=0.3, distance=40.0, sigma=0.7),
        replace(DEFAULTS, lamp_distance=20.0, half_width=0.4),
    ],
)
def test_the_command_line_says_the_same(planned, tmp_path):
    import numpy as np

    from matcam.forward.prediction import predicted

    said = said_by_the_command(planned, tmp_path)
    shown = predicted(planned.rig(), planned.lobes())
    assert said["roughness"] == sorted([0.01, *OTHERS])
    np.testing.assert_allclose(np.degrees(shown.loss_angle), said["loss_angle_deg"], rtol=1e-12)
    np.testing.assert_allclose(shown.response, said["response"], rtol=1e-12)


def test_the_python_says_the_same(tmp_path):
    import math

    planned = replace(DEFAULTS, glare=0.01, distance=30.0, lamp_distance=25.0, lamp_radius=0.2)
    names = {}
    exec(planned.python(), names)
    assert repr(names["rig"]) == repr(planned.rig())
    assert 0 < names["angle"] < math.pi / 2


def test_presets_lie_in_the_sliders():
    by_name = {one.name: one for one in SETTINGS}
    for preset in PRESETS.values():
        assert {"sigma", "half_width", "radius"} <= set(preset) <= set(by_name)
        assert all(by_name[name].low <= value <= by_name[name].high for name, value in preset.items())


def test_a_slider_shows_what_it_sets():
    for one in SETTINGS:
        assert one.from_slider(one.to_slider(one.value)) == pytest.approx(min(one.value, one.high), rel=5e-3)
        assert one.low <= one.from_slider(one.to_slider(one.high) + 1) <= one.high


def test_a_number_at_a_limit_says_so():
    """The browser replaces a number beyond a limit by the limit."""
    from matcam.app.controls import NumberControl, Setting

    control = NumberControl(Setting("sigma", "blur [px]", 0.1, 3.0, 0.5), lambda: None, lambda: None)
    for value, words in ((3.0, "blur [px]: largest value"), (1.0, "blur [px]"), (0.1, "blur [px]: smallest value")):
        control.field.value = value
        assert control.label.text == words


def test_roughnesses_are_drawn_from_the_smoothest_on():
    assert replace(DEFAULTS, roughness=0.01).roughnesses == [0.001, 0.005, 0.01, 0.02, 0.1]
    assert replace(DEFAULTS, roughness=0.005).roughnesses == [0.001, 0.005, 0.02, 0.1]


def test_an_infinite_distance_is_a_box_to_tick():
    """No number stands for infinity: 999 radii are 999 radii."""
    from matcam.app.controls import NumberControl

    changes = []
    setting = next(one for one in SETTINGS if one.name == "distance")
    control = NumberControl(setting, lambda: changes.append(control.value), lambda: None)
    assert (control.value, control.infinite.label) == (float("inf"), "infinite")
    assert "999" not in control.label.text
    control.field.value = 28
    assert (control.value, control.infinite.active) == (28, False)
    control.infinite.active = True
    assert (control.value, control.field.value, control.field.placeholder) == (float("inf"), None, "infinite")
    control.infinite.active = False
    control.field.value = 999
    assert control.value == 999
    assert changes == [28, float("inf"), 28, 999]
    control.set(float("inf"))
    assert control.value == float("inf")
    assert len(changes) == 4


def test_a_plot_without_data_is_no_black_box():
    from bokeh.models import ColumnDataSource

    from matcam.app.plots import WAITING, PictureColours, PictureFigure, no_pictures

    picture = PictureFigure("a", 100, ColumnDataSource(no_pictures("a")), "a", PictureColours())
    assert picture.plot.background_fill_color == WAITING
    assert [one.visible for one in picture.plot.renderers] == [False]
    picture.arrived()
    assert picture.plot.background_fill_color == "#000000"
    assert [one.visible for one in picture.plot.renderers] == [True]


def test_cos_bounds_the_loss_of_a_point_lamp_only():
    assert DEFAULTS.loses_at_most_cos
    assert not replace(DEFAULTS, lamp_radius=0.1).loses_at_most_cos
    assert not replace(DEFAULTS, distance=20.0).loses_at_most_cos


def test_a_metal_shows_its_indices_and_typed_ones_are_custom():
    from matcam.app.controls import CUSTOM, ConductorControl
    from matcam.app.plan_settings import green_indices
    from matcam.core.grid import CHANNEL_WAVELENGTHS
    from matcam.material.optical_constants import metal

    changes = []
    control = ConductorControl("metal", lambda: changes.append(control.n_and_k), green_indices)
    control.offer(["Cr", "Au"])
    assert (control.name.options, control.n_and_k, changes) == (["Cr", "Au", CUSTOM], None, [])
    control.name.value = "Au"
    n, k, _ = metal("Au", [CHANNEL_WAVELENGTHS[1]])
    assert [field.value for field in control.numbers] == [pytest.approx(v[0], rel=1e-3) for v in (n, k)]
    control.numbers[0].value = 1.5
    assert (control.name.value, control.n_and_k[0], len(changes)) == (CUSTOM, 1.5, 2)
    assert DEFAULTS.material().fresnel.n == metal("Cr", [CHANNEL_WAVELENGTHS[1]])[0]
    material = replace(DEFAULTS, metal=CUSTOM, n_and_k=(1.5, 0.0)).material()
    assert (float(material.fresnel.n[0]), float(material.fresnel.k[0])) == (1.5, 0.0)


def test_commands_of_the_previous_rig_are_not_shown():
    from bokeh.document import Document

    from matcam.app.plan import PlanView
    from matcam.app.transfers import Downloads

    document = Document()
    view = PlanView(document, Downloads(), print)
    document.add_root(view.layout)
    copies = document.get_model_by_name("plan-copy")
    copies.text = "matcam predict 0.01 --radius 256"
    document.get_model_by_name("field-radius").value = 400
    assert copies.text == ""
    assert view.planned.radius == 400
    view.close()
