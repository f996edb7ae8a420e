from .calibration.chart.chart import Chart, Dots, Fiducial, Grating, Patch, Square, Star
from .calibration.chart.chart_file import read_chart, write_chart
from .calibration.chart.chart_layout import design_chart
from .calibration.chart.registration import Registration, register_chart
from .calibration.targets.gratings import GratingMTF, coltman, grating_mtf
from .calibration.targets.grid import BlurField, DotGrid, dot_grid
from .calibration.targets.mtf_samples import MTFSamples
from .calibration.targets.star import StarMTF, star_mtf
from .calibration.targets.targets import Targets, measure_targets

__all__ = [
    "BlurField",
    "Chart",
    "DotGrid",
    "Dots",
    "Fiducial",
    "Grating",
    "GratingMTF",
    "MTFSamples",
    "Patch",
    "Registration",
    "Square",
    "Star",
    "StarMTF",
    "Targets",
    "coltman",
    "design_chart",
    "dot_grid",
    "grating_mtf",
    "measure_targets",
    "read_chart",
    "register_chart",
    "star_mtf",
    "write_chart",
]
