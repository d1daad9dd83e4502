"""`python -m camcal`, the same as `camcal`."""

from camcal.cli.main import main

if __name__ == "__main__":
    main()
