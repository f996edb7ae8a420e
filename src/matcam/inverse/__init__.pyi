from .correction.correction import Correction
from .fit.fit_setup import FitSetup
from .fit.material_fit import MaterialFit
from .fresnel_tables import tabulated_fresnel
from .fresnel_term import fresnel_budget
from .rival_fits import Rivals

__all__ = ["Correction", "FitSetup", "MaterialFit", "Rivals", "fresnel_budget", "tabulated_fresnel"]
