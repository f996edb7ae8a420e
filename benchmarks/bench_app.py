"""The app in a browser: time to the shell and the first curve, from a slider to the paint, and a run of 1,000 materials.

Wall times mean something on a quiet machine only. What a move costs is also given as processor time of the server and of the
browser's main thread, and as the messages that it takes, which hardly depend on what else runs.
"""

import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from tests.app.browsing import EXACT, PREPARED, READY, latencies

CHROMIUM = "/usr/bin/chromium"
MOVES = 100
SLIDERS = (("slider-roughness", -2.7, -0.7), ("slider-sigma", -1.0, 0.5), ("slider-radius", 1.4, 3.2))
BOUNDS = "Bokeh.documents[0].get_model_by_name('plan-limits').text !== ''"


def start(cache):
    environment = os.environ | {"XDG_CACHE_HOME": cache, "PYTHONUNBUFFERED": "1"}
    command = [sys.executable, "-m", "matcam", "app", "--no-browser"]
    app = subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    return app, app.stdout.readline().strip()


def moves(page, server, messages, slider, low, high):
    """Times and costs of moves of one slider."""
    browser = page.context.new_cdp_session(page)
    browser.send("Performance.enable", {"timeDomain": "threadTicks"})

    def spent():
        metrics = {one["name"]: one["value"] for one in browser.send("Performance.getMetrics")["metrics"]}
        ticks = Path(f"/proc/{server}/stat").read_text().rpartition(")")[2].split()[11:13]
        return (
            1e3 * sum(map(int, ticks)) / os.sysconf("SC_CLK_TCK"),
            1e3 * metrics["TaskDuration"],
            metrics["LayoutCount"],
        )

    messages.clear()
    before = spent()
    times = latencies(page, MOVES, slider, low, high)
    in_server, in_browser, layouts = ((b - a) / MOVES for a, b in zip(before, spent(), strict=True))
    first, middle, last = np.quantile(times, (0.05, 0.5, 0.95))
    print(f"{slider} to paint, {MOVES} moves: median {middle:.0f} ms, 5 to 95 % {first:.0f} to {last:.0f} ms")
    print(
        f"   a move: {in_server:.0f} ms of processor time in the server, {in_browser:.0f} ms in the browser's main thread, "
        f"{layouts:.1f} layouts, {len(messages) / MOVES:.0f} frames, {sum(messages) / MOVES / 1e3:.0f} kB"
    )


def page_times(browser, cache, kind):
    app, url = start(cache)
    try:
        page = browser.new_page(viewport={"width": 1280, "height": 800})
        messages = []
        page.on("websocket", lambda socket: socket.on("framereceived", lambda frame: messages.append(len(frame))))
        begin = time.perf_counter()
        page.goto(url)
        page.wait_for_function(READY)
        shell = time.perf_counter() - begin
        page.wait_for_function("Bokeh.documents[0].get_model_by_name('curve').data.theta.length > 0", timeout=120_000)
        curve = time.perf_counter() - begin
        page.wait_for_function(PREPARED, timeout=300_000)
        ready = time.perf_counter() - begin
        print(f"{kind} compile cache: shell {shell:.2f} s, first curve {curve:.1f} s, all prepared {ready:.1f} s")
        page.wait_for_function(EXACT, timeout=300_000)
        if kind == "warm":
            page.wait_for_function(BOUNDS, timeout=300_000)
            time.sleep(20)  # the exact picture
            for slider, low, high in SLIDERS:
                moves(page, app.pid, messages, slider, low, high)
        page.close()
    finally:
        app.terminate()
        app.wait(30)


def run_of_1000():
    from matcam.app.exploring.opened import entries_of

    with tempfile.TemporaryDirectory() as folder:
        record = {"fit": {"params": {"alpha": 0.01}}, "supported_share": 0.5, "filling": list(range(3000))}
        for i in range(1000):
            Path(folder, f"m{i}.json").write_text(json.dumps(record))
            Path(folder, f"m{i}.nc").write_bytes(b"")
        begin = time.perf_counter()
        count = len(entries_of(Path(folder)))
        seconds = time.perf_counter() - begin
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
        assert count == 1000
        print(f"run of {count} materials: listed in {seconds:.2f} s; memory of this process {peak:.2f} GB")


def main():
    print(f"load of the machine before: {os.getloadavg()[0]:.1f}")
    run_of_1000()
    from playwright.sync_api import sync_playwright

    with tempfile.TemporaryDirectory() as cache, sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        for kind in ("cold", "warm"):
            page_times(browser, cache, kind)
        browser.close()


if __name__ == "__main__":
    main()
