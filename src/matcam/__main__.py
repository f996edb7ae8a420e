"""`python -m matcam`: the command line."""

from matcam.cli import main

main()
