"""
Correct a database
==================

All tables of a folder, each with its files, and an index over all. Finished work is never lost: a run that was killed
goes on where it was when it is started again.
"""

import json
import shutil
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt

import matcam
from shared_table import recorded

# %%
# A folder with two tables, one of which was cut short by a full disk.

folder = Path(tempfile.gettempdir()) / "matcam-examples"
shutil.rmtree(folder, ignore_errors=True)
inputs, outputs = folder / "brdfs", folder / "corrected"
inputs.mkdir(parents=True, exist_ok=True)
matcam.write_merl(inputs / "chromium.binary", recorded().clip(min=0))
(inputs / "broken.binary").write_bytes((inputs / "chromium.binary").read_bytes()[:1000])

if __name__ == "__main__":  # workers are new processes
    run = matcam.correct_all([inputs], matcam.rigs.merl(), outputs, "ggx", workers=1, pages=False)
    print("corrected:", [one.name for one in run.corrected])
    for failed in run.failures:
        print("failed:", failed.reason.replace(str(folder), "..."))

# %%
# Each material has a record, written last, which vouches for its files.

record = json.loads((outputs / "chromium.json").read_text())
print("verdict:", record["verdict"])
print("peak lost:", {f"{angle}°": round(share, 2) for angle, share in record["peak_lost"].items() if share is not None})
print(sorted(path.name for path in outputs.iterdir() if not path.name.startswith(".")))

# %%
# The thumbnail of the index: the sphere as recorded, and as corrected.

figure, axes = plt.subplots(figsize=(5, 2.6), layout="constrained")
axes.imshow(plt.imread(outputs / "chromium.png"))
axes.set(xticks=[], yticks=[], title="recorded, corrected")
plt.show()

# %%
# Start it again, and nothing is done twice.

if __name__ == "__main__":
    again = matcam.correct_all([inputs], matcam.rigs.merl(), outputs, "ggx", workers=1, pages=False)
    print("kept:", [one.name for one in again.kept], "corrected:", [one.name for one in again.corrected])

# %%
# On the command line:
#
# .. code-block:: sh
#
#    matcam correct brdfs/ -o corrected/ --workers 2
