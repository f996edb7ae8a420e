from . import paper, rigs
from .batch.run import correct_all
from .calibration.chart_file import read_chart, write_chart
from .calibration.chart_layout import design_chart
from .calibration.combine import Calibration, calibrate
from .calibration.edge import edge_mtf, edge_mtf_stack
from .calibration.edge_result import EdgeMTF
from .calibration.gratings import GratingMTF, coltman, grating_mtf
from .calibration.grid import DotGrid, dot_grid
from .calibration.mtf_samples import MTFSamples
from .calibration.registration import register_chart
from .calibration.star import StarMTF, star_mtf
from .calibration.targets import measure_targets
from .camera.bracketing import expose_bracket, merge_bracket
from .camera.camera import Camera
from .camera.defocus import DefocusOptics
from .camera.diffraction import DiffractionOptics
from .camera.gaussian import GaussianOptics
from .camera.halo import HaloOptics
from .camera.measured import MeasuredOptics
from .camera.noise import PixelNoise
from .camera.pixel import BoxPixel, WindowedGaussianPixel
from .camera.sensor import Sensor
from .camera.uncertainty import Provenance, Uncertainty
from .errors import MatcamError
from .exchange.conversion import convert
from .exchange.parameterisation import adaptive_grid
from .exchange.receiver import metadata, receiver
from .exchange.renderers import mitsuba_material, pbrt_material
from .exchange.rendering import rendered_sphere
from .files.exr import read_exr, write_exr
from .files.float_tiff import read_float_tiff, write_float_tiff
from .files.merl import read_merl, write_merl
from .files.netcdf import read_netcdf, write_netcdf
from .files.rgl import read_rgl, write_rgl
from .files.samples import read_samples, write_samples
from .files.sidecar import read_sidecar, sidecar_path, write_sidecar
from .files.zarr_store import read_zarr, write_zarr
from .forward.image import picture, picture_values
from .forward.lobe_table import lobe_table, with_pixel_noise
from .forward.measurement import measure, measured_values
from .forward.peak import loss_angle, peak_response
from .forward.stamps import highlight_stamps
from .forward.texture import texture_contrast, textured_picture
from .inverse.correction import Correction, correct, correction
from .inverse.fit_result import MaterialFit
from .inverse.fresnel_term import fresnel
from .inverse.material_fit import fit
from .inverse.recoverability import limits
from .inverse.rivals import Rivals, rivals
from .inverse.tabulated import tabulated_fresnel
from .material.adaptive import Adaptive
from .material.albedo import albedo
from .material.anisotropic import AnisotropicBeckmann, AnisotropicGGX
from .material.beckmann import Beckmann
from .material.epd import EPD
from .material.gaussian_lobe import GaussianNDF
from .material.ggx import GGX
from .material.metals import metal, metal_sources, metals
from .material.microfacet import Microfacet
from .material.reflectance import Conductor, Constant, Dielectric, Sampled, Schlick, fresnel_conductor
from .material.sgd import SGD
from .material.tabulated import Tabulated
from .rigs import Rig
from .sample.cylinder import Cylinder
from .sample.flat import Flat
from .sample.sphere import Sphere
from .trace import camera_trace, lobe_widths

__all__ = [
    "EPD",
    "GGX",
    "SGD",
    "Adaptive",
    "AnisotropicBeckmann",
    "AnisotropicGGX",
    "Beckmann",
    "BoxPixel",
    "Calibration",
    "Camera",
    "Conductor",
    "Constant",
    "Correction",
    "Cylinder",
    "DefocusOptics",
    "Dielectric",
    "DiffractionOptics",
    "DotGrid",
    "EdgeMTF",
    "Flat",
    "GaussianNDF",
    "GaussianOptics",
    "GratingMTF",
    "HaloOptics",
    "MTFSamples",
    "MatcamError",
    "MaterialFit",
    "MeasuredOptics",
    "Microfacet",
    "PixelNoise",
    "Provenance",
    "Rig",
    "Rivals",
    "Sampled",
    "Schlick",
    "Sensor",
    "Sphere",
    "StarMTF",
    "Tabulated",
    "Uncertainty",
    "WindowedGaussianPixel",
    "adaptive_grid",
    "albedo",
    "calibrate",
    "camera_trace",
    "coltman",
    "convert",
    "correct",
    "correct_all",
    "correction",
    "design_chart",
    "dot_grid",
    "edge_mtf",
    "edge_mtf_stack",
    "expose_bracket",
    "fit",
    "fresnel",
    "fresnel_conductor",
    "grating_mtf",
    "highlight_stamps",
    "limits",
    "lobe_table",
    "lobe_widths",
    "loss_angle",
    "measure",
    "measure_targets",
    "measured_values",
    "merge_bracket",
    "metadata",
    "metal",
    "metal_sources",
    "metals",
    "mitsuba_material",
    "paper",
    "pbrt_material",
    "peak_response",
    "picture",
    "picture_values",
    "read_chart",
    "read_exr",
    "read_float_tiff",
    "read_merl",
    "read_netcdf",
    "read_rgl",
    "read_samples",
    "read_sidecar",
    "read_zarr",
    "receiver",
    "register_chart",
    "rendered_sphere",
    "rigs",
    "rivals",
    "sidecar_path",
    "star_mtf",
    "tabulated_fresnel",
    "texture_contrast",
    "textured_picture",
    "with_pixel_noise",
    "write_chart",
    "write_exr",
    "write_float_tiff",
    "write_merl",
    "write_netcdf",
    "write_rgl",
    "write_samples",
    "write_sidecar",
    "write_zarr",
]
