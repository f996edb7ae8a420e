from . import paper, rigs
from .batch.run import correct_all
from .calibration.camera.calibration import Calibration, calibrate
from .calibration.chart.chart_file import read_chart, write_chart
from .calibration.chart.chart_layout import design_chart
from .calibration.chart.registration import register_chart
from .calibration.edge.edge import edge_mtf, edge_mtf_stack
from .calibration.edge.edge_result import EdgeMTF, EdgeStack
from .calibration.photograph.linear_image import LinearImage
from .calibration.targets.gratings import GratingMTF, coltman, grating_mtf
from .calibration.targets.grid import DotGrid, dot_grid
from .calibration.targets.mtf_samples import MTFSamples
from .calibration.targets.star import StarMTF, star_mtf
from .calibration.targets.targets import measure_targets
from .camera.camera import Camera
from .camera.optics.gaussian import GaussianOptics
from .camera.optics.halo import HaloOptics
from .camera.optics.measured import MeasuredOptics
from .camera.optics.pupil import DefocusOptics, DiffractionOptics
from .camera.pixel import BoxPixel, WindowedGaussianPixel
from .camera.sensor import PixelNoise, Sensor, expose_bracket, merge_bracket
from .camera.uncertainty import Provenance, Uncertainty
from .core.errors import MatcamError
from .exchange.conversion import convert
from .exchange.parameterisation import adaptive_grid
from .exchange.receiver import metadata, solid_angles
from .exchange.renderers import mitsuba_material, pbrt_material, rendered_sphere
from .exchange.trace import camera_trace, lobe_widths
from .files.datasets import read_netcdf, read_zarr, write_netcdf, write_zarr
from .files.float_pictures import read_exr, read_float_tiff, write_exr, write_float_tiff
from .files.merl import read_merl, write_merl
from .files.rgl import read_rgl, write_rgl
from .files.samples import read_samples, write_samples
from .files.sidecar import read_sidecar, sidecar_path, write_sidecar
from .forward.image import picture, picture_values
from .forward.measurement import measure, table_values
from .forward.noisy_table import with_pixel_noise
from .forward.peaks.peak import peak_response
from .forward.prediction import loss_angle
from .forward.stamps import highlight_stamps
from .forward.texture import texture_contrast, textured_picture
from .inverse.correction.correction import Correction, correct, correction
from .inverse.fit.fit_result import MaterialFit
from .inverse.fit.material_fit import fit
from .inverse.fresnel_term import fresnel, tabulated_fresnel
from .inverse.recoverability import limits
from .inverse.rivals import Rivals, rivals
from .material.adaptive import Adaptive
from .material.material import Tabulated, albedo
from .material.metals import metal, metal_sources, metals
from .material.microfacet import Microfacet
from .material.ndf.anisotropic import AnisotropicBeckmann, AnisotropicGGX
from .material.ndf.beckmann import Beckmann
from .material.ndf.epd import EPD
from .material.ndf.gaussian_lobe import GaussianNDF
from .material.ndf.ggx import GGX
from .material.ndf.sgd import SGD
from .material.reflectance import Conductor, Constant, Dielectric, Sampled, Schlick, fresnel_conductor
from .rigs import Rig
from .sample.cylinder import Cylinder
from .sample.shape import Flat
from .sample.sphere import Sphere

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
    "EdgeStack",
    "Flat",
    "GaussianNDF",
    "GaussianOptics",
    "GratingMTF",
    "HaloOptics",
    "LinearImage",
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
    "lobe_widths",
    "loss_angle",
    "measure",
    "measure_targets",
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
    "register_chart",
    "rendered_sphere",
    "rigs",
    "rivals",
    "sidecar_path",
    "solid_angles",
    "star_mtf",
    "table_values",
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
