"""What `correct` does to all 100 stand-ins of MERL's materials, and which explanation of each is the best: docs/stand-ins.md.

stand_ins.py run [MATERIAL ...]    corrects them as `rigs.merl()` would have recorded them and writes benchmarks/stand_ins.json;
                                   materials that it has already are left out. About 8 s of a core each.
stand_ins.py page                  writes the tables of docs/stand-ins.md and its figure from that file.

A stand-in has one D for all theta_d: no camera made it, so a correction that changes it does harm. The factors lie in
shared/ beside the checkout.
"""

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from matcam import read_merl, rigs
from matcam.core.io import plain, write_json
from matcam.core.jax import use_compilation_cache
from matcam.core.readers.texts import read_json
from matcam.core.workspace import Workspace
from matcam.inverse import Correction
from matcam.inverse.correction.corrected_table import supported_values
from matcam.inverse.correction.correction_limits import albedo

ROOT = Path(__file__).resolve().parents[1]
SHARED = ROOT.parent / "shared"
RESULTS = Path(os.environ.get("STAND_INS", ROOT / "benchmarks" / "stand_ins.json"))
PAGE = ROOT / "docs" / "stand-ins.md"
LENS = "optics.sigma_px"
UNCHANGED = 0.01
"""Change of an entry below which a table is as it was."""
NARROW = 1.0
"""Degrees."""
BROAD = 5.0
"""Degrees; lobes of more than 20 px, of which no camera takes anything."""


def relative_change(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Change over what was recorded; 0 where nothing was."""
    with np.errstate(invalid="ignore", divide="ignore"):
        change = after / before - 1
    return np.where(np.isfinite(change), change, 0.0)


def judged(table, workspace: Workspace) -> dict:
    """Correct a table, and say what changed and why."""
    rig = rigs.merl()
    started = time.process_time()
    done = Correction.of(table, rig, workspace=workspace)
    spent = time.process_time() - started
    before, written = table.values, supported_values(done.table, table).values
    supported, std = done.table["supported"].values, np.nan_to_num(done.table["correction_std"].values)
    in_file, in_table = relative_change(before, written), relative_change(before, done.table["brdf"].values)
    most = albedo(before).max(), albedo(written).max(), albedo(done.table["brdf"].values).max()
    peaks = slice(5, 76)
    return {
        "family": done.fit.family, "spline_modified": done.fit.has_spline, "hwhm_deg": np.degrees(done.fit.hwhm),
        "hwhm_without_deg": np.degrees(done.without_camera.hwhm),
        "noise": {"camera": done.fit.noise.relative, "no camera": done.without_camera.noise.relative},
        "floor": {"camera": done.fit.noise.floor, "no camera": done.without_camera.noise.floor},
        "log_likelihood_gained": done.without_camera.log_likelihood - done.fit.log_likelihood,
        "tail": {name: done.fit.params.get(name) for name in ("tail_exponent", "haze_share")},
        "free_shadowing": done.without_camera.coordinates.kind.shadows > 0, "no_camera": done.no_camera,
        "determination": done.determination, "withheld": done.withheld, "verdict": done.verdict,
        "remarks": [remark.code for remark in done.remarks],
        "lens_px": done.fit.params.get(LENS), "lens_std_px": done.fit.std.get(LENS),
        "peak_supported": supported[0, peaks].mean(), "supported": done.supported_share,
        "correction_std": {str(a): std[0, a].max() for a in (5, 45, 75)},
        "response": {str(a): done.table["response"].values[0, a, 90].mean() for a in (5, 45, 75)},
        "largest_change": np.abs(in_file).max(), "largest_change_unsupported": np.abs(in_file[~supported]).max(initial=0),
        "peaks_raised_beyond_2_std": int((in_table[0] > 2 * std[0] + 1e-9).sum()),
        "largest_change_in_table": np.abs(in_table).max(),
        "albedo": {"recorded": most[0], "file": most[1], "table": most[2]},
        "seconds": spent,
    }  # fmt: skip


def run(names: list[str]) -> None:
    """Judge materials that the results have not, and write them after each."""
    use_compilation_cache()
    workspace = Workspace.user()
    listed = (SHARED / "data" / "merl_npf" / "materials.txt").read_text().split()
    found = read_json(RESULTS, "results") if RESULTS.exists() else {}
    for name in names or listed:
        if name in found:
            continue
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "a.binary"
            subprocess.run([sys.executable, SHARED / "tools" / "npf_to_merl.py", name, path], check=True)
            table = read_merl(path)
        try:
            found[name] = judged(table, workspace)
        except Exception as error:  # a material that fails is a result, too
            found[name] = {"error": f"{type(error).__name__}: {error}"}
        write_json(RESULTS, plain(dict(sorted(found.items()))), force=True)
        print(
            name,
            {k: v for k, v in found[name].items() if k in ("error", "determination", "noise", "seconds")},
            flush=True,
        )


def verdict(one: dict) -> str:
    """Say in a few words what the run says of a material."""
    if one["withheld"]:
        if "no-blur-in-data" not in one["remarks"]:
            return "withheld: another lens than stated"
        return "withheld: " + ("free shadowing, no camera" if one["free_shadowing"] else "no camera")
    if one["largest_change_in_table"] < UNCHANGED:
        return "nothing to correct"
    return "corrected" if one["largest_change"] > UNCHANGED else "corrected, not supported"


def noise_of(one: dict) -> float:
    """Noise of a pixel under the explanation that holds."""
    return one["noise"]["no camera" if one["no_camera"] > 0.5 else "camera"]


def median_noise(found: dict) -> float:
    """Median over materials of a pixel's noise under the explanation that holds."""
    return float(np.median([noise_of(one) for one in found.values()]))


def summary(found: dict) -> list[str]:
    """Return what all materials have in common, as lines of Markdown."""
    every = list(found.values())
    # None: a lobe that falls to its half nowhere
    diffuse = [one for one in every if one["hwhm_deg"] is None or one["hwhm_deg"] > BROAD]
    noise = sorted(noise_of(one) for one in every)
    bright = sum(one["albedo"]["file"] > max(1.0, one["albedo"]["recorded"]) + 1e-9 for one in every)
    rows = [
        ("materials", "100", len(every)),
        ("tables with albedo > 1 after, not before", "0", bright),
        (
            "tables with albedo > 1 as recorded, not increased",
            "-",
            sum(one["albedo"]["recorded"] > 1 for one in every),
        ),
        (
            "tables whose peak is raised beyond 2 `correction_std`",
            "0",
            sum(one["peaks_raised_beyond_2_std"] > 0 for one in every),
        ),
        (
            "tables with a changed unsupported entry in the file",
            "0",
            sum(one["largest_change_unsupported"] > 0 for one in every),
        ),
        (
            f"broad materials (half width above {BROAD:g}°) changed by more than 1 %",
            "0",
            f"{sum(one['largest_change'] > 0.01 for one in diffuse)} of {len(diffuse)}",
        ),
        ("tables changed by more than 1 %", "-", sum(one["largest_change"] > 0.01 for one in every)),
        (
            "median noise of a pixel, by the most probable explanation",
            "≤ 5 %",
            f"{median_noise(found):.1%}; 90 % of materials below {np.quantile(noise, 0.9):.1%}",
        ),
        (
            "the same, every table through the camera",
            "-",
            f"{np.median([one['noise']['camera'] for one in every]):.1%}",
        ),
    ]
    return [
        "| quantity | required | measured |",
        "|---|---|---|",
        *(f"| {what} | {asked} | {value} |" for what, asked, value in rows),
    ]


def counts(found: dict) -> list[str]:
    """Return how many materials each verdict has, as lines of Markdown."""
    words = [verdict(one) for one in found.values()]
    lines = ["| verdict | materials |", "|---|---|"]
    return lines + [f"| {word} | {words.count(word)} |" for word in sorted(set(words), key=lambda w: -words.count(w))]


def answer(found: dict) -> list[str]:
    """Return what the run says of camera and shadowing, as lines of Markdown."""
    narrow = [one for one in found.values() if (one["hwhm_without_deg"] or 90) < NARROW]
    broad = [one for one in found.values() if one not in narrow]

    def middle(those: list[dict], key: str) -> str:
        return share(float(np.median([one["noise"][key] for one in those])))

    against = sum(one["no_camera"] > 0.99 for one in narrow)
    for_camera = sum(one["no_camera"] < 0.01 for one in found.values())
    shadowing = sum(one["free_shadowing"] for one in narrow)
    noise = {key: (middle(narrow, key), middle(broad, key)) for key in ("camera", "no camera")}
    return [
        f"- **Narrow lobes** (half width below {NARROW:g}°, 4 px; {len(narrow)} materials): with the paper's camera the",
        f"  noise of a pixel is {noise['camera'][0]} (median), without a camera {noise['no camera'][0]}. The data exclude",
        f"  this camera with odds of 99 to 1 or more in {against} cases; {shadowing} of them require free shadowing.",
        f"- **Broad lobes** ({len(broad)}): {noise['camera'][1]} with the camera, {noise['no camera'][1]} without. The effect",
        "  of a camera is too small there for a decision.",
        f"- With odds of 99 to 1 or more the camera is the better explanation of {for_camera} of {len(found)}.",
    ]


def table(found: dict) -> list[str]:
    """Return the verdict of every material, as lines of Markdown."""
    lines = [
        "| material | half width | noise with the camera / without | verdict | peak supported, 5° to 75° | "
        "std of the correction at 45° / 75° |",
        "|---|---|---|---|---|---|",
    ]
    for name, one in sorted(found.items(), key=lambda pair: pair[1]["hwhm_without_deg"] or 90):
        camera, none = (share(one["noise"][key]) for key in ("camera", "no camera"))
        stds = " / ".join(f"{one['correction_std'][angle]:.0%}" for angle in ("45", "75"))
        width, words = one["hwhm_without_deg"], verdict(one).removesuffix(", no camera")
        lines.append(
            f"| {name} | {f'{width:.2g}°' if width else '-'} | {camera} / {none} | {words} | "
            f"{one['peak_supported']:.0%} | {stds} |"
        )
    return lines


def share(noise: float) -> str:
    """Return a noise in per cent; it is estimated up to 20 %."""
    return "≥ 20 %" if noise > 0.199 else f"{noise:.1%}".replace("%", " %")


def figure(found: dict):
    """Draw a pixel's noise with the camera and without, over the lobe's half width, by verdict."""
    from matplotlib.figure import Figure

    from matcam.figures.style import BLACK, BLUE, GREEN, GREY, ORANGE, SKY, VERMILION, styled

    kinds = {
        "withheld: free shadowing, no camera": (VERMILION, "o"),
        "withheld: no camera": (ORANGE, "s"),
        "withheld: another lens than stated": (BLACK, "X"),
        "corrected": (GREEN, "^"),
        "corrected, not supported": (SKY, "v"),
        "nothing to correct": (BLUE, "D"),
    }
    with styled():
        drawn = Figure(figsize=(7.6, 5.4), layout="constrained")
        axes = drawn.subplots()
        for kind, (colour, marker) in kinds.items():
            those = [one for one in found.values() if verdict(one) == kind and one["hwhm_without_deg"]]
            if not those:
                continue
            x = [one["hwhm_without_deg"] for one in those]
            ends = [[100 * max(one["noise"][key], 1e-3) for one in those] for key in ("camera", "no camera")]
            axes.vlines(x, *ends, color=GREY, linewidth=0.6, alpha=0.6, zorder=1)
            axes.plot(x, ends[0], marker, color=colour, markerfacecolor="white", markersize=5, linestyle="", zorder=2)
            axes.plot(
                x, ends[1], marker, color=colour, markersize=5, linestyle="", label=f"{kind} ({len(those)})", zorder=3
            )
        axes.axvline(np.degrees(1 / 256), color=BLACK, linestyle=":", linewidth=1)
        axes.text(
            np.degrees(1 / 256) * 1.05, 0.105, "one pixel of the MERL sphere", fontsize=8, rotation=90, va="bottom"
        )
        axes.set(
            xscale="log",
            yscale="log",
            xlabel="half width of the lobe at half maximum, without a camera (degrees)",
            ylabel="required noise of a pixel (%)",
            yticks=[0.1, 1, 10],
            yticklabels=["≤ 0.1", "1", "10"],
            xticks=[0.1, 1, 10],
            xticklabels=["0.1", "1", "10"],
        )
        axes.set_title("Hollow: through the paper's camera. Filled: without it.", loc="left")
        drawn.legend(loc="outside lower center", ncols=2, fontsize=8.5)
    return drawn


def page() -> None:
    """Write what is generated of the page, and its figure."""
    found = read_json(RESULTS, "results")
    PAGE.write_text(with_results(PAGE.read_text(encoding="utf-8"), found), encoding="utf-8")
    drawn = figure(found)
    drawn.savefig(ROOT / "docs" / "images" / "stand-ins.png", dpi=110, metadata={"Software": None})


def with_results(text: str, found: dict) -> str:
    """Return the page with what lies between its marks made anew."""
    for name, lines in (
        ("summary", summary(found)),
        ("verdicts", counts(found)),
        ("answer", answer(found)),
        ("materials", table(found)),
    ):
        before, _, rest = text.partition(f"<!-- {name} -->\n")
        _, _, after = rest.partition(f"<!-- end of {name} -->\n")
        text = f"{before}<!-- {name} -->\n" + "\n".join(lines) + f"\n<!-- end of {name} -->\n{after}"
    return text


if __name__ == "__main__":
    if sys.argv[1:2] == ["run"]:
        run(sys.argv[2:])
    elif sys.argv[1:] == ["page"]:
        page()
    else:
        sys.exit(__doc__)
