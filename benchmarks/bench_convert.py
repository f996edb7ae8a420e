"""Converting a MERL table to RGL's parameterisation against measuring one, in one run and with the second call of each."""

import statistics
import tempfile
import time
from pathlib import Path

from matcam import GGX, Conductor, Flat, Microfacet, Rig, convert, measure, rigs, write_merl
from results import record


def seconds(call) -> float:
    start = time.perf_counter()
    call()
    return time.perf_counter() - start


def main() -> None:
    material = Microfacet(GGX(0.02), Conductor([3.3, 2.9, 2.26], [4.32, 4.23, 3.94]))
    with tempfile.TemporaryDirectory() as folder:
        table, rgl = Path(folder) / "a.binary", Path(folder) / "a.bsdf"
        write_merl(table, measure(material, Rig(rigs.merl().camera, Flat())))
        measuring, converting = [], []
        for k in range(3):
            took = seconds(lambda: measure(material, rigs.merl())), seconds(lambda: convert(table, rgl, force=True))
            if k:  # the first compiles
                measuring.append(took[0])
                converting.append(took[1])
    ratio = statistics.median(c / m for c, m in zip(converting, measuring, strict=True))
    shown = f"{ratio:.2f} ({statistics.median(converting):.1f} s / {statistics.median(measuring):.1f} s)"
    record("bench_convert.py", [("MERL to RGL with its error / `measure`", "≤ 3", shown)])
    print(
        f"convert MERL -> RGL, its error included / measure: median {ratio:.2f} of {len(measuring)} "
        f"({statistics.median(converting):.1f} s / {statistics.median(measuring):.1f} s; asked for: 3)"
    )


if __name__ == "__main__":
    main()
