"""`python -m hil_gateway` is `hil`."""

import signal


def run() -> None:
    """The command line; who interrupts while modules are still loading sees no traceback."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # not where it is ignored (nohup)
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    from hil_gateway.cli.main import main

    main()


if __name__ == "__main__":
    run()
