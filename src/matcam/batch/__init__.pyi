from .job import Outcome
from .recipe import Options
from .run import Progress, Run

__all__ = ["Options", "Outcome", "Progress", "Run"]
