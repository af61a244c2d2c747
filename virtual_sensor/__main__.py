"""`python -m virtual_sensor`: the command."""

from virtual_sensor.cli import main

if __name__ == "__main__":
    main()
