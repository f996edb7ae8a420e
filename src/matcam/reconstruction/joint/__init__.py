"""Joint fit of all images of a sample: parameters and solver."""
