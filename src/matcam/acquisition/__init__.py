"""From photographs of a sample under a moved lamp to observations: linear values, their noise, and where everything was."""
