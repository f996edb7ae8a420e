"""What a new user types: every command of README, tutorials and how-to pages, and what each says comes "next".

Each command line is run in an empty folder that holds only the files that it names. It must end with code 0 (or one of
`CODES`), and every file that it was given as an output, or says it has written, must be there. Then the command that it prints
after "next:" is run in the same folder, and the one that this prints.

To add a check of what a command writes, decorate a function with `checks("correct")`: it gets the `Ran` of every run of that
command. To add a page, add it to `PAGES`. A new file name in a page needs an entry in `MADE`, which makes it.
"""

import json
import re
import shlex
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import tifffile
from scipy.special import ndtr

import matcam
from docs_commands import commands
from matcam.cli import _run
from matcam.exchange.contents import read_recorded_table
from matcam.forward.measurement import simulated_chromium
from tests.files.test_open_photograph import write_dng
from tests.oracle import slanted_squares
from tests.oracle.chart_camera import ChartCamera
from tests.oracle.merl_lobe import THETA_D, conductor

ROOT = Path(__file__).parents[1]
PAGES = [
    ROOT / "README.md",
    *sorted((ROOT / "examples" / "tutorials").glob("*.py")),
    *sorted((ROOT / "docs" / "start").glob("*.md")),
    *sorted((ROOT / "docs" / "howto").glob("*.md")),
]
COMMANDS = commands()
QUICK = {"predict", "chart", "inspect", "edge"}
"""Commands that take seconds; the others are run by the slow tests."""
OUTPUTS = ("-o", "--output", "--map", "--capture", "--budget")
"""Options whose value is an output."""
NOT_RUN = {
    "data": "it downloads from the network",
    "app": "it serves until it is ended",
    "--cluster": "it needs a scheduler",
    "diffuser.bsdf": "it reads a file of Zemax (tests/files/test_neighbours.py)",
    "carpet.bin": "it reads a file of UTIA (tests/files/test_neighbours.py)",
    "exposures": "it reads exposures of a camera (tests/cli/test_sensor_command.py)",
}
"""Words of command lines that are not run, and why. That the command line reads them is tested in tests/docs."""
CODES = {"capture check": (0, 1)}
"""Exit codes of commands that do not mean failure: 1 where the check has found something to mend."""
LEVELS = 2
"""How often "next:" is followed."""


# What the pages name, made small ----------------------------------------------------------------------------------------


def _table(path):
    """The table of `matcam demo`: chromium with a Gaussian lobe of 0.002 rad, recorded through a lens of 0.5 px, 1 % noise."""
    matcam.write_merl(path, simulated_chromium().clip(min=0))


def _ideal(path):
    """What a perfect camera records of chromium of alpha 0.02, without noise."""
    chromium = matcam.Conductor(*matcam.metal("Cr", [610e-9, 550e-9, 465e-9])[:2])
    matcam.write_merl(path, matcam.forward.true_table(matcam.Microfacet(matcam.GGX(0.02), chromium)))


def _tables(path):
    path.mkdir()
    matcam.write_merl(path / "chromium.binary", matcam.io.example_table().clip(min=0))


def _chart(path):
    matcam.targets.write_chart(path, matcam.targets.design_chart(("squares", "star"), pixels_across=700))


def _photographs(path):
    """One photograph of the chart whose description lies beside the folder; without one, of slanted squares."""
    path.mkdir()
    if not (path.parent / "chart.json").exists():
        _chart(path.parent / "chart.json")
    chart = json.loads((path.parent / "chart.json").read_text())
    shot = ChartCamera(page=tuple(chart["page_mm"]), width=800, height=570, sigma=0.5, fill=1.0)
    picture = shot.photograph(shot.expected(chart), 60, 1)
    matcam.io.write_float_tiff(path / "one.tif", picture.astype(np.float32))


def _raw(path):
    """Two camera raw files of slanted squares, of another blur in each colour."""
    path.mkdir()
    planes = [slanted_squares.field((420, 440), 140, 74, 5, s, dark=0.25)[0] for s in (0.6, 0.45, 0.7)]
    for number in range(2):
        taken = 512 + 4 * np.random.default_rng(number).poisson(slanted_squares.mosaic(planes, "GBRG") * 3600)
        write_dng(path / f"{number}.dng", taken.astype(np.uint16), "GBRG", white=65535)


def _edge():
    """A vertical edge, turned by 5 degrees about (160, 160), in electrons."""
    row, column = np.mgrid[:320, :320]
    across = (column - 160) * np.cos(np.radians(5)) + (row - 160) * np.sin(np.radians(5))
    return np.random.default_rng(3).poisson(3000 * (0.2 + 0.6 * ndtr(across / 0.6)))


def _samples(path):
    """Three readings of a white sample in BiRD's format."""
    text = path.with_suffix(".txt.csv")
    text.write_text("theta_h_deg,theta_d_deg,phi_d_deg,Y_per_sr\n0,30,90,0.31\n5,30,90,0.3\n10,30,90,0.3\n")
    matcam.io.write_bird(path, matcam.io.read_samples(text))


def _capture(path):
    said = "simulate --radius 64 --roughness 0.03 --lamp-positions 6 --capture"
    assert _run([*said.split(), str(path), "--quiet"]) == 0


MADE: dict[str, Callable[[Path], object]] = {
    "chrome.binary": _table,
    "chrome-corrected.binary": _ideal,
    "chrome.bsdf": lambda path: matcam.convert(path.parent / "chrome-corrected.binary", path, square=32),
    "camera.json": lambda path: matcam.rigs.merl().camera.save(path),
    "brdfs": _tables,
    "chart.json": _chart,
    "photographs": _photographs,
    "PHOTOGRAPHS": _photographs,
    "raw": _raw,
    "edge.dng": lambda path: write_dng(path, (512 + 4 * _edge()).astype(np.uint16)),
    "mosaic.tif": lambda path: tifffile.imwrite(path, (512 + 4 * _edge()).astype(np.uint16)),
    "paper.bsdf": lambda path: matcam.convert(path.parent / "chrome-corrected.binary", path, square=32),
    "spectralon.brdf": _samples,
    "shots": _capture,
    "sphere": _capture,
}
MADE_QUICKLY: dict[str, Callable[[Path], object]] = {"chrome.binary": _ideal}
"""What quick tests take instead: a record takes 15 s to simulate."""
NEEDS = {
    "paper.bsdf": ["chrome-corrected.binary"],
    "chrome.bsdf": ["chrome-corrected.binary"],
    "photographs": ["chart.json"],
    "PHOTOGRAPHS": ["chart.json"],
}
"""Files that must lie beside another before it is made."""


# Command lines ----------------------------------------------------------------------------------------------------------


def command_lines(page):
    """Commands of matcam in the `sh` blocks of a page, or of a tutorial's comments, without comments of the shell."""
    text = page.read_text(encoding="utf-8")
    if page.suffix == ".py":
        text = re.sub(r"(?m)^# ?", "", text)
        blocks = re.findall(r"(?m)^\.\. code-block:: sh\n\n((?:   .*\n?)+)", text)
    else:
        blocks = re.findall(r"(?ms)^[ ]*```sh\n(.*?)^[ ]*```", text)
    for line in "\n".join(blocks).splitlines():
        words = shlex.split(line, comments=True)
        if words and Path(words[0]).name == "matcam":
            yield tuple(words[1:])


LINES = sorted({words for page in PAGES for words in command_lines(page)})
RUN = [words for words in LINES if not set(words) & set(NOT_RUN)]


def outputs_of(words):
    """Files and folders that a command line names as its outputs."""
    named = [words[index + 1] for index, word in enumerate(words[:-1]) if word in OUTPUTS]
    made = {"convert": words[2:3], "capture": words[2:3] if words[1:2] == ("init",) else ()}
    return [*named, *made.get(words[0], ())]


def name_of(words):
    """Name of a command line's command, of one word or two."""
    return next(name for name in (" ".join(words[:2]), words[0]) if name in COMMANDS)


def marked(words):
    quick = name_of(words) in QUICK and "chrome.bsdf" not in words  # which must be resampled first
    return pytest.param(words, id=" ".join(words)[:60], marks=() if quick else pytest.mark.slow)


@dataclass(frozen=True)
class Ran:
    """A command that was run: its words, the folder, what it printed, and the outputs that it names."""

    words: tuple[str, ...]
    folder: Path
    printed: str
    outputs: tuple[Path, ...]

    @property
    def next(self):
        """The words of the command that it prints after "next:"; None where there is none."""
        found = re.search(r"(?m)^next: matcam (.*)$", self.printed)
        return tuple(shlex.split(found[1])) if found else None


CHECKS: dict[str, list[Callable[[Ran], None]]] = {}


def checks(name):
    """Decorate a function that checks each run of a command."""

    def register(check):
        CHECKS.setdefault(name, []).append(check)
        return check

    return register


@checks("predict")
@checks("calibrate")
def has_a_picture(ran):
    """The figure is a picture, with something on it."""
    for path in ran.outputs:
        if path.suffix == ".png":
            assert path.read_bytes().startswith(b"\x89PNG")
            assert path.stat().st_size > 10_000


@checks("calibrate")
def uses_every_target(ran):
    """Where the chart has a star and is described, the star is measured."""
    profile = matcam.Camera.load(next(path for path in ran.outputs if path.suffix == ".json"))
    assert 0.4 < profile.optics.sigma < 0.8


def corrected_files(ran):
    """Document, recorded table, table of values, and data set of a `correct` of one table; None of a run of many."""
    written = {path.suffix: path for path in ran.outputs}
    if not {".binary", ".nc", ".json"} <= set(written):
        return None
    document = json.loads(written[".json"].read_text())
    return (
        document,
        read_recorded_table(ran.folder / document["file"]),
        matcam.read_merl(written[".binary"]),
        matcam.io.read_netcdf(written[".nc"]),
    )


@checks("correct")
def prints_what_the_files_hold(ran):
    """The printed gain and share are those of the files, and the file of values holds what is known."""
    files = corrected_files(ran)
    if files is None:
        return
    document, recorded, values, data = files
    if document["withheld"]:
        assert "raised" not in ran.printed
        np.testing.assert_allclose(values.values, recorded.values, rtol=1e-12)
        return
    supported = data["supported"].values
    kept = [np.mean(recorded.values[0, slice_, 90] / data["brdf"].values[0, slice_, 90]) for slice_ in (74, 75)]
    gain = 1 / np.interp(75, np.degrees(THETA_D[74:76]), kept)
    (stated,) = re.findall(r"the peak at 75° was raised by a factor of ([\d.]+)", ran.printed)
    assert float(stated) == pytest.approx(gain, abs=0.006)
    share = supported[np.isfinite(data["brdf_std"].values)].mean()
    (stated,) = re.findall(r"(\d+)% of the entries with known uncertainty", ran.printed)
    assert float(stated) == pytest.approx(100 * share, abs=0.51)
    # light of the blurred highlight is part of the corrected peak, so it is not kept beside it
    lowered = (data["response"].values > 1) & (data["correction_std"].values < 0.05)
    expected = np.where(supported | lowered, data["brdf"].values, recorded.values)
    np.testing.assert_allclose(values.values, expected, rtol=1e-12)


@checks("correct")
def gives_the_simulated_peaks_back(ran):
    """Every peak of the demo's chromium from 5 to 80 degrees is that of a mirror of its F, relative to 30 degrees.

    F over cos^2 theta_d is the peak of a narrow lobe. The first ring lies in one pixel, so that its mean over the channels has
    a noise of 0.6 %.
    """
    files = corrected_files(ran)
    if files is None or files[1].attrs.get("source", "").find("chromium") < 0:
        return
    _, recorded, _, data = files
    theta_d = THETA_D[5:81, None]
    n, k, _ = matcam.metal("Cr", [610e-9, 550e-9, 465e-9], "rakic")
    truth = conductor(theta_d, np.asarray(n), np.asarray(k)) / np.cos(theta_d) ** 2
    shown = (data["brdf"].values[0, 5:81].mean(axis=1) / truth).mean(axis=-1)
    assert np.abs(shown / shown[25] - 1).max() < 0.03
    assert data["supported"].values[0, 5:81].mean() >= 0.95
    raw = (recorded.values[0, 5:81].mean(axis=1) / truth).mean(axis=-1)
    assert raw[70] / raw[25] < 0.4  # the camera took the rest


def provide(folder, words, made):
    """Make the files that a command line names as inputs."""
    for word in words:
        name = word.rstrip("/")
        if word in outputs_of(words) or name not in made:
            continue
        for one in (*NEEDS.get(name, ()), name):
            if not (folder / one).exists():
                made[one](folder / one)


def run(words, folder, capsys, made=MADE):
    """Run a command line in a folder, and check its code and outputs."""
    provide(folder, words, made)
    capsys.readouterr()
    code = _run(list(words))
    printed = capsys.readouterr()
    assert code in CODES.get(name_of(words), (0,)), f"matcam {shlex.join(words)}: {printed.err}"
    written = [path.strip() for line in re.findall(r"(?m)^written: (.*)$", printed.out) for path in line.split(",")]
    outputs = tuple(folder / path for path in dict.fromkeys([*written, *outputs_of(words)]))
    missing = [str(path) for path in outputs if not path.exists()]
    assert missing == [], f"matcam {shlex.join(words)}"
    ran = Ran(tuple(words), folder, printed.out, outputs)
    for check in CHECKS.get(name_of(words), ()):
        check(ran)
    return ran


# Tests ------------------------------------------------------------------------------------------------------------------


def test_pages_have_commands_and_each_is_known():
    assert len(RUN) > 15
    assert all(name_of(words) for words in LINES)


def test_every_input_of_a_page_can_be_made():
    """A new file name in a page is named here, so that no command line is left out in silence."""
    suffixes = (".binary", ".dng", ".tif", ".bsdf", ".json", ".toml", ".nc")
    for words in RUN:
        named = [word for word in words if word.endswith(("/", *suffixes)) and word not in outputs_of(words)]
        assert [one for one in named if one.rstrip("/") not in MADE] == [], " ".join(words)


@pytest.mark.parametrize("words", [marked(words) for words in RUN])
def test_a_command_and_what_comes_next(words, tmp_path, monkeypatch, capsys, request):
    """In a quick test, "next" is followed while it is quick."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "200")
    slow = request.node.get_closest_marker("slow") is not None
    made = MADE if slow else MADE | MADE_QUICKLY
    ran = run(words, tmp_path, capsys, made)
    for _ in range(LEVELS):
        following = ran.next
        if following is None or (set(following) & set(NOT_RUN)) or not (slow or name_of(following) in QUICK):
            break
        ran = run(following, tmp_path, capsys, made)


@pytest.mark.slow
def test_the_demo_and_what_comes_next(tmp_path, monkeypatch, capsys):
    """`make demo` is `matcam demo --output demo`; then what docs/index.md and the demo itself name."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "200")
    ran = run(("demo", "--output", "demo"), tmp_path, capsys)
    for _ in range(LEVELS):
        ran = run(ran.next, tmp_path, capsys)
    (line,) = command_lines(ROOT / "docs" / "index.md")
    run(line, tmp_path, capsys)
