"""`python -m hil_gateway` is `hil`."""

from hil_gateway.cli.main import main

main()
