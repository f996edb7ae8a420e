"""
Correct a database
==================

This tutorial corrects all tables of a folder. A run writes files for each table and an index. A run that was killed continues when
it is started again.
"""

import json
import shutil
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import matcam

# %%
# The folder contains two tables. The second file is truncated.

if __name__ == "__main__":  # workers are new processes, which import this script
    folder = Path(tempfile.gettempdir()) / "matcam-examples"
    shutil.rmtree(folder, ignore_errors=True)
    inputs, outputs = folder / "brdfs", folder / "corrected"
    inputs.mkdir(parents=True, exist_ok=True)
    matcam.write_merl(inputs / "chromium.binary", matcam.io.example_table().clip(min=0))
    (inputs / "broken.binary").write_bytes((inputs / "chromium.binary").read_bytes()[:1000])

    run = matcam.correct_all([inputs], matcam.rigs.merl(), outputs, "ggx", workers=1, pages=False)
    print("corrected:", [one.name for one in run.corrected])
    for failed in run.failures:
        print("failed:", failed.reason.replace(str(folder), "..."))

# %%
# Each material has a record, which is written last and marks it as finished. A MERL file cannot contain negative noise. It was
# clipped above, and the verdict shows the effect.

if __name__ == "__main__":
    record = json.loads((outputs / "chromium.json").read_text())
    print("verdict:", record["verdict"])
    print(
        "peak lost:",
        {f"{angle}°": round(share, 2) for angle, share in record["peak_lost"].items() if share is not None},
    )
    print(sorted(path.name for path in outputs.iterdir() if not path.name.startswith(".")))

# %%
# The table, as recorded and as corrected: values of the pixels of one image, at a difference angle of 75 degrees.

if __name__ == "__main__":
    before = matcam.read_merl(inputs / "chromium.binary").isel(channel=1, theta_d=75)
    after = matcam.read_merl(outputs / "chromium.binary").isel(channel=1, theta_d=75)
    half_angle = np.degrees(before.theta_h.broadcast_like(before))

    figure, axes = plt.subplots(figsize=(7, 3.6), layout="constrained")
    axes.loglog(half_angle.values.ravel(), before.values.ravel(), ".", label="recorded")
    axes.loglog(half_angle.values.ravel(), after.values.ravel(), ".", label="corrected")
    axes.set(xlabel="half angle, degrees", ylabel="BRDF, 1/sr")
    axes.legend()
    plt.show()

# %%
# A second start repeats nothing.

if __name__ == "__main__":
    again = matcam.correct_all([inputs], matcam.rigs.merl(), outputs, "ggx", workers=1, pages=False)
    print("kept:", [one.name for one in again.kept], "corrected:", [one.name for one in again.corrected])

# %%
# On the command line:
#
# .. code-block:: sh
#
#    matcam correct brdfs/ -o corrected/ --workers 2
