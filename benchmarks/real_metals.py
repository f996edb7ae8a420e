"""Does the camera explain why measured metals darken? Six materials of MERL from their published factors (a stand-in for the
measurement), fitted with and without the camera, with two choices of G, against every table of n and k.

real_metals.py FOLDER: of MERL-format files named chrome.binary ...; see docs/correct.md for what came out.
"""

import sys
from pathlib import Path

import numpy as np

from matcam import fit, fresnel_conductor, metal, read_merl, rigs, rivals
from matcam.material import metals

MATERIALS = {"chrome": "Cr", "steel": "Fe", "ss440": "Fe", "tungsten-carbide": "W", "nickel": "Ni", "brass": "brass"}
WAVELENGTH = 550e-9
EVERY = 6


def curve(found) -> tuple[np.ndarray, np.ndarray]:
    """theta_d and F of the green channel over its mean from 10 to 45 degrees."""
    theta, f = found.curves["theta_d"].values, found.curves["fresnel"].values[:, 0]
    used = (theta > np.radians(10)) & (theta < np.radians(45))
    there = np.isfinite(f)
    return theta[there], (f / np.nanmean(f[used]))[there]


def main() -> None:
    folder = Path(sys.argv[1])
    print(
        "material, G, camera: alpha, misfit per noise, sigma_mtf if free; F(69.5), F(75.5), F(81.5) over their mean at 10-45;"
    )
    print("rms over 15-82 degrees against each table of n, k")
    for name, element in MATERIALS.items():
        table = read_merl(folder / f"{name}.binary").isel(channel=[1])
        for masking in ("smith", None):
            for label, rig in (("paper's", rigs.merl()), ("none", None)):
                found = fit(table, rig, "epd", fresnel="free", diffuse=True, masking=masking, slice_step=EVERY)
                theta, f = curve(found)
                at = np.interp(np.radians([69.5, 75.5, 81.5]), theta, f)
                judged = (theta > np.radians(15)) & (theta < np.radians(82))
                rms = {}
                for source in metals()[element]:
                    try:
                        n, k, _ = metal(element, WAVELENGTH, source)
                    except ValueError:
                        continue
                    truth = np.asarray(fresnel_conductor(theta, n, k))
                    truth = truth / truth[(theta > np.radians(10)) & (theta < np.radians(45))].mean()
                    rms[source] = float(np.sqrt(np.nanmean((f[judged] / truth[judged] - 1) ** 2)))
                numbers = {key: round(value, 5) for key, value in found.params.items() if key in ("beta", "power")}
                print(
                    f"{name} | {masking} | {label} | {numbers} | noise {found.noise.relative:.3f} | "
                    f"{np.round(at, 3).tolist()} | { {k: round(v, 3) for k, v in rms.items()} }",
                    flush=True,
                )
        free = fit(table, rigs.merl(), "epd", fresnel="free", diffuse=True, camera_parameters="free", slice_step=EVERY)
        lens = free.params["optics.sigma_px"], free.std["optics.sigma_px"]
        print(
            f"{name} | lens free | sigma_mtf {lens[0]:.3f} +- {lens[1]:.3f} px, noise {free.noise.relative:.3f}",
            flush=True,
        )
        print(f"{name} | {rivals(table, rigs.merl(), 'epd', slice_step=EVERY).verdict}", flush=True)


if __name__ == "__main__":
    main()
