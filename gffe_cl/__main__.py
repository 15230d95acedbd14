"""`python -m gffe_cl` is `gffe`."""

from gffe_cl.cli import main

main()
