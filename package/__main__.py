"""The command `goniotwin`, also as `python -m goniotwin`."""

import os
import sys

import goniotwin


def main() -> None:
    """Run the command line. `--version` alone does not load it."""
    _open_closed_streams()
    if sys.argv[1:] == ["--version"]:
        try:
            print(f"goniotwin {goniotwin.__version__}", flush=True)
            return
        except OSError:  # reported below
            pass
    from goniotwin.app.cli.main import main as run_command  # the closed streams come first

    run_command()


def _open_closed_streams() -> None:
    """Let closed standard streams (`>&-`, a program without a console) lead nowhere.

    Otherwise the next file that is opened, such as a journal, has the number of one of them, and gets its messages.
    """
    for number, (name, mode) in enumerate((("stdin", "r"), ("stdout", "w"), ("stderr", "w"))):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # gets the lowest free number
        if getattr(sys, name) is None:
            setattr(sys, name, open(number, mode, encoding="utf-8", closefd=False))  # noqa: SIM115  (for the whole program)


if __name__ == "__main__":
    main()
