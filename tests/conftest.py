"""What all tests share: where the real data lie, and how hypothesis is run."""

import gc
import os
import shutil
import subprocess
import sys
import tempfile
import threading
from contextlib import nullcontext
from importlib import metadata
from pathlib import Path

import hypothesis
import pytest

REPOSITORY = Path(__file__).resolve().parent.parent
SHARED = REPOSITORY.parent / "shared"
CHROMIUM = "/usr/bin/chromium"

_CACHE = "MATCAM_TESTS_CACHE"
_OWNER = _CACHE not in os.environ
# one cache for this run's processes, thrown away at its end: a program that one of them has compiled is compiled
os.environ["XDG_CACHE_HOME"] = os.environ.setdefault(_CACHE, tempfile.mkdtemp(prefix="matcam-tests-") if _OWNER else "")

_QUICKLY = "MATCAM_TESTS_COMPILE_QUICKLY" in os.environ
# Without this part of XLA programs compile in two thirds of the time, and undivided in four fifths of that. Later versions
# refuse to start with the flags
_QUICK_FLAGS = (
    "--xla_cpu_use_fusion_emitters=false --xla_backend_optimization_level=1 --xla_cpu_parallel_codegen_split_count=1"
)
if _QUICKLY and tuple(int(part) for part in metadata.version("jaxlib").split(".")[:2]) < (0, 11):
    os.environ.setdefault("XLA_FLAGS", _QUICK_FLAGS)

hypothesis.settings.register_profile(
    "matcam",
    deadline=None,
    derandomize=True,
    max_examples=60,
    suppress_health_check=[hypothesis.HealthCheck.too_slow, hypothesis.HealthCheck.function_scoped_fixture],
)
hypothesis.settings.load_profile("matcam")


def pytest_sessionfinish():
    if _OWNER:
        shutil.rmtree(os.environ[_CACHE], ignore_errors=True)


_LOWERED_IN_ONE = 100
"""Programs that are lowered in one context of MLIR. Making a context takes as long as lowering a small program."""


@pytest.fixture(scope="session", autouse=True)
def lowered_together():
    """Small programs, of which tests make thousands, share contexts of MLIR; a context that is full is left behind."""
    from jax._src.interpreters import mlir

    if not _QUICKLY or not hasattr(mlir, "make_ir_context"):
        return  # private to JAX: where a version has it no more, tests take longer
    own, made = mlir.make_ir_context, {"context": None, "left": 0}

    def shared():
        if threading.current_thread() is not threading.main_thread():
            return own()
        if made["left"] == 0:
            made.update(context=own(), left=_LOWERED_IN_ONE)
        made["left"] -= 1
        return made["context"]

    mlir.make_ir_context = shared


@pytest.fixture(scope="session", autouse=True)
def garbage_is_rare():
    """What is imported is no garbage, and what JAX traces is little of it: looking for it takes longer than it frees."""
    if _QUICKLY:
        gc.collect()
        gc.freeze()
        gc.set_threshold(50_000, 20, 50)


@pytest.fixture(scope="session", autouse=True)
def compiled_once():
    """Programs that take long to compile are shared between the test processes and the commands that they start."""
    from matcam.core.jax import jax, use_compilation_cache

    use_compilation_cache()
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.3)


_RULES = 1000
"""Largest number of stored rules, more than one run of the tests computes."""


@pytest.fixture(scope="session", autouse=True)
def rules_once():
    """Quadrature rules of rigs are shared between test files, test processes and commands, as commands of a user share them."""
    from matcam.core.workspace import Workspace, default_workspace

    object.__setattr__(default_workspace(), "folder", Workspace.user().folder)
    for workspace in (default_workspace(), Workspace.user()):
        object.__setattr__(workspace, "files", _RULES)


_COMPUTE = ("batch", "cli", "figures", "inverse", "forward/test_measurement.py")
"""What computes more than it compiles; programs that XLA has not optimised run up to ten times longer."""


@pytest.fixture(scope="module", autouse=True)
def compiled_quickly(request):
    """In `make test` most files do without XLA's optimisation, which costs them more than it saves."""
    from matcam.core.jax import jax

    here = request.path.relative_to(REPOSITORY / "tests").as_posix()
    quick = _QUICKLY and not here.startswith(_COMPUTE)
    jax.config.update("jax_disable_most_optimizations", quick)


_OWN_FILES = ("acquisition", "reconstruction")
"""What reads hundreds of small photographs that it has just written. Processes that read files have tests of their own."""


@pytest.fixture(scope="module", autouse=True)
def own_files_are_trusted(request):
    """A process for every photograph takes ten times as long as the photograph."""
    from matcam.core.readers.apart import reading_limits

    here = request.path.relative_to(REPOSITORY / "tests").as_posix()
    with reading_limits(None) if here.startswith(_OWN_FILES) else nullcontext():
        yield


@pytest.fixture(scope="session")
def real_data():
    """Folder of real data beside the checkout."""
    data = SHARED / "data"
    if not data.is_dir():
        pytest.skip(f"real data not beside the checkout ({SHARED.name}/data)")
    return data


@pytest.fixture(scope="session")
def stand_in(real_data, tmp_path_factory):
    """stand_in(material): a MERL-format file made of the material's published factors (Bagher et al. 2016)."""
    tool = SHARED / "tools" / "npf_to_merl.py"
    folder = tmp_path_factory.mktemp("merl")

    def make(material):
        path = folder / f"{material}.binary"
        if not path.exists():
            subprocess.run([sys.executable, tool, material, path], check=True)
        return path

    return make


@pytest.fixture(scope="session")
def goniophotometer(real_data, tmp_path_factory):
    """goniophotometer(material): a MERL-format file of a material that no camera has seen, one of RGL's ("paper_white",
    "satin_rosaline", "cc_ibiza_sunset", "vch_golden_yellow"), resampled."""
    from matcam import convert

    folder = tmp_path_factory.mktemp("goniophotometer")

    def make(material):
        path = folder / f"{material}.binary"
        if not path.exists():
            convert(real_data / "rgl" / f"{material}_rgb.bsdf", path)
        return path

    return make


@pytest.fixture(scope="session")
def chromium():
    """The browser, driven by Playwright: one for all, because a process can start Playwright only once."""
    playwright = pytest.importorskip("playwright.sync_api", reason="Playwright is not installed")
    if not Path(CHROMIUM).exists():
        pytest.skip(f"no browser at {CHROMIUM}")
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield browser
        browser.close()
