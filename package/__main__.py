"""The command `goniotwin`, also as `python -m goniotwin`."""

import sys


def main() -> None:
    """Run the command line. `--version` alone does not load it."""
    if sys.argv[1:] == ["--version"]:
        import goniotwin

        print(f"goniotwin {goniotwin.__version__}")
        return
    from goniotwin.app.cli.main import main as run_command

    run_command()


if __name__ == "__main__":
    main()
