"""Entry point of `python -m matcam`."""

from matcam.cli import main

main()
