"""Errors of the library in the words of the command line, and lists of names that are taken from registries."""

import math
import re
from typing import get_args, get_type_hints

import pytest
import typer
from typer.testing import CliRunner

from matcam import BoxPixel, DiffractionOptics
from matcam.calibration.chart.chart_layout import KINDS, PAGES
from matcam.cli import _run, chart, show, simulate
from matcam.cli.app import app
from matcam.cli.options import in_options
from matcam.core.errors import ArgumentError
from matcam.core.grid import SAMPLINGS
from matcam.rigs import CELL_VALUES

COMMANDS = typer.main.get_command(app).commands


@pytest.mark.parametrize(
    ("command", "message", "expected"),
    [
        ("edge", "output a_b.png exists: use force=True to replace it", "output a_b.png exists: use --force to replace it"),
        ("edge", "half_width must lie in (0, 0.5] px, got 0.7", "--half-width must lie in (0, 0.5] px, got 0.7"),
        ("edge", "roi must lie inside the image of 9 x 9 px, got 0", "--roi must lie inside the image of 9 x 9 px, got 0"),
        (
            "edge",
            "channel must not be 'R' for a grey image: omit the channel, or give cfa if the image is a mosaic",
            "--channel must not be 'R' for a grey image: omit the channel, or give --cfa if the image is a mosaic",
        ),
        ("edge", "wavelength must be given in m for the defocus model", "--wavelength must be given for the defocus model"),
        (
            "edge",
            "accept the MTF of lens and sharpening together (accept_sharpened=True)",
            "accept the MTF of lens and sharpening together (--accept-sharpened)",
        ),
        (
            "calibrate",
            "wavelength and pixel_pitch must be given in m for the defocus model",
            "--wavelength and --pitch must be given for the defocus model",
        ),
        ("calibrate", "f_numbers must be one value, or one for each", "--f-number must be one value, or one for each"),
        ("calibrate", "is accepted): give half_width, or", "is accepted): give --half-width, or"),
        ("calibrate", "half_width.tif: no such file", "half_width.tif: no such file"),
        ("chart", "give fewer kinds, or pixels_across above 300", "give fewer kinds, or --pixels above 300"),
        ("chart", "page must lie in [50, 5000] mm, got 1", "--size must lie in [50, 5000] mm, got 1"),
        ("fit", "camera='prior' needs a camera with an uncertainty (Camera(..., uncertainty=...))",
         "--lens prior needs a camera with an uncertainty (--camera: a profile with an uncertainty)"),
        ("predict", "exact=True applies to the real sample, for", "--exact applies to the real sample, for"),
        ("predict", "power can be given for epd and sgd, but not for ggx, got 1",
         "--power can be given for epd and sgd, but not for ggx, got 1"),
        ("limits", "noise.relative must lie in [0, 1), got 2", "--noise must lie in [0, 1), got 2"),
        ("simulate", "shape must be (height, width), got 3", "--size must be (height, width), got 3"),
        (
            "simulate",
            "exposure needs a camera with a sensor: Camera(optics, pixel, sensor=Sensor(...))",
            "--exposure needs a camera with a sensor: a profile with a sensor (--camera)",
        ),
        ("correct", "workers must be a whole number, got 0", "--workers must be a whole number, got 0"),
        ("correct", "instead of fit_camera=True, or give tables", "instead of --fit-camera, or give tables"),
        ("calibrate", "is known: give f_numbers", "is known: give --f-number"),
        ("inspect", "power must be given", "power must be given"),
    ],
)  # fmt: skip
def test_messages_speak_of_options(command, message, expected):
    assert in_options(message, COMMANDS[command]) == expected


def test_ranges_are_in_the_options_units():
    """As the library says them: rad and m; as the option takes them: degrees, nm, um."""
    with pytest.raises(ArgumentError) as caught:
        DiffractionOptics(8, 550.0, 5e-6)
    assert in_options(str(caught.value), COMMANDS["calibrate"]) == "--wavelength must lie in [1, 1e+06] nm, got 5.5e+11"
    done = CliRunner().invoke(app, ["predict", "--lamp", "80"])
    found = re.fullmatch(r"--lamp must lie in \[0, (.*)\] degrees, got 80", str(done.exception))
    assert 0 < float(found[1]) < 80
    behind = f"lamp_angle must lie in [0, {math.pi:g}) rad (beyond pi the lamp is behind the sample), got {4:g}"
    assert in_options(behind, COMMANDS["simulate"]) == (
        "--lamp-angle must lie in [0, 180) degrees (beyond 180 degrees the lamp is behind the sample), got 229.2"
    )


def test_remarks_speak_of_options(capsys, monkeypatch):
    """As errors do, whether a command prints them as notes, lines or remarks."""
    text = "rig and data contradict each other: check the rig, or use force_correction=True"

    def said(*_, **__):
        show.notes([text])
        show.say(text)
        show.remark(text)

    correct = COMMANDS["correct"]
    monkeypatch.setattr(correct, "callback", said)
    correct.invoke(typer.Context(correct))
    out, error = capsys.readouterr()
    assert (out + error).count("or use --force-correction") == 3
    show.say(text)
    assert capsys.readouterr().out == f"{text}\n"


def test_a_message_is_translated_once(capsys):
    """A second translation may change the words of the first."""
    with show.wording(lambda text: f"<{text}>"):
        show.notes(["a", "b"])
        show.say("c")
        show.remark("d")
    assert capsys.readouterr() == ("note: <a>\nnote: <b>\n<c>\n", "matcam: <d>\n")


def test_python_keeps_its_own_words():
    with pytest.raises(ArgumentError, match=r"^half_width must lie in"):
        BoxPixel(0.7)


def test_lists_are_the_librarys():
    """Lists that commands repeat, because a help text must not wait for the library to load."""
    choices = lambda command, name: get_args(get_type_hints(command)[name])  # noqa: E731
    assert get_args(choices(chart.command, "page")[0]) == tuple(PAGES)
    assert choices(simulate.command, "cell") == CELL_VALUES
    assert choices(simulate.command, "sampling") == SAMPLINGS
    assert all(kind in COMMANDS["chart"].params[0].help for kind in KINDS)


def test_the_halo_is_checked_by_its_own_options():
    for arguments, message in (
        (("--glare", "2"), "--glare must lie in [0, 1), got 2"),
        (("--glare", "0.01", "--glare-radius", "0"), "--glare-radius must lie in (0, inf) px, got 0"),
    ):
        assert str(CliRunner().invoke(app, ["predict", *arguments]).exception) == message


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("render", "a.binary"), "rendering needs optional packages: run python -m pip install 'matcam[render]'"),
        (
            ("correct", "a.binary", "-o", "run", "--zarr"),
            "a run's Zarr store needs optional packages: run python -m pip install 'matcam[scale]'",
        ),
        (
            ("correct", "a.binary", "-o", "run", "--cluster", "local:2"),
            "a cluster needs optional packages: run python -m pip install",
        ),
        (("convert", "a.binary", "b.zarr"), "Zarr needs optional packages: run python -m pip install 'matcam[scale]'"),
    ],
)
def test_an_extra_that_is_not_installed_is_named_before_any_work(words, message, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.binary").touch()
    monkeypatch.setattr("matcam.core.checks.find_spec", lambda module: None)
    assert _run(list(words)) == 2
    assert message in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["a.binary"]
