"""Quick checks of a capture: outline, highlights, lamp table, clipping, flat samples."""
