"""All pictures of a sample fitted at once: what is fitted, and how."""
