from . import batch, calibration, camera, exchange, forward, inverse, io, material, paper, reconstruction, rigs, targets
from .batch.run import correct_all
from .calibration.camera.calibration import calibrate
from .calibration.edge.edge import edge_mtf, edge_mtf_stack
from .calibration.photograph.linear_image import LinearImage
from .calibration.sensor.characterise import characterise_sensor
from .camera.camera import Camera
from .camera.optics.colour import ColourOptics
from .camera.optics.gaussian import GaussianOptics
from .camera.optics.halo import HaloOptics
from .camera.optics.measured import MeasuredOptics
from .camera.optics.pupil import DefocusOptics, DiffractionOptics
from .camera.optics.seidel import SeidelOptics
from .camera.optics.zernike import ZernikeOptics
from .camera.pixel import BoxPixel, WindowedGaussianPixel
from .camera.sensor import Sensor
from .core.errors import MatcamError
from .exchange.contents import read, write
from .exchange.conversion import convert
from .exchange.file_report import inspect
from .files.merl import read_merl, write_merl
from .forward.image import picture
from .forward.measurement import measure
from .forward.peaks.peak import peak_response
from .forward.prediction import loss_angle, predict
from .inverse.correction.correction import correct
from .inverse.fit.fit_setup import fit
from .inverse.fresnel_term import fresnel
from .inverse.recoverability import limits
from .inverse.rival_fits import rivals
from .lamp.lamps import DistantLamp, NearLamp
from .material.microfacet import Microfacet
from .material.ndf.beckmann import Beckmann
from .material.ndf.gaussian_lobe import GaussianNDF
from .material.ndf.ggx import GGX
from .material.ndf.power_lobes import EPD, SGD
from .material.optical_constants import metal
from .material.reflectance import Conductor, Dielectric, Schlick, fresnel_conductor
from .numerics.budget import UncertaintyBudget, UncertaintySource
from .reconstruction.from_capture import reconstruct
from .rigs import Rig
from .sample.curved import Cylinder, Sphere
from .sample.shape import Flat

__all__ = [
    "EPD",
    "GGX",
    "SGD",
    "Beckmann",
    "BoxPixel",
    "Camera",
    "ColourOptics",
    "Conductor",
    "Cylinder",
    "DefocusOptics",
    "Dielectric",
    "DiffractionOptics",
    "DistantLamp",
    "Flat",
    "GaussianNDF",
    "GaussianOptics",
    "HaloOptics",
    "LinearImage",
    "MatcamError",
    "MeasuredOptics",
    "Microfacet",
    "NearLamp",
    "Rig",
    "Schlick",
    "SeidelOptics",
    "Sensor",
    "Sphere",
    "UncertaintyBudget",
    "UncertaintySource",
    "WindowedGaussianPixel",
    "ZernikeOptics",
    "batch",
    "calibrate",
    "calibration",
    "camera",
    "characterise_sensor",
    "convert",
    "correct",
    "correct_all",
    "edge_mtf",
    "edge_mtf_stack",
    "exchange",
    "fit",
    "forward",
    "fresnel",
    "fresnel_conductor",
    "inspect",
    "inverse",
    "io",
    "limits",
    "loss_angle",
    "material",
    "measure",
    "metal",
    "paper",
    "peak_response",
    "picture",
    "predict",
    "read",
    "read_merl",
    "reconstruct",
    "reconstruction",
    "rigs",
    "rivals",
    "targets",
    "write",
    "write_merl",
]
