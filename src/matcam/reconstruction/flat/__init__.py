"""Photographs of a flat textured sample under several lights: maps of its texels, as far as the camera keeps them."""
