"""Entry point of `python -m gffe_cl`, which is the command `gffe`."""

from gffe_cl.cli import main

main()
