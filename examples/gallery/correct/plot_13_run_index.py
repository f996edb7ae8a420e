"""
Read the records of a run
=========================

A run writes a JSON record beside each table, and a page `index.html` that sorts them by any column. This example reads and plots
the records. It continues the run of the tutorial *Correct a database* if that exists.
"""

import json
import tempfile
from pathlib import Path
from textwrap import fill

import matplotlib.pyplot as plt

import matcam

if __name__ == "__main__":  # workers are new processes, which import this script
    folder = Path(tempfile.gettempdir()) / "matcam-examples"
    inputs, outputs = folder / "brdfs", folder / "corrected"
    if not (inputs / "chromium.binary").exists():
        inputs.mkdir(parents=True, exist_ok=True)
        matcam.write_merl(inputs / "chromium.binary", matcam.io.example_table().clip(min=0))

    matcam.correct_all([inputs], matcam.rigs.merl(), outputs, "ggx", workers=1, pages=False)

    records = {path.stem: json.loads(path.read_text()) for path in outputs.glob("*.json")}
    records = {name: record for name, record in records.items() if "verdict" in record}
    figure, axes = plt.subplots(figsize=(7, 3.4), layout="constrained")
    for name, record in records.items():
        lost = {float(angle): share for angle, share in record["peak_lost"].items() if share is not None}
        label = fill(f"{name}: {record['verdict']}", 60)
        axes.plot(lost.keys(), [100 * share for share in lost.values()], "o-", label=label)
    axes.set(xlabel="difference angle, degrees", ylabel="peak lost, %", xlim=(0, 90), ylim=(0, 100))
    axes.legend(fontsize="small")
    plt.show()

    index = (outputs / "index.html").read_text()
    print(
        f"index.html: {len(index) / 1000:.0f} kB, nothing loaded from the network: {'http' not in index.split('<body')[1]}"
    )
