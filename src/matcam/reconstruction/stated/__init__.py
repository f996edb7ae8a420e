"""Specified values of a capture as the prior of a fit: camera, lamps and their light, outline."""
