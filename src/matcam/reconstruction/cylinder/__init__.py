"""Photographs of a cylinder: strips of material bent round it, each at its own angle."""
