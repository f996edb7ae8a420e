"""The checks of a capture that take seconds: outline, highlights, lamp table, clipping, flat samples."""
