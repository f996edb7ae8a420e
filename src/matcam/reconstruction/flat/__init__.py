"""Photographs of a flat textured sample under several lights: maps of its texels, up to the resolution of the camera."""
