"""`python -m mesoshell`: the same as `mesoshell`."""

from mesoshell.cli.main import main

main()
