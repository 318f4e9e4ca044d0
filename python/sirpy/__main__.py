"""`python -m sirpy` is `sirpy`."""

from sirpy.cli import main

main()
