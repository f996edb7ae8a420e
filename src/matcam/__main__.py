"""Command line as `python -m matcam`."""

from matcam.cli import main

main()
