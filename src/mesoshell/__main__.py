"""The `mesoshell` command, and `python -m mesoshell`. An interrupt during imports ends it with one line, too."""

import sys


def main() -> None:
    """Entry point of the `mesoshell` command."""
    try:
        from mesoshell.cli.main import main as run

        run()
    except KeyboardInterrupt:
        print("mesoshell: interrupted", file=sys.stderr)
        sys.exit(130)


if __name__ == "__main__":
    main()
