"""OpenPBR surfaces: materials that are such surfaces come back, others with their residual; MaterialX reads the files."""

import numpy as np
import pytest

import matcam
from matcam.core.errors import ArgumentError
from matcam.exchange import fit_openpbr, write_openpbr
from matcam.exchange.conversion import convert


@pytest.mark.parametrize("alpha", [0.004, 0.05, 0.4])
def test_a_metal_comes_back(alpha):
    surface = fit_openpbr(matcam.Microfacet(matcam.GGX(alpha), matcam.Schlick([0.9, 0.6, 0.3])))
    assert surface.metalness == 1
    assert surface.specular_roughness == pytest.approx(np.sqrt(alpha), rel=1e-4)
    assert surface.base_color == pytest.approx((0.9, 0.6, 0.3), rel=1e-4)


def test_a_dielectric_comes_back():
    surface = fit_openpbr(matcam.Microfacet(matcam.GGX(0.2), matcam.Dielectric(1.6), diffuse=[0.5, 0.2, 0.1]))
    assert surface.metalness == 0
    assert surface.specular_ior == pytest.approx(1.6, rel=1e-4)
    assert surface.base_color == pytest.approx((0.5, 0.2, 0.1), rel=1e-4)


def test_convert_states_the_residual(tmp_path):
    beckmann = matcam.Microfacet(matcam.Beckmann(0.1), matcam.Conductor(0.2, 3.0))
    matcam.write_merl(tmp_path / "a.binary", matcam.forward.true_table(beckmann))
    report = convert(tmp_path / "a.binary", tmp_path / "a.mtlx")
    assert "specular_roughness" in report["resampled"]
    assert 0.01 < report["error"]["peak"] < 0.5
    assert "Residual: " in (tmp_path / "a.mtlx").read_text()
    with pytest.raises(ArgumentError, match="cannot be evaluated at arbitrary angles"):
        (tmp_path / "s.csv").write_text("theta_h_rad,theta_d_rad,phi_d_rad,R_per_sr\n0.123,0.2,0.3,1\n")
        convert(tmp_path / "s.csv", tmp_path / "s.mtlx")


def test_materialx_reads_the_document(tmp_path):
    mx = pytest.importorskip("MaterialX", reason="materialx is not installed")
    surface = fit_openpbr(matcam.Microfacet(matcam.GGX(0.2), matcam.Dielectric(1.6), diffuse=[0.5, 0.2, 0.1]))
    write_openpbr(tmp_path / "a.mtlx", surface, note='a "note" & <more>')
    document, library = mx.createDocument(), mx.createDocument()
    mx.loadLibraries(mx.getDefaultDataLibraryFolders(), mx.getDefaultDataSearchPath(), library)
    mx.readFromXmlFile(document, str(tmp_path / "a.mtlx"))
    document.setDataLibrary(library)
    valid, message = document.validate()
    assert valid, message
    node = document.getNode("surface")
    assert node.getNodeDef() is not None
    assert node.getInputValue("specular_roughness") == pytest.approx(surface.specular_roughness, rel=1e-6)
    assert node.getInputValue("specular_ior") == pytest.approx(1.6, rel=1e-4)
    assert tuple(node.getInputValue("base_color").asTuple()) == pytest.approx((0.5, 0.2, 0.1), rel=1e-4)
    assert 'a "note" & <more>' in node.getAttribute("doc")
