"""Maps of a flat textured sample from photographs under several lights, up to the resolution of the camera."""
