"""A target alone on a page, as the oracle's camera is told of it, and how it is looked at."""

ASLANT = {"tilt": (0.08, -0.06), "roll": 0.1, "distortion": 0.02}
_UNITS = {
    **dict.fromkeys(("centre", "centres", "size", "inner", "outer", "radius", "pitch", "period"), "_mm"),
    **dict.fromkeys(("angle", "phase"), "_rad"),
}


def page_of(element):
    """The description of a chart that holds one element and nothing else; written out here, not by the package's own writer."""
    fields = {name + _UNITS.get(name, ""): value for name, value in vars(element).items()}
    return {
        "fiducials": [],
        "ink_level": 0.05,
        "elements": [{"kind": type(element).__name__.lower(), **fields}],
    }
