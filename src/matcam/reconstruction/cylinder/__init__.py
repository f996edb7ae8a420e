"""Photographs of a cylinder: strips of material around it, each at its own angle."""
