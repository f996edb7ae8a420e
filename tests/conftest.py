"""What all tests share: where the real data lie, and how hypothesis is run."""

import subprocess
import sys
from pathlib import Path

import hypothesis
import pytest

REPOSITORY = Path(__file__).resolve().parent.parent
SHARED = REPOSITORY.parent / "shared"

hypothesis.settings.register_profile(
    "matcam",
    deadline=None,
    derandomize=True,
    max_examples=60,
    suppress_health_check=[hypothesis.HealthCheck.too_slow, hypothesis.HealthCheck.function_scoped_fixture],
)
hypothesis.settings.load_profile("matcam")


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
