"""`python -m drivecal.cli` is the command `drivecal`."""

from drivecal.cli.main import main

if __name__ == "__main__":
    main()
