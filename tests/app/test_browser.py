"""The page in a real browser."""

import contextlib
import json
import re

import numpy as np
import pytest
from typer.testing import CliRunner

from matcam.cli.app import app as cli
from tests.app.browsing import BOXES, DRAG, EXACT, FOCUSED, PREPARED, READY, faults
from tests.app.conftest import running
from tests.app.test_calibrate import edge_picture

SIZES = ((1280, 800), (1920, 1080))


@contextlib.contextmanager
def opened(chromium, app, size=SIZES[0]):
    """A page of the app; afterwards nothing it asked for has left the machine."""
    page = chromium.new_page(viewport={"width": size[0], "height": size[1]})
    asked, errors = [], []
    page.on("request", lambda request: asked.append(request.url))
    page.on("websocket", lambda socket: asked.append(socket.url))
    page.on("pageerror", lambda error: errors.append(str(error)))
    try:
        page.goto(app.url)
        page.wait_for_function(READY)
        yield page
        own = re.compile(rf"(http|ws)://127\.0\.0\.1:{app.port}/|data:|blob:")
        assert asked
        assert [url for url in asked if not own.match(url)] == []
        assert errors == []
    finally:
        page.close()


def view(page, name):
    page.get_by_role("button", name=name, exact=True).click()
    model = {"Plan": "plan", "Calibrate": "calibrate-view", "Explore": "explore"}[name]
    page.wait_for_function(f"Bokeh.documents[0].get_model_by_name('{model}')?.visible", timeout=60_000)
    page.wait_for_timeout(400)


def message(page):
    return page.evaluate("Bokeh.documents[0].get_model_by_name('message').text")


def test_views_fit_and_nothing_leaves_the_machine(chromium, app):
    with opened(chromium, app) as page:
        assert page.url == f"http://127.0.0.1:{app.port}/"
        for size in SIZES:
            page.set_viewport_size({"width": size[0], "height": size[1]})
            for name in ("Plan", "Calibrate", "Explore"):
                view(page, name)
                page.wait_for_function(f"{BOXES}.length > 12", timeout=30_000)
                boxes = page.evaluate(BOXES)
                assert faults(boxes, size[0]) == [], (name, size)
        assert (
            faults([*boxes, ["x", boxes[0][1], boxes[0][2], 9999, boxes[0][4], 0]], size[0]) != []
        )  # the test can fail


@pytest.mark.slow
def test_the_last_value_of_a_fast_drag_wins(chromium, app):
    """160 moves in bursts of 8: few are computed, none is shown late, and the last one is what stays."""
    with opened(chromium, app) as page:
        page.wait_for_function(PREPARED, timeout=300_000)
        positions = np.linspace(np.log10(0.002), np.log10(0.2), 160).tolist()
        found = page.evaluate(DRAG, ["slider-roughness", positions, 8, 30])
        assert found["slider"] == positions[-1]
        assert found["shown"][-1] == found["value"] == 0.2
        assert found["answered"] > 100  # the number field follows every move that changes its three digits
        assert len(found["shown"]) < len(positions) / 2
        assert (np.diff(found["shown"][1:]) >= 0).all()  # the drag only rises: no earlier value follows a later one
        assert found["late"] <= 2  # behind the last move: what was being computed, and the last value
        # the same of a mouse that drags the handle
        handle = page.locator("[role=slider]").nth(6)
        handle.hover()
        box = handle.bounding_box()
        page.mouse.down()
        page.mouse.move(box["x"] - 100, box["y"] + 5, steps=60)
        page.mouse.up()
        page.wait_for_function(f"{FIELD} < 0.1 && {SHOWN} === {FIELD}", timeout=30_000)


SHOWN = "Number(Bokeh.documents[0].get_model_by_name('curve').data.chosen[0])"
FIELD = "Bokeh.documents[0].get_model_by_name('field-roughness').value"


@pytest.mark.slow
def test_the_keyboard_reaches_everything(chromium):
    with running() as app, opened(chromium, app) as page:
        for name, wanted in {
            "Plan": {
                "views",
                "slider-sigma",
                "field-sigma",
                "slider-theta_d",
                "field-theta_d",
                "preset-phone",
                "metal",
                "n",
                "k",
                "lobe",
                "shown",
            },
            "Calibrate": {"views", "upload-picture", "photograph", "picture", "measure", "calibrate", "region-x"}
            - {"photograph"},
            "Explore": {
                "views",
                "upload",
                "material",
                "beside",
                "which",
                "channel",
                "metal",
                "field-lamp",
                "save-csv",
                "save-pbrt",
            },
        }.items():
            view(page, name)
            page.evaluate("document.activeElement && document.activeElement.blur()")
            reached = set()
            for _ in range(60):
                page.keyboard.press("Tab")
                reached.add(page.evaluate(FOCUSED))
            assert wanted <= reached, (name, wanted - reached)
        view(page, "Plan")
        page.locator("[role=slider]").first.focus()
        before = page.evaluate("Bokeh.documents[0].get_model_by_name('field-sigma').value")
        page.keyboard.press("ArrowRight")
        page.wait_for_function(f"Bokeh.documents[0].get_model_by_name('field-sigma').value > {before}")


@pytest.mark.slow
def test_displayed_numbers_are_the_commands(chromium, app, tmp_path, monkeypatch):
    """A rig's table is `matcam predict --json`'s, by its command and its rig file; an edge is `matcam edge --json`'s."""
    monkeypatch.chdir(tmp_path)
    edge_picture(tmp_path / "edge.tif")
    with opened(chromium, app) as page:
        page.wait_for_function(PREPARED, timeout=300_000)
        for name, value in {"sigma": 0.7, "roughness": 0.013}.items():
            page.evaluate(f"Bokeh.documents[0].get_model_by_name('field-{name}').value = {value}")
        shown = "Bokeh.documents[0].get_model_by_name('plan-copy').text.includes(' 0.013')"
        page.wait_for_function(f"{EXACT} && {shown}", timeout=300_000)
        cells = re.findall("<td>(.*?)</td>", page.evaluate("Bokeh.documents[0].get_model_by_name('plan-numbers').text"))
        copied = page.evaluate("Bokeh.documents[0].get_model_by_name('plan-copy').text")
        for address, name in re.findall('href="(.*?)" download="(.*?)"', copied):
            (tmp_path / name).write_text(page.evaluate(f"fetch('{address}').then((answer) => answer.text())"))
        words = re.search("<code>matcam (.*?)</code>", copied)[1].split()
        by_command = said([*words, "--json"])
        assert cells == [
            text
            for alpha, response, angle in zip(
                by_command["roughness"], by_command["response"], by_command["loss_angle_deg"], strict=True
            )
            for text in (f"{alpha:g}", f"{response[0]:.1%}", f"{angle:.1f}°" if angle < 90 else "-")
        ]
        by_file = said(["predict", *map(str, by_command["roughness"]), "--rig", "rig.toml", "--json"])
        np.testing.assert_allclose(by_file["response"], by_command["response"], rtol=1e-12)
        view(page, "Calibrate")
        page.locator("input[type=file]:visible").first.set_input_files(str(tmp_path / "edge.tif"))
        page.wait_for_function(
            "Bokeh.documents[0].get_model_by_name('about').text.includes('edge.tif')", timeout=60_000
        )
        for name, value in {"x": 10, "y": 10, "width": 76, "height": 76}.items():
            page.evaluate(f"Bokeh.documents[0].get_model_by_name('region-{name}').value = {value}")
        page.get_by_role("button", name="measure the region's edge").click()
        page.wait_for_function("Bokeh.documents[0].get_model_by_name('result').text !== ''", timeout=300_000)
        text = page.evaluate("Bokeh.documents[0].get_model_by_name('result').text")
        edge = said(["edge", "edge.tif", "--roi", "10", "10", "76", "76", "--json"])
        assert f"MTF50 {edge['mtf50_cycles_per_px']:.4f} ± {edge['mtf50_std']:.4f} cycles/px" in text
        about = page.evaluate("Bokeh.documents[0].get_model_by_name('about').text")
        assert "tone curve: auto" in about


def said(words):
    """What a command prints."""
    result = CliRunner().invoke(cli, words)
    assert result.exit_code == 0, result.output
    return json.loads(result.stdout)


def bombs():
    """Names, bytes, of files that are none, are damaged, or claim too much."""
    import imagecodecs

    large = imagecodecs.png_encode(np.zeros((10_000, 20_000), np.uint8), level=1)
    claims = bytearray(imagecodecs.png_encode(np.zeros((4, 4), np.uint8)))
    claims[16:24] = (60_000).to_bytes(4, "big") * 2
    yield "Explore", "rubbish.binary", b"no table at all" * 50
    yield "Explore", "head.binary", np.array([90, 90, 180], "<i4").tobytes() + b"\0" * 100
    yield "Explore", "rubbish.nc", b"\x89HDF\r\n\x1a\n" + b"\xff" * 500
    yield "Explore", "empty.bsdf", b"tensor_file\0" + b"\xff" * 90
    yield "Calibrate", "large.png", large
    yield "Calibrate", "claims.png", bytes(claims)
    yield "Calibrate", "rubbish.tif", b"II*\0" + b"\xff" * 400
    yield "Calibrate", "<b>x</b>.exr", b"v/1\x01" + b"\xff" * 400


@pytest.mark.slow
def test_a_rejected_file_leaves_the_selection_as_it_was(chromium, tmp_path):
    """A picture is no table: what was selected and drawn stays, and the error is shown."""
    import imagecodecs

    from matcam import GGX, Microfacet, write_merl
    from matcam.forward import true_table

    write_merl(tmp_path / "good.binary", true_table(Microfacet(GGX(0.1), 0.9)))
    picture = imagecodecs.png_encode(np.zeros((8, 8), np.uint8))
    chosen = (
        "(() => { const s = Bokeh.documents[0].get_model_by_name('material'); return [s.value, s.options.length] })()"
    )
    drawn = "Bokeh.documents[0].get_model_by_name('slice').data.theta_h.length"
    with running(tmp_path / "good.binary") as app, opened(chromium, app) as page:
        page.wait_for_function(f"{drawn} > 10", timeout=120_000)
        before = page.evaluate(chosen)
        field = page.locator("input[type=file]:visible").first
        field.set_input_files({"name": "photo.png", "mimeType": "image/png", "buffer": picture})
        page.wait_for_function("Bokeh.documents[0].get_model_by_name('message').text !== ''", timeout=120_000)
        assert "photo.png" in message(page)
        page.wait_for_function("Bokeh.documents[0].get_model_by_name('explore-status').text === ''", timeout=30_000)
        assert page.evaluate(chosen) == before
        assert page.evaluate(drawn) > 10


@pytest.mark.slow
def test_bad_files_are_one_line_and_the_server_lives(chromium):
    with running() as app:
        with opened(chromium, app) as page:
            for name, file, content in bombs():
                view(page, name)
                field = page.locator("input[type=file]:visible").first
                page.evaluate("Bokeh.documents[0].get_model_by_name('message').text = ''")
                field.set_input_files({"name": file, "mimeType": "application/octet-stream", "buffer": content})
                page.wait_for_function("Bokeh.documents[0].get_model_by_name('message').text !== ''", timeout=120_000)
                said = message(page)
                assert "fault of matcam" not in said, (file, said)
                assert file.split(".")[0] in said or "<" in file, (file, said)
                assert "\n" not in said
                assert "<b>" not in said
        with opened(chromium, app) as page:
            assert message(page) == ""
            page.reload()
            page.wait_for_function(READY)
        assert app.end() == 130
        assert "".join(app.errors) == "matcam: interrupted; no incomplete file was left\n"
